"""Visibility of Gaussians, and compact regions of a scene, grown over the nearest-neighbour graph.

The share of a view that a Gaussian fills is its total blending weight, as in the evidence. A region
consists of the Gaussians nearest to a seed along the graph rather than through the air; it grows
until their blending weights sum to the requested share of the pixels. Views are scaled down.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra
from scipy.spatial import KDTree

from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.render.orbit import mean_up
from gsc_jax.render.projection import NEAR
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.render.tiles import make_view
from gsc_jax.render.visibility import check_views
from gsc_jax.scene import Camera, Gaussians, InputError
from gsc_jax.scene.gaussians import usable_rows
from gsc_jax.scene.parallel import map_views
from gsc_jax.splat import accumulate

VIEW_WIDTH = 160
"""Width in pixels to which views are scaled down: areas of 1 % are still some hundred pixels."""
MAX_VIEWS = 16
"""Views from which visibility is measured at most, evenly spread."""
VISIBLE_SHARE = 0.003
"""An edit is visible in a view where it covers at least this share of the pixels."""
OBJECT_CONTRAST = 6.0
"""Contrast for regions that should end at the edges of objects; see `grow_region`."""
MIN_OBJECT_ROWS = 8
"""Objects of fewer Gaussians are rejected: too few for a visible change."""
NEIGHBOURS = 10
"""Least number of edges of a Gaussian in the graph."""
RING_REACH = 1.9
"""The ring of a region extends to this multiple of its radius along the graph."""
BALL_REACH = 2.4
"""The graph is built in a ball of this multiple of the radius of one that covers as much."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Visibility:
    """Visibility of N Gaussians from V views, which are scaled down.

    `pixel_share` (V, N) is the share of the pixels of a view that a Gaussian fills, 0 for rows that
    cannot be rendered. Seeds are drawn by `seed_weight` (N,), which is larger near image centres
    and 0 for Gaussians that are not visible or not opaque. `up` is a unit vector, shape (3,).
    """

    cameras: list[Camera]
    pixel_share: np.ndarray
    seed_weight: np.ndarray
    up: np.ndarray
    near: float = NEAR


@dataclasses.dataclass(frozen=True, kw_only=True)
class Region:
    """Rows of a compact region, nearest to the seed first, and those of the `ring` around it.

    The center is the median of its centres, shape (3,), of which 90 % lie within the radius;
    `towards` is a unit vector to the cameras that see it, shape (3,).
    """

    rows: np.ndarray
    ring: np.ndarray
    center: np.ndarray
    radius: float
    towards: np.ndarray


class ProposedEdit(NamedTuple):
    """A scene after an edit whose visibility has not been checked yet.

    `labels` (N,) is True where a Gaussian was pasted, changed or filled in. `original` is the
    authentic scene, for edits that must change the colour of pixels.
    """

    gaussians: Gaussians
    labels: np.ndarray
    description: str
    original: Gaussians | None = None


class EditRejected(Exception):  # noqa: N818 - not an error: another attempt may succeed
    """An attempt at an edit failed; the message gives the reason."""


def measure_visibility(
    gaussians: Gaussians, cameras: Sequence[Camera], *, near: float = NEAR
) -> Visibility:
    """Measure what at most `MAX_VIEWS` cameras see; InputError if it is nothing to edit."""
    check_views(gaussians, cameras, near=near)
    chosen = np.unique(np.linspace(0, len(cameras) - 1, min(MAX_VIEWS, len(cameras))).astype(int))
    small = [scaled_down(cameras[view]) for view in chosen]
    sums = np.stack([*map_views(lambda camera: _blending_weights(gaussians, camera, near), small)])
    share, central = np.moveaxis(sums * usable_rows(gaussians)[None, :, None], -1, 0)
    seen = (share > 0).mean(axis=0)
    weight = central.sum(axis=0) * seen**2 * (np.asarray(gaussians.opacities) > 0.5)
    if not weight.any():
        raise InputError("the cameras see nothing opaque near the middle of their images")
    up = mean_up(cameras)
    return Visibility(cameras=small, pixel_share=share, seed_weight=weight, up=up, near=near)


def scaled_down(camera: Camera) -> Camera:
    """Camera with an image of at most `VIEW_WIDTH` pixels across."""
    return camera.scaled(min(1.0, VIEW_WIDTH / camera.width))


def visible_shares(
    gaussians: Gaussians, cameras: Sequence[Camera], labels: np.ndarray, *, near: float
) -> np.ndarray:
    """Share of the pixels of each view that are tampered, shape (V,)."""
    masks = map_views(lambda camera: truth_mask(gaussians, camera, labels, near=near), cameras)
    return np.array([mask.mean() for mask in masks], np.float64)


def median_visible_share(shares: np.ndarray) -> float:
    """Median share of the pixels over the views in which something is visible, else 0."""
    visible = shares[shares >= VISIBLE_SHARE]
    return float(np.median(visible)) if visible.size else 0.0


def draw_seeds(visibility: Visibility, count: int, rng: np.random.Generator) -> np.ndarray:
    """Draw at most `count` different rows by `Visibility.seed_weight`."""
    count = min(count, int(np.count_nonzero(visibility.seed_weight)))
    weights = visibility.seed_weight.astype(np.float64)
    return rng.choice(len(weights), count, replace=False, p=weights / weights.sum())


def draw_object(
    gaussians: Gaussians, visibility: Visibility, size: float, rng: np.random.Generator
) -> Region:
    """Grow a region at a random seed that ends at the edges of objects; see `grow_region`."""
    seed = draw_seeds(visibility, 1, rng)[0]
    region = grow_region(gaussians, visibility, seed, size, contrast=OBJECT_CONTRAST)
    if len(region.rows) < MIN_OBJECT_ROWS:
        raise EditRejected(f"a region of {len(region.rows)} Gaussians")
    return region


def grow_region(
    gaussians: Gaussians,
    visibility: Visibility,
    seed: int | np.integer,
    size: float,
    *,
    contrast: float = 0.0,
) -> Region:
    """Grow a region from the row `seed` until it covers `size`, a median share of the pixels.

    It is smaller if the connected part of the graph is. A `contrast` makes it end at the edges of
    objects: an edge of the graph has its length times (1 + contrast * difference in RGB).
    """
    means = np.asarray(gaussians.means, np.float64)
    usable = np.flatnonzero(usable_rows(gaussians))
    radius = np.linalg.norm(means[usable] - means[seed], axis=1)
    order = np.argsort(radius, kind="stable")
    near, radius = usable[order], radius[order]
    # The graph covers only a ball with room for the region, whatever the size of the scene.
    last = _rows_to_cover(visibility.pixel_share[:, near], size) - 1
    near = near[radius <= BALL_REACH * radius[last]]
    colors = np.clip(0.5 + Y0 * np.asarray(gaussians.sh)[near, 0], 0, 1)
    distance = _graph_distances(means[near], colors, contrast)
    order = np.argsort(distance, kind="stable")[: np.isfinite(distance).sum()]
    near, distance = near[order], distance[order]
    count = _rows_to_cover(visibility.pixel_share[:, near], size)
    rows = near[:count]
    center = np.median(means[rows], axis=0)
    ring = near[count:][distance[count:] <= RING_REACH * distance[count - 1]]
    extent = float(np.quantile(np.linalg.norm(means[rows] - center, axis=1), 0.9))
    towards = _towards_cameras(visibility, rows, center)
    return Region(rows=rows, ring=ring, center=center, radius=extent, towards=towards)


def _blending_weights(gaussians: Gaussians, camera: Camera, near: float) -> np.ndarray:
    """Share of the pixels per Gaussian, over the image and weighted to its centre, (N, 2)."""
    rows, columns = np.indices((camera.height, camera.width)) + 0.5
    off = np.hypot(2 * columns / camera.width - 1, 2 * rows / camera.height - 1)
    maps = np.stack([np.ones_like(off), np.exp(-2 * off**2)], axis=-1) / off.size
    view = make_view(gaussians, camera, near=near)
    return np.asarray(accumulate(view, jnp.asarray(maps, jnp.float32)))


def _rows_to_cover(shares: np.ndarray, size: float) -> int:
    """Number of leading Gaussians that cover a share of the pixels; all if they do not."""
    counts = np.unique(np.geomspace(1, shares.shape[1], 120).astype(int))
    covered = np.cumsum(shares, axis=1, dtype=np.float64)[:, counts - 1]
    reached = [median_visible_share(column) >= size for column in covered.T]
    return int(counts[np.argmax(reached)]) if any(reached) else shares.shape[1]


def _graph_distances(means: np.ndarray, colors: np.ndarray, contrast: float) -> np.ndarray:
    """Length of the shortest path from the first point to each in the graph, shape (M,)."""
    count, k = len(means), min(NEIGHBOURS, len(means) - 1)
    if count == 1:
        return np.zeros(1)
    lengths, ends = KDTree(means).query(means, k=k + 1, workers=-1)
    differences = np.linalg.norm(colors[ends] - colors[:, None], axis=-1)
    # A sparse matrix would drop an edge of length 0.
    lengths = np.maximum(lengths * (1 + contrast * differences), 1e-12)
    starts = np.repeat(np.arange(count), k + 1)
    graph = csr_array((lengths.ravel(), (starts, ends.ravel())), shape=(count, count))
    return dijkstra(graph, directed=False, indices=0)


def _towards_cameras(visibility: Visibility, rows: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Unit vector to the cameras, weighted by the pixels that these rows fill in them."""
    weights = visibility.pixel_share[:, rows].sum(axis=1) + 1e-9
    directions = np.stack([camera.center for camera in visibility.cameras]) - center
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    mean = weights @ directions
    length = np.linalg.norm(mean)
    # Directions to cameras on all sides cancel out.
    return mean / length if length > 1e-3 * weights.sum() else visibility.up
