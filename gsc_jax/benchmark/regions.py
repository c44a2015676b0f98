"""What cameras see of a scene, and compact regions of it, grown over the graph of neighbours.

How much of a view a Gaussian fills is its blending weight, the first half of the evidence that the
method itself collects. A region is what lies nearest to a seed along the graph of nearest
neighbours, not through the air; it grows until the weights of its Gaussians add up to the wanted
share of the pixels. Views are scaled down, for only areas are wanted.
"""

import dataclasses
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import jax.numpy as jnp
import numpy as np

from gsc_jax.render.orbit import mean_up
from gsc_jax.render.projection import NEAR
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.render.tiles import make_view
from gsc_jax.scene import Camera, Gaussians, invalid_rows
from gsc_jax.scene.parallel import WORKERS, ahead
from gsc_jax.splat import accumulate

Value = TypeVar("Value")

WIDTH = 160
"""Width in pixels that views are scaled down to."""
VIEWS = 16
"""At most as many views are looked through for a place, evenly taken."""
VISIBLE = 0.003
"""A view that shows less than this share of its pixels of something does not see it."""
CONTRAST = 6.0
"""For regions that are to be things: see `grow`."""
NEIGHBOURS = 10
"""Edges that a Gaussian has in the graph, at least."""
RING = 1.9
"""The surroundings of a region reach to this multiple of its radius along the graph."""
BALL = 2.4
"""And are looked for in a ball of this multiple of the radius of one that covers as much."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sight:
    """What some views see of a scene of N Gaussians.

    Attributes:
        cameras: The V views, scaled down.
        shares: The share of the pixels of a view that a Gaussian fills, shape (V, N); 0 for rows
            that cannot be rendered.
        focus: The chance that somebody who picks a view and then a pixel near its middle picks
            this Gaussian, shape (N,); 0 for those that few views see or that are not opaque.
        up: Unit vector, shape (3,).
        near: Near plane in world units.
    """

    cameras: list[Camera]
    shares: np.ndarray
    focus: np.ndarray
    up: np.ndarray
    near: float = NEAR


@dataclasses.dataclass(frozen=True, kw_only=True)
class Region:
    """A compact region and its surroundings.

    Attributes:
        rows: Indices of its Gaussians, those nearest to the seed first.
        ring: Indices of the Gaussians around it.
        center: Median of its centres, shape (3,).
        radius: Distance from there within which 90 % of its centres lie.
        towards: Unit vector to the cameras that see it, shape (3,).
    """

    rows: np.ndarray
    ring: np.ndarray
    center: np.ndarray
    radius: float
    towards: np.ndarray


def look(gaussians: Gaussians, cameras: Sequence[Camera], *, near: float = NEAR) -> Sight:
    """Look at a scene through some of its cameras.

    Args:
        gaussians: N Gaussians.
        cameras: All cameras; the level of the horizon is taken from all of them.
        near: Near plane in world units.

    Returns:
        What `VIEWS` of them, evenly taken, see.
    """
    few = np.unique(np.linspace(0, len(cameras) - 1, min(VIEWS, len(cameras))).astype(int))
    small = [scaled_down(cameras[view]) for view in few]
    sums = np.stack(over_views(lambda camera: _weights(gaussians, camera, near), small))
    shares, middle = np.moveaxis(sums * _sound(gaussians)[None, :, None], -1, 0)
    often = (shares > 0).mean(axis=0)
    focus = middle.sum(axis=0) * often**2 * (np.asarray(gaussians.opacities) > 0.5)
    return Sight(cameras=small, shares=shares, focus=focus, up=mean_up(cameras), near=near)


def scaled_down(camera: Camera) -> Camera:
    """The camera with an image `WIDTH` pixels wide, unless it is smaller."""
    return camera.scaled(min(1.0, WIDTH / camera.width))


def over_views(function: Callable[[Camera], Value], cameras: Sequence[Camera]) -> list[Value]:
    """The values of a function of a view, some views at once."""
    with ThreadPoolExecutor(WORKERS) as pool:
        return list(ahead(pool, function, cameras))


def typical_share(shares: np.ndarray) -> float:
    """The median share of the pixels among the views that see something, 0 if none does."""
    seeing = shares[shares >= VISIBLE]
    return float(np.median(seeing)) if seeing.size else 0.0


def pick(sight: Sight, count: int, rng: np.random.Generator) -> np.ndarray:
    """Rows of Gaussians that the cameras look at, drawn by `Sight.focus`, at most `count`."""
    count = min(count, int(np.count_nonzero(sight.focus)))
    chances = sight.focus.astype(np.float64)
    return rng.choice(len(chances), count, replace=False, p=chances / chances.sum())


def grow(
    gaussians: Gaussians,
    sight: Sight,
    seed: int | np.integer,
    size: float,
    *,
    contrast: float = 0.0,
) -> Region:
    """Grow a region from a seed until it covers a share of the pixels.

    Args:
        gaussians: N Gaussians.
        sight: What the cameras see of them.
        seed: Row of the Gaussian to begin with.
        size: Median share of the pixels in the views that see the region.
        contrast: How much farther apart Gaussians of different colours count, so that a region
            ends rather at the edge of a thing: a step is (1 + contrast * difference in RGB) long.

    Returns:
        The region; smaller than asked for if what hangs together with the seed is.
    """
    means = np.asarray(gaussians.means, np.float64)
    sound = np.flatnonzero(_sound(gaussians))
    away = np.linalg.norm(means[sound] - means[seed], axis=1)
    order = np.argsort(away, kind="stable")
    near, away = sound[order], away[order]
    # Only a ball with room for the region is made a graph of, whatever the size of the scene.
    near = near[away <= BALL * away[_enough(sight.shares[:, near], size) - 1]]
    distance = _along_graph(means[near], _plain_colors(gaussians, near), contrast)
    order = np.argsort(distance, kind="stable")[: np.isfinite(distance).sum()]
    near, distance = near[order], distance[order]
    count = _enough(sight.shares[:, near], size)
    rows = near[:count]
    center = np.median(means[rows], axis=0)
    return Region(
        rows=rows,
        ring=near[count:][distance[count:] <= RING * distance[count - 1]],
        center=center,
        radius=float(np.quantile(np.linalg.norm(means[rows] - center, axis=1), 0.9)),
        towards=_towards(sight, rows, center),
    )


def _weights(gaussians: Gaussians, camera: Camera, near: float) -> np.ndarray:
    """Shares of the pixels of each Gaussian, in all and around the middle, shape (N, 2)."""
    rows, columns = np.indices((camera.height, camera.width)) + 0.5
    off = np.hypot(2 * columns / camera.width - 1, 2 * rows / camera.height - 1)
    maps = np.stack([np.ones_like(off), np.exp(-2 * off**2)], axis=-1) / off.size
    view = make_view(gaussians, camera, near=near)
    return np.asarray(accumulate(view, jnp.asarray(maps, jnp.float32)))


def _sound(gaussians: Gaussians) -> np.ndarray:
    return ~np.any(list(invalid_rows(gaussians).values()), axis=0)


def _plain_colors(gaussians: Gaussians, rows: np.ndarray) -> np.ndarray:
    return np.clip(0.5 + Y0 * np.asarray(gaussians.sh)[rows, 0], 0, 1)


def _enough(shares: np.ndarray, size: float) -> int:
    """How many of these Gaussians, in their order, cover a share of the pixels; else all."""
    counts = np.unique(np.geomspace(1, shares.shape[1], 120).astype(int))
    covered = np.cumsum(shares, axis=1, dtype=np.float64)[:, counts - 1]
    reached = [typical_share(column) >= size for column in covered.T]
    return int(counts[np.argmax(reached)]) if any(reached) else shares.shape[1]


def _along_graph(means: np.ndarray, colors: np.ndarray, contrast: float) -> np.ndarray:
    """Length of the shortest way from the first point to each over neighbours, shape (M,)."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import dijkstra
    from scipy.spatial import KDTree

    count, k = len(means), min(NEIGHBOURS, len(means) - 1)
    if count == 1:
        return np.zeros(1)
    lengths, ends = KDTree(means).query(means, k=k + 1, workers=-1)
    steps = np.linalg.norm(colors[ends] - colors[:, None], axis=-1)
    # A step of no length would be no edge at all in a sparse matrix.
    lengths = np.maximum(lengths * (1 + contrast * steps), 1e-12)
    starts = np.repeat(np.arange(count), k + 1)
    graph = csr_array((lengths.ravel(), (starts, ends.ravel())), shape=(count, count))
    return dijkstra(graph, directed=False, indices=0)


def _towards(sight: Sight, rows: np.ndarray, center: np.ndarray) -> np.ndarray:
    """Unit vector from a place to the cameras, weighted by what they see of these rows."""
    weights = sight.shares[:, rows].sum(axis=1) + 1e-9
    directions = np.stack([camera.center for camera in sight.cameras]) - center
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    mean = weights @ directions
    length = np.linalg.norm(mean)
    # Cameras all around cancel out to nothing that could be called a side.
    return mean / length if length > 1e-3 * weights.sum() else sight.up
