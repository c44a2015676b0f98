"""Tile lists: the splats that touch each tile, front to back; together with them, a `View`.

The sizes depend on the data, so the lists are built in NumPy on the host. A splat covers the
ellipse alpha >= 1/255, a tile the rectangle spanned by its pixel centres. Both are convex, so the
lists are exact: each ellipse is intersected with the strip of each row of tiles, and the columns
that the intersection covers are listed. Splats are sorted by depth once. Sorting by tile is a
counting sort: the lists are the transpose of a sparse matrix of splats and tiles.
"""

import contextlib
import dataclasses
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from scipy.sparse import csr_array

from gsc_jax.render.projection import NEAR, Splats, project
from gsc_jax.scene import Array, Camera, Gaussians, InputError
from gsc_jax.scene.gaussians import bucket
from gsc_jax.scene.pytree import STATIC

TILE = 8
"""Side of a tile in pixels."""
MAX_INTERSECTIONS = 2**28
"""Most pairs of a splat and a tile that it touches in a view: more would not fit into memory."""
FEW_GROUPS = 256
"""Number of groups up to which padding to a power of two, for which JAX compiles, is cheap."""
CPU_LOCKSTEPS, MIN_GROUPS = (48, 24, 12), 8
"""Tiles in a group on a CPU: the first of these sizes that gives at least `MIN_GROUPS` groups. XLA
divides the steps of larger groups among its threads, which costs more than it gains, and compiles
groups of 32 for three times as long."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class View:
    """A scene projected and binned for a camera: all that W and its adjoint need.

    Attributes:
        splats: Mean, whitening and log opacity of each Gaussian, and a transparent last row that
            pads the lists, shape (N + 1, 6).
        ids: The lists of the tiles, concatenated, and padding to one of few sizes.
        tiles: Tiles, longest list first, padded to one of few sizes with their own number.
        starts: Start of the list of each of these tiles in `ids`.
        counts: Length of the list of each of these tiles.
        columns: Columns of tiles in the image.
        width: Image width in pixels.
        height: Image height in pixels.
        lockstep: Number of tiles in a group, which are walked together.
    """

    splats: Array
    ids: Array
    tiles: Array
    starts: Array
    counts: Array
    columns: Array
    width: int = dataclasses.field(metadata=STATIC)
    height: int = dataclasses.field(metadata=STATIC)
    lockstep: int = dataclasses.field(metadata=STATIC)

    @property
    def of_any_size(self) -> "View":
        """The view without its image size, so that sizes share compiled code."""
        return dataclasses.replace(self, width=0, height=0)


def make_view(
    gaussians: Gaussians,
    camera: Camera,
    *,
    near: float = NEAR,
    lockstep: int | None = None,
    touching: np.ndarray | None = None,
) -> View:
    """Project and bin a scene for a camera.

    Args:
        gaussians: N Gaussians, which `jax.grad` may trace, but not `jax.jit`: the length of the
            lists depends on the data. Within `jax.jit`, those from outside become constants.
        camera: Pose, intrinsics and image size.
        near: Near plane in world units.
        lockstep: Tiles in a group; default all on an accelerator, at most 48 on a CPU.
        touching: Only tiles that one of these Gaussians, boolean (N,), touches keep their lists:
            features that are 0 for all others composite to the same image, in less time.

    Returns:
        The view. Its arrays have one of a few sizes, so that another camera seldom recompiles.

    Raises:
        InputError: if there are more than 2^28 intersections of splats and tiles.
        ValueError: if a shape, the near plane, `lockstep` or `touching` is invalid.
    """
    traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((gaussians, camera, near)))
    with contextlib.nullcontext() if traced else jax.ensure_compile_time_eval():
        splats = project(gaussians, camera, near=near)
        return bin_view(splats, camera, lockstep=lockstep, touching=touching)


def bin_view(
    splats: Splats, camera: Camera, *, lockstep: int | None = None, touching: Array | None = None
) -> View:
    """Bin projected Gaussians: the second half of `make_view`."""
    touching = None if touching is None else np.asarray(touching)
    if touching is not None and (touching.dtype, touching.shape) != (bool, splats.visible.shape):
        raise ValueError(f"touching must be boolean, {splats.visible.shape}, got {touching!r:.60}")
    known = jax.lax.stop_gradient(splats)
    if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(known)):
        raise TypeError(
            "the lists of a view depend on the values of the Gaussians, which are not known under "
            "jax.jit or jax.vmap; build the view outside with make_view, and use "
            "reprojected(view, gaussians, camera) inside"
        )
    table = splat_table(splats)  # asynchronous: JAX computes it while NumPy bins
    lists = bin_splats(known, camera.width, camera.height, touching)
    tiles = len(lists.counts)
    lockstep = _tiles_in_group(lockstep, tiles)
    groups = -(-tiles // lockstep)
    groups = 1 << (groups - 1).bit_length() if groups <= FEW_GROUPS else bucket(groups)
    longest, padded = np.argsort(-lists.counts, kind="stable").astype(np.int32), groups * lockstep
    padding = (0, padded - tiles)
    size = 4 ** max(6, -(-(lists.total - 1).bit_length() // 2))  # few different ones
    return View(
        splats=table,
        ids=jnp.asarray(np.pad(lists.ids, (0, size - len(lists.ids)))),
        tiles=jnp.asarray(np.pad(longest, padding, constant_values=padded)),
        starts=jnp.asarray(np.pad(lists.starts[longest], padding)),
        counts=jnp.asarray(np.pad(lists.counts[longest], padding)),
        columns=jnp.asarray(-(-camera.width // TILE), jnp.int32),
        width=camera.width,
        height=camera.height,
        lockstep=lockstep,
    )


def _tiles_in_group(lockstep: int | None, tiles: int) -> int:
    if lockstep is not None and not (isinstance(lockstep, int | np.integer) and lockstep >= 1):
        raise ValueError(f"lockstep must be a whole number above 0, got {lockstep}")
    if lockstep is None:
        cpu = next((few for few in CPU_LOCKSTEPS if MIN_GROUPS * few <= tiles), CPU_LOCKSTEPS[-1])
        lockstep = cpu if jax.default_backend() == "cpu" else tiles
    return min(lockstep, tiles)


@jax.jit
def splat_table(splats: Splats) -> jax.Array:
    """The rows of `View.splats`, shape (N + 1, 6)."""
    opaque = splats.opacities > 0
    logs = jnp.where(opaque, jnp.log(jnp.where(opaque, splats.opacities, 1.0)), -jnp.inf)
    table = [splats.means, splats.whitening, logs[:, None]]
    return jnp.pad(jnp.concatenate(table, axis=1), ((0, 1), (0, 0))).at[-1, -1].set(-jnp.inf)


class TileLists(NamedTuple):
    """Splats of each tile, front to back, with ties in depth by index; all int32.

    `ids` are the splats of the M intersections, tile by tile, shape (M,); `starts` and `counts`
    are the first intersection and the number of intersections of each tile, shapes (tiles,). If
    only some tiles keep their lists, `ids` has fewer than the `total` of the image, and gaps.
    """

    ids: np.ndarray
    starts: np.ndarray
    counts: np.ndarray
    total: int


def bin_splats(
    splats: Splats, width: int, height: int, touching: np.ndarray | None = None
) -> TileLists:
    """List the splats of each tile of an image, in depth order, tiles in row-major order.

    Only tiles that one of `touching`, boolean (N,), touches have a list; by default all of them.
    """
    columns, rows = -(-width // TILE), -(-height // TILE)
    ellipses = _ellipses(splats)  # asynchronous: JAX computes them while NumPy sorts
    order = _front_to_back(np.asarray(splats.depths, np.float32), np.asarray(splats.visible))
    ellipses = jax.tree.map(lambda column: np.asarray(column).take(order), ellipses)
    first, heights = _tile_range(ellipses.y - ellipses.bottom, ellipses.y + ellipses.bottom, rows)
    row, owner = _expanded(first, heights), np.repeat(np.arange(len(order)), heights)
    left, right = _cut(jax.tree.map(lambda column: column.take(owner), ellipses), row)
    first, widths = _tile_range(left, right, columns)
    first += row * columns
    kept, total = np.full(rows * columns, touching is None), int(_ends(widths)[-1])
    if touching is not None:
        chosen = touching.take(order).take(owner)
        kept[_expanded(first[chosen], widths[chosen])] = True
        before = np.append(np.int32(0), np.cumsum(kept, dtype=np.int32))
        widths *= before.take(first + widths) > before.take(first)
    covered = _expanded(first, widths)
    ends = _ends(widths).take(_ends(heights))  # of the tiles of each splat, over all of its rows
    ones, shape = np.ones(len(covered), np.int8), (len(order), rows * columns)
    by_tile = csr_array((ones, covered, ends), shape=shape).tocsc()  # the transpose
    starts, counts = by_tile.indptr[:-1], np.diff(by_tile.indptr) * kept
    return TileLists(ids=order.take(by_tile.indices), starts=starts, counts=counts, total=total)


def _front_to_back(depths: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """Indices of the visible splats by depth, ties by index: positive floats sort as their bits."""
    index = np.flatnonzero(visible)
    bits = depths.take(index).view(np.uint32)
    # A stable sort of 16 bits is a radix sort in NumPy: two are faster than one of 64 bits.
    order = np.argsort(bits.astype(np.uint16), kind="stable")
    order = order.take(np.argsort((bits >> 16).astype(np.uint16).take(order), kind="stable"))
    return index.take(order).astype(np.int32)


def _ends(lengths: np.ndarray) -> np.ndarray:
    """Boundaries of consecutive ranges of these lengths, starting at 0."""
    if (total := int(lengths.sum(dtype=np.int64))) > MAX_INTERSECTIONS:
        raise InputError(
            f"The splats of one view touch {total:,} tiles in total, at most {MAX_INTERSECTIONS:,} "
            "are supported; are the scales right? If so, use smaller images."
        )
    return np.append(np.int32(0), np.cumsum(lengths, dtype=np.int32))


def _expanded(first: np.ndarray, lengths: np.ndarray) -> np.ndarray:
    """Concatenate the ranges first, first + 1, ... of these lengths."""
    ends = _ends(lengths)
    return np.repeat(first - ends[:-1], lengths) + np.arange(ends[-1], dtype=np.int32)


class Ellipses(NamedTuple):
    """Outlines alpha = 1/255, x = x_0 + slope dy +- sqrt(width - taper dy^2), one array per term.

    An outline spans y_0 +- bottom, and is rightmost at dy = summit.
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
    """Outlines of all splats; invisible ones have parameters of 1, which no division makes NaN."""
    (x, y), (a, b, c), (steep, _, _), reach = (
        jnp.where(splats.visible, leaf.T, 1.0)
        for leaf in (splats.means, splats.covs, splats.whitening, splats.reach)
    )
    det_over_c = 0.5 / steep**2  # from the whitening, because a c - b^2 would cancel
    bottom, summit, width = jnp.sqrt(reach * c), b * jnp.sqrt(reach / a), reach * det_over_c
    return Ellipses(x, y, bottom, summit, slope=b / c, width=width, taper=det_over_c / c)


def _tile_range(low: np.ndarray, high: np.ndarray, tiles: int) -> tuple[np.ndarray, np.ndarray]:
    """First tile t whose pixel centres [8t + 0.5, 8t + 7.5] meet [low, high], and their number."""
    first = np.clip(np.ceil((low - (TILE - 0.5)) / TILE), 0, tiles).astype(np.int32)
    last = np.clip(np.floor((high - 0.5) / TILE), -1, tiles - 1).astype(np.int32)
    return first, np.maximum(last - first + 1, 0)


def _cut(ellipses: Ellipses, row: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Leftmost and rightmost x of each ellipse within the pixel centres of a row of tiles.

    The right end is concave in dy with its maximum at the summit, and the left end mirrors it;
    clamping the summit to the strip gives both.
    """
    x, y, bottom, summit, slope, width, taper = ellipses
    top = row.astype(np.float32) * TILE + np.float32(0.5) - y
    low, high = np.maximum(top, -bottom), np.minimum(top + np.float32(TILE - 1), bottom)

    def half_width(dy):
        return np.sqrt(np.maximum(width - taper * dy * dy, 0))

    right, left = np.clip(summit, low, high), np.clip(-summit, low, high)
    return x + slope * left - half_width(left), x + slope * right + half_width(right)
