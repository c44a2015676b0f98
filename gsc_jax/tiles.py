"""Which splats touch which tile, front to back: the only step whose size depends on the data.

It runs in NumPy on the host. A splat reaches where alpha >= 1/255, which is an ellipse, and a tile
is the rectangle spanned by its pixel centres. Ellipse and rectangle are convex, so it is exact to
cut the ellipse with the strip of each row of tiles and to take the columns that the cut covers: no
candidate is made and rejected. Depth order comes from one sort of packed 64-bit keys before the
expansion, tile order from one after it; both are radix-free vectorised sorts in NumPy 2.
"""

import dataclasses

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
    means, covs, reach = (np.asarray(x)[order] for x in (splats.means, splats.covs, splats.reach))
    minor = np.float32(0.5) / np.asarray(splats.whitening)[order, 0] ** 2

    first_row, last_row = _span(means[:, 1], np.sqrt(reach * covs[:, 2]), rows)
    owner, row = _expand(first_row, last_row)
    left, right = _cut(means[owner], covs[owner], minor[owner], reach[owner], row)
    first, last = _tile_range(left, right, columns)
    strip, column = _expand(first, last)

    keys = (row[strip] * columns + column).astype(np.uint64) << np.uint64(32)
    keys |= owner[strip].astype(np.uint64)
    keys.sort()
    counts = np.bincount((keys >> np.uint64(32)).astype(np.int64), minlength=rows * columns)
    ids = order[(keys & np.uint64(0xFFFFFFFF)).astype(np.int64)]
    starts = np.cumsum(counts) - counts
    return TileLists(
        ids=ids.astype(np.int32), starts=starts.astype(np.int32), counts=counts.astype(np.int32)
    )


def _front_to_back(depths: np.ndarray, visible: np.ndarray) -> np.ndarray:
    """Indices of the visible splats by depth, ties by index: positive floats sort as their bits."""
    index = np.flatnonzero(visible)
    keys = depths[index].view(np.uint32).astype(np.uint64) << np.uint64(32)
    keys |= index.astype(np.uint64)
    keys.sort()
    return (keys & np.uint64(0xFFFFFFFF)).astype(np.int64)


def _span(center: np.ndarray, extent: np.ndarray, tiles: int) -> tuple[np.ndarray, np.ndarray]:
    """First and last tile along one axis that `center +- extent` touches."""
    return _tile_range(center - extent, center + extent, tiles)


def _tile_range(low: np.ndarray, high: np.ndarray, tiles: int) -> tuple[np.ndarray, np.ndarray]:
    """First and last tile whose pixel centres [8 t + 0.5, 8 t + 7.5] meet [low, high], clipped."""
    first = np.ceil((low - (TILE - 0.5)) / TILE)
    last = np.floor((high - 0.5) / TILE)
    return np.clip(first, 0, tiles).astype(np.int32), np.clip(last, -1, tiles - 1).astype(np.int32)


def _expand(first: np.ndarray, last: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every integer of every range [first, last], with the index of the range it belongs to."""
    lengths = np.maximum(last - first + 1, 0)
    owner = np.repeat(np.arange(len(first), dtype=np.int32), lengths)
    offset = np.cumsum(lengths, dtype=np.int32) - lengths
    return owner, np.arange(len(owner), dtype=np.int32) + (first - offset)[owner]


def _cut(means, covs, minor, reach, row) -> tuple[np.ndarray, np.ndarray]:
    """Leftmost and rightmost x of each ellipse inside the strip of pixel centres of a tile row.

    On the ellipse, x = (b / c) dy +- sqrt((reach - dy^2 / c) det / c). The right end is concave in
    dy with its summit where the ellipse is rightmost, the left end mirrors it, so clamping the
    summit to the strip finds both. `minor` is det / c, from the whitening: a c - b^2 would cancel
    for a needle.
    """
    a, b, c = covs.T
    bottom = np.sqrt(reach * c)
    low = np.maximum(row * np.float32(TILE) + np.float32(0.5) - means[:, 1], -bottom)
    high = np.minimum(row * np.float32(TILE) + np.float32(TILE - 0.5) - means[:, 1], bottom)
    summit = b * np.sqrt(reach / a)
    slope = b / c

    def half_width(dy):
        return np.sqrt(np.maximum(reach - dy * dy / c, 0) * minor)

    right, left = np.clip(summit, low, high), np.clip(-summit, low, high)
    return (
        means[:, 0] + slope * left - half_width(left),
        means[:, 0] + slope * right + half_width(right),
    )
