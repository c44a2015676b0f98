"""Which splats touch which tile, front to back: a scene as a camera sees it, a `View`.

Its size depends on the data, so it is made in NumPy on the host. A splat reaches where
alpha >= 1/255, which is an ellipse, and a tile is the rectangle spanned by its pixel centres. Both
are convex, so it is exact to cut the ellipse with the strip of each row of tiles and to take the
columns that the cut covers: no candidate is made and rejected. Splats are sorted by depth once, by
keys of 64 bits, which NumPy 2 sorts with vector instructions; their tiles are not sorted but
counted: the lists are the transpose of a sparse matrix of splats and tiles.
"""

import dataclasses
import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.render.projection import NEAR, Splats, project
from gsc_jax.scene import Array, Camera, Gaussians, InputError

TILE = 8
"""Side of a tile in pixels."""
CPU_LOCKSTEP = 128
"""Tiles that walk together on a CPU: their weights for a chunk then fit into the L2 cache."""
MOST = 2**28
"""Intersections in a view: more would fill the memory. Real scenes have a few per splat."""
MIN_LOCKSTEP, MIN_GROUPS = 16, 8
"""But not all tiles of a small view at once: a group walks until its longest list ends."""


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["splats", "ids", "tiles", "starts", "counts"],
    meta_fields=["width", "height", "lockstep"],
)
@dataclasses.dataclass(frozen=True, kw_only=True)
class View:
    """A scene seen by a camera: all that is needed to apply W or its adjoint.

    Attributes:
        splats: Mean, whitening and log opacity of each Gaussian, and a transparent row that pads
            the lists, shape (N + 1, 6).
        ids: The lists of all tiles one after the other, padded to a bucket size.
        tiles: Tiles, longest list first, padded to a multiple of `lockstep`.
        starts: Where the list of each of these begins in `ids`.
        counts: How long it is.
        width: Image width in pixels.
        height: Image height in pixels.
        lockstep: How many tiles walk together.
    """

    splats: Array
    ids: Array
    tiles: Array
    starts: Array
    counts: Array
    width: int
    height: int
    lockstep: int

    @property
    def grid(self) -> tuple[int, int]:
        """Rows and columns of tiles."""
        return -(-self.height // TILE), -(-self.width // TILE)


def make_view(
    gaussians: Gaussians, camera: Camera, *, near: float = NEAR, lockstep: int | None = None
) -> View:
    """Project and bin a scene for a camera.

    Args:
        gaussians: N Gaussians, not traced: the length of the lists depends on the data.
        camera: The view.
        near: Near plane in world units.
        lockstep: Tiles that walk together; all on an accelerator, on a CPU at most 128, and fewer
            in small views.

    Returns:
        The view. Its arrays have one of a few sizes, so that another camera seldom recompiles.

    Raises:
        InputError: if the splats touch more than 2^28 tiles in all.
    """
    return bin_view(project(gaussians, camera, near=near), camera, lockstep=lockstep)


def bin_view(splats: Splats, camera: Camera, *, lockstep: int | None = None) -> View:
    """Bin projected Gaussians: the second half of `make_view`, with the same arguments."""
    table = _table(splats)  # computed while NumPy bins
    lists = bin_splats(splats, camera.width, camera.height)
    if lockstep is None:
        cpu = int(np.clip(len(lists.counts) // MIN_GROUPS, MIN_LOCKSTEP, CPU_LOCKSTEP))
        lockstep = cpu if jax.default_backend() == "cpu" else len(lists.counts)
    lockstep = min(lockstep, len(lists.counts))
    return View(
        splats=table,
        ids=jnp.asarray(_padded(lists.ids)),
        width=camera.width,
        height=camera.height,
        lockstep=lockstep,
        **_longest_first(lists.starts, lists.counts, lockstep),
    )


def restricted(view: View, wanted: np.ndarray) -> View:
    """The view without the tiles that no wanted splat touches.

    What is blended there stays 0; where a feature of all other splats is 0, so it is anyway.

    Args:
        view: The scene as a camera sees it, of N Gaussians.
        wanted: Boolean, shape (N,).

    Returns:
        A view of the same size, most of whose tiles may have nothing to do.
    """
    order = np.argsort(np.asarray(view.tiles), kind="stable")[: math.prod(view.grid)]
    starts, counts = (np.asarray(x)[order] for x in (view.starts, view.counts))
    listed = np.asarray(view.ids)[: np.max(starts + counts)]
    touched = np.cumsum(np.append(False, np.asarray(wanted).take(listed)), dtype=np.int32)
    counts = np.where(touched[starts + counts] > touched[starts], counts, 0)
    return dataclasses.replace(view, **_longest_first(starts, counts, view.lockstep))


def _longest_first(starts: np.ndarray, counts: np.ndarray, lockstep: int) -> dict[str, jax.Array]:
    """Tiles, starts and counts of a view, from those in the order of the tiles."""
    padding = (0, -len(counts) % lockstep)
    order = np.argsort(-counts, kind="stable").astype(np.int32)
    return {
        "tiles": jnp.asarray(np.pad(order, padding, constant_values=len(counts))),
        "starts": jnp.asarray(np.pad(starts[order], padding)),
        "counts": jnp.asarray(np.pad(counts[order], padding)),
    }


def _padded(ids: np.ndarray) -> np.ndarray:
    """Pad to a power of four: the padding is never read, and sizes seldom differ between views."""
    size = 1 << 12
    while size < len(ids):
        size *= 4
    return np.pad(ids, (0, size - len(ids)))


@jax.jit
def _table(splats: Splats) -> jax.Array:
    table = [splats.means, splats.whitening, jnp.log(splats.opacities)[:, None]]
    padded = jnp.pad(jnp.concatenate(table, axis=1), ((0, 1), (0, 0)))
    return padded.at[-1, -1].set(-jnp.inf)


@dataclasses.dataclass(frozen=True, kw_only=True)
class TileLists:
    """For every tile the splats that touch it, front to back; ties in depth by index.

    Attributes:
        ids: Splat of each of the M intersections, tile by tile, shape (M,) int32.
        starts: First intersection of each tile, shape (tiles,) int32.
        counts: Number of intersections of each tile, shape (tiles,) int32.
    """

    ids: np.ndarray
    starts: np.ndarray
    counts: np.ndarray


def bin_splats(splats: Splats, width: int, height: int) -> TileLists:
    """List the splats of every tile in depth order.

    Args:
        splats: N projected Gaussians.
        width: Image width in pixels.
        height: Image height in pixels.

    Returns:
        The lists of the ceil(width / 8) * ceil(height / 8) tiles, row by row.

    Raises:
        InputError: if there are more than 2^28 intersections.
    """
    columns, rows = -(-width // TILE), -(-height // TILE)
    ellipses = _ellipses(splats)  # computed while NumPy sorts
    order = _front_to_back(np.asarray(splats.depths), np.asarray(splats.visible))
    ellipses = jax.tree.map(lambda column: np.asarray(column).take(order), ellipses)
    first, heights = _tile_range(ellipses.y - ellipses.bottom, ellipses.y + ellipses.bottom, rows)
    row, owner = _expanded(first, heights), np.repeat(np.arange(len(order)), heights)
    left, right = _cut(jax.tree.map(lambda column: column.take(owner), ellipses), row)
    first, widths = _tile_range(left, right, columns)
    covered = _expanded(row * columns + first, widths)
    ends = _ends(widths).take(_ends(heights))  # of all the rows that a splat is cut into
    places, bounds = _by_tile(covered, ends, rows * columns)
    return TileLists(ids=order.take(places), starts=bounds[:-1], counts=np.diff(bounds))


def _front_to_back(depths: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """Indices of the visible splats by depth, ties by index: positive floats sort as their bits."""
    index = np.flatnonzero(visible)
    keys = (depths.take(index).view(np.int32).astype(np.int64) << 32) + index
    keys.sort()
    return keys.astype(np.int32)


def _ends(lengths: np.ndarray) -> np.ndarray:
    """Where each range begins when they lie one after the other, and where the last ends."""
    total = int(lengths.sum(dtype=np.int64))
    if total > MOST:
        raise InputError(
            f"The splats of one view touch {total:,} tiles in all, more than the {MOST:,} that are "
            "listed; are the scales right? If so, ask for smaller images."
        )
    return np.append(np.int32(0), np.cumsum(lengths, dtype=np.int32))


def _expanded(first: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """The numbers first, first + 1, ... of every range, one range after the other."""
    ends = _ends(lengths)
    return np.repeat(first - ends[:-1], lengths) + np.arange(ends[-1], dtype=np.int32)


def _by_tile(covered: np.ndarray, ends: np.ndarray, tiles: int) -> tuple[np.ndarray, np.ndarray]:
    """The places in the order of depth of the splats that cover each tile, and where they begin.

    A splat is a row of a sparse matrix: its transposition counts, and goes through the rows once.
    """
    from scipy.sparse import csr_array

    ones = np.ones(len(covered), np.int8)
    by_tile = csr_array((ones, covered, ends), shape=(len(ends) - 1, tiles)).tocsc()
    return by_tile.indices, by_tile.indptr


class Ellipses(NamedTuple):
    """Where alpha = 1/255, as x = x_0 + slope dy +- sqrt(width - taper dy^2), a column each.

    It spans y_0 +- bottom, and is rightmost at dy = summit.
    """

    x: Array
    y: Array
    bottom: Array
    summit: Array
    slope: Array
    width: Array
    taper: Array


@jax.jit
def _ellipses(splats: Splats) -> Ellipses:
    """The ellipses of all splats: with det / c from the whitening, as a c - b^2 would cancel.

    Those that are not visible get ones, of which no division makes NaN.
    """
    (x, y), (a, b, c), (steep, _, _), reach = (
        jnp.where(splats.visible, leaf.T, 1.0)
        for leaf in (splats.means, splats.covs, splats.whitening, splats.reach)
    )
    det_over_c = 0.5 / steep**2
    return Ellipses(
        x=x,
        y=y,
        bottom=jnp.sqrt(reach * c),
        summit=b * jnp.sqrt(reach / a),
        slope=b / c,
        width=reach * det_over_c,
        taper=det_over_c / c,
    )


def _tile_range(low: np.ndarray, high: np.ndarray, tiles: int) -> tuple[np.ndarray, np.ndarray]:
    """First tile whose pixel centres [8 t + 0.5, 8 t + 7.5] meet [low, high], and how many do."""
    first = np.clip(np.ceil((low - (TILE - 0.5)) / TILE), 0, tiles).astype(np.int32)
    last = np.clip(np.floor((high - 0.5) / TILE), -1, tiles - 1).astype(np.int32)
    return first, np.maximum(last - first + 1, 0)


def _cut(ellipses: Ellipses, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Leftmost and rightmost x of each ellipse inside the strip of pixel centres of a tile row.

    The right end is concave in dy with its summit where the ellipse is rightmost, and the left end
    mirrors it, so clamping the summit to the strip finds both.
    """
    x, y, bottom, summit, slope, width, taper = ellipses
    top = row.astype(np.float32) * TILE + np.float32(0.5) - y
    low, high = np.maximum(top, -bottom), np.minimum(top + np.float32(TILE - 1), bottom)

    def half_width(dy):
        return np.sqrt(np.maximum(width - taper * dy * dy, 0))

    right, left = np.clip(summit, low, high), np.clip(-summit, low, high)
    return (
        x + slope * left - half_width(left),
        x + slope * right + half_width(right),
    )
