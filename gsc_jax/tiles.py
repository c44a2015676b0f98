"""Which splats touch which tile, front to back: the only step whose size depends on the data.

It runs in NumPy on the host. A splat reaches where alpha >= 1/255, which is an ellipse, and a tile
is the rectangle spanned by its pixel centres. Ellipse and rectangle are convex, so it is exact to
cut the ellipse with the strip of each row of tiles and to take the columns that the cut covers: no
candidate is made and rejected. Depth order comes from one sort of packed 64-bit keys before the
expansion, tile order from one after it; both are radix-free vectorised sorts in NumPy 2.
"""

import dataclasses
from typing import NamedTuple

import numpy as np

from gsc_jax.projection import Splats

TILE = 8
"""Side of a tile in pixels."""


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
    """
    columns, rows = -(-width // TILE), -(-height // TILE)
    order = _front_to_back(np.asarray(splats.depths), np.asarray(splats.visible))
    ellipses = _ellipses(splats, order)
    reach_y = (ellipses.y - ellipses.bottom, ellipses.y + ellipses.bottom)
    owner, row = _expand(*_tile_range(*reach_y, rows))
    left, right = _cut(Ellipses(*(column.take(owner) for column in ellipses)), row)
    strip, column = _expand(*_tile_range(left, right, columns))

    tile = row.take(strip) * columns + column
    keys = _packed(tile, owner.take(strip))
    keys.sort()
    tile, splat = _unpacked(keys)
    counts = np.bincount(tile, minlength=rows * columns)
    return TileLists(
        ids=order.take(splat).astype(np.int32),
        starts=(np.cumsum(counts) - counts).astype(np.int32),
        counts=counts.astype(np.int32),
    )


def _packed(major: np.ndarray, minor: np.ndarray) -> np.ndarray:
    """Keys of 64 bits that sort by one integer, then by the other."""
    return major.astype(np.uint64) << np.uint64(32) | minor.astype(np.uint64)


def _unpacked(keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return (keys >> np.uint64(32)).astype(np.int64), keys.astype(np.uint32).astype(np.int64)


def _front_to_back(depths: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """Indices of the visible splats by depth, ties by index: positive floats sort as their bits."""
    index = np.flatnonzero(visible)
    keys = _packed(depths.take(index).view(np.uint32), index)
    keys.sort()
    return _unpacked(keys)[1]


class Ellipses(NamedTuple):
    """Where alpha = 1/255, as x = x_0 + slope dy +- sqrt(width - taper dy^2), a column each.

    It spans y_0 +- bottom, and is rightmost at dy = summit.
    """

    x: np.ndarray
    y: np.ndarray
    bottom: np.ndarray
    summit: np.ndarray
    slope: np.ndarray
    width: np.ndarray
    taper: np.ndarray


def _ellipses(splats: Splats, order: np.ndarray) -> Ellipses:
    """The ellipses of these splats: with det / c from the whitening, as a c - b^2 would cancel."""
    (x, y), (a, b, c), (steep, _, _) = (
        np.asarray(leaf).take(order, axis=0).T.copy()
        for leaf in (splats.means, splats.covs, splats.whitening)
    )
    reach, det_over_c = np.asarray(splats.reach).take(order), np.float32(0.5) / steep**2
    return Ellipses(
        x=x,
        y=y,
        bottom=np.sqrt(reach * c),
        summit=b * np.sqrt(reach / a),
        slope=b / c,
        width=reach * det_over_c,
        taper=det_over_c / c,
    )


def _tile_range(low: np.ndarray, high: np.ndarray, tiles: int) -> tuple[np.ndarray, np.ndarray]:
    """First and last tile whose pixel centres [8 t + 0.5, 8 t + 7.5] meet [low, high], clipped."""
    first = np.ceil((low - (TILE - 0.5)) / TILE)
    last = np.floor((high - 0.5) / TILE)
    return np.clip(first, 0, tiles).astype(np.int32), np.clip(last, -1, tiles - 1).astype(np.int32)


def _expand(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every integer of every range [first, last], after the index of the range it belongs to."""
    lengths = np.maximum(last - first + 1, 0)
    owner = np.repeat(np.arange(len(first)), lengths)
    offset = first - (np.cumsum(lengths) - lengths)
    return owner, np.arange(len(owner)) + offset.take(owner)


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
