"""Trace of appended objects: a block of rows of the file that differs from all other rows.

The rows are cut into pieces. In an unsorted file all pieces have about the same mean attributes,
and an appended object deviates by many times the usual deviation. A sorted file changes along its
rows anyway, so its order is no evidence.
"""

import numpy as np

from gsc_jax.forensics.traces import Trace, make_trace
from gsc_jax.scene import Gaussians
from gsc_jax.scene.statistics import median_and_mad

PIECES, MIN_PIECE_ROWS = 256, 32
"""Number of pieces of a file, fewer if they had less than this number of rows."""
MAX_CORRELATION = 0.3
"""Correlation of adjacent pieces above which a file counts as sorted."""
MIN_DEVIATION = 12.0
"""Robust deviations of a block, in three attributes or more."""
MAX_EXTENT = 0.5
"""Standard deviation of the positions of an appended object, in units of that of the scene."""
BLOCK_SCORE = 0.95
"""Score of the rows of a block, whose ends are known only up to a piece."""


def row_order(gaussians: Gaussians, neighbours: np.ndarray | None = None) -> Trace:
    """Detect a block of rows unlike the rest of an unsorted file; needs no neighbours."""
    del neighbours
    score = np.zeros(len(gaussians), np.float32)
    score[appended_rows(gaussians)] = BLOCK_SCORE
    found = "follow each other in the file and differ from all other rows"
    return make_trace("row-order", score, found, "No block of rows differs from the others.")


def appended_rows(gaussians: Gaussians) -> slice:
    """Rows of the block that differs from the others, to within a piece; empty if none does."""
    pieces = min(PIECES, len(gaussians) // MIN_PIECE_ROWS)
    if pieces < 16:  # too few to estimate the usual deviation
        return slice(0)
    columns = _standardised(gaussians)
    bounds = np.linspace(0, len(columns), pieces + 1).round().astype(int)
    means = np.add.reduceat(columns, bounds[:-1]) / np.diff(bounds)[:, None]
    start, stop = _most_deviating(means, len(columns) / pieces)
    inside = columns[bounds[start] : bounds[stop], :3]
    if not len(inside) or (inside.std(axis=0) > MAX_EXTENT * columns[:, :3].std(axis=0)).any():
        return slice(0)
    if _autocorrelation(np.delete(means, np.arange(start, stop), axis=0)) > MAX_CORRELATION:
        return slice(0)
    start, stop = _extended(means, start, stop)
    return slice(bounds[start], bounds[stop])


def _most_deviating(means: np.ndarray, piece_rows: float) -> tuple[int, int]:
    """First piece and end of the most deviating block; (0, 0) if none is above the threshold."""
    sums = np.concatenate([np.zeros((1, means.shape[1])), np.cumsum(means, axis=0)])
    best, block = MIN_DEVIATION, (0, 0)
    for length in range(1, len(means) // 3):
        windows = (sums[length:] - sums[:-length]) / length
        median, mad = median_and_mad(windows)
        # Standard error of the mean of standardised rows.
        floor = 1 / np.sqrt(length * piece_rows)
        deviation = np.abs(windows - median) / np.maximum(mad, floor)
        third = np.sort(deviation, axis=1)[:, -3]
        start = int(np.argmax(third))
        if third[start] > best:
            best, block = third[start], (start, start + length)
    return block


def _autocorrelation(means: np.ndarray) -> float:
    """Correlation of adjacent pieces, averaged over the attributes."""
    off = means - means.mean(axis=0)
    products = np.sum(off[1:] * off[:-1], axis=0) / np.maximum(np.sum(off**2, axis=0), 1e-9)
    return float(np.mean(np.abs(products)))


def _extended(means: np.ndarray, start: int, stop: int) -> tuple[int, int]:
    """The block with the adjacent pieces that resemble it more than the rest of the file."""
    median = np.median(means, axis=0)
    direction = means[start:stop].mean(axis=0) - median
    alike = (means - median) @ direction > 0.5 * direction @ direction
    while start > 0 and alike[start - 1]:
        start -= 1
    while stop < len(means) and alike[stop]:
        stop += 1
    return start, stop


def _standardised(gaussians: Gaussians) -> np.ndarray:
    """Positions, sizes, opacities and colours in units of their MAD, clipped, shape (N, D)."""
    log_scales = np.asarray(gaussians.log_scales)
    columns = [
        np.asarray(gaussians.means),
        log_scales.mean(axis=1, keepdims=True),
        np.ptp(log_scales, axis=1)[:, None],
        np.clip(np.asarray(gaussians.logit_opacities)[:, None], -6, 6),
        np.asarray(gaussians.sh)[:, 0],
    ]
    columns = np.concatenate(columns, axis=1, dtype=np.float32)
    median, mad = median_and_mad(columns)
    return np.clip((columns - median) / (mad + 1e-6), -4, 4)
