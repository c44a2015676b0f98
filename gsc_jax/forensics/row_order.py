"""The order of the rows of a file: a block of them that is unlike all others.

The rows are cut into pieces. In a file that is not sorted all pieces are alike, and an object that
was appended stands out by many of the deviations that blocks of its length have there. A sorted
file changes along its rows by itself, so its order is no evidence.
"""

import numpy as np

from gsc_jax.scene import Gaussians

PIECES = 256
"""Pieces that the rows of a file are cut into."""
SORTED = 0.3
"""Correlation of adjacent pieces above which a file is sorted."""
STRANGE = 12.0
"""Robust deviations by which a block must differ, in three attributes or more."""
SURE = 0.95
"""Score of the rows of a block, whose ends are only known to a piece."""
COMPACT = 0.5
"""Spread of an appended object in units of the scene's, at most."""
FEWEST = 32
"""Rows of a piece, at least."""


def appended_rows(gaussians: Gaussians) -> slice:
    """The rows of the block that stands out, an empty slice if none does.

    Args:
        gaussians: N Gaussians without NaN or infinity.

    Returns:
        A slice of the rows, right to a piece of N / 256 of them or so.
    """
    pieces = min(PIECES, len(gaussians) // FEWEST)
    if pieces < 16:
        return slice(0)
    columns = _standardised(gaussians)
    bounds = np.linspace(0, len(columns), pieces + 1).round().astype(int)
    means = np.add.reduceat(columns, bounds[:-1]) / np.diff(bounds)[:, None]
    start, stop = _strangest(means, len(columns) / pieces)
    inside = columns[bounds[start] : bounds[stop], :3]
    if not len(inside) or (inside.std(axis=0) > COMPACT * columns[:, :3].std(axis=0)).any():
        return slice(0)
    if _lag(np.delete(means, np.arange(start, stop), axis=0)) > SORTED:
        return slice(0)
    start, stop = _widened(means, start, stop)
    return slice(bounds[start], bounds[stop])


def _strangest(means: np.ndarray, size: float) -> tuple[int, int]:
    """First piece and end of the block that differs most, (0, 0) if none does by enough."""
    sums = np.concatenate([np.zeros((1, means.shape[1])), np.cumsum(means, axis=0)])
    best, block = STRANGE, (0, 0)
    for length in range(1, len(means) // 3):
        windows = (sums[length:] - sums[:-length]) / length
        off = np.abs(windows - np.median(windows, axis=0))
        # What chance alone makes of the mean of so many rows.
        floor = 1 / np.sqrt(length * size)
        strange = off / np.maximum(1.48 * np.median(off, axis=0), floor)
        third = np.sort(strange, axis=1)[:, -3]
        start = int(np.argmax(third))
        if third[start] > best:
            best, block = third[start], (start, start + length)
    return block


def _lag(means: np.ndarray) -> float:
    """Correlation of adjacent pieces in the mean of the attributes."""
    off = means - means.mean(axis=0)
    steps = np.sum(off[1:] * off[:-1], axis=0) / np.maximum(np.sum(off**2, axis=0), 1e-9)
    return float(np.mean(np.abs(steps)))


def _widened(means: np.ndarray, start: int, stop: int) -> tuple[int, int]:
    """The block with the pieces beside it that are more like it than like the rest."""
    middle = np.median(means, axis=0)
    towards = means[start:stop].mean(axis=0) - middle
    alike = (means - middle) @ towards > 0.5 * towards @ towards
    while start > 0 and alike[start - 1]:
        start -= 1
    while stop < len(means) and alike[stop]:
        stop += 1
    return start, stop


def _standardised(gaussians: Gaussians) -> np.ndarray:
    """Positions and other attributes by their median and MAD, clipped, shape (N, D)."""
    log_scales = np.maximum(np.asarray(gaussians.log_scales), -30)
    columns = [
        np.asarray(gaussians.means),
        log_scales.mean(axis=1, keepdims=True),
        np.ptp(log_scales, axis=1)[:, None],
        np.clip(np.asarray(gaussians.logit_opacities)[:, None], -6, 6),
        np.asarray(gaussians.sh)[:, 0],
    ]
    columns = np.concatenate(columns, axis=1, dtype=np.float32)
    off = columns - np.median(columns, axis=0)
    return np.clip(off / (1.48 * np.median(np.abs(off), axis=0) + 1e-6), -4, 4)
