"""Trace of appended objects: rows at the end of the file that differ from all rows before.

The rows are cut into pieces. In an unsorted file all pieces have about the same mean attributes,
and an appended object deviates by many times the usual deviation. A sorted file changes along its
rows anyway, so its order is no evidence.
"""

from collections.abc import Iterator

import numpy as np

from gsc_jax.forensics.traces import Trace, make_trace
from gsc_jax.scene import Gaussians
from gsc_jax.scene.statistics import median_and_mad

PIECES, MIN_PIECE_ROWS = 256, 32
"""Number of pieces of a file, fewer if they had less than this number of rows."""
MAX_CORRELATION = 0.3
"""Correlation of adjacent pieces above which a file counts as sorted."""
MIN_DEVIATION = 12.0
"""Standard errors by which the rows at the end deviate, in three attributes or more."""
MAX_EXTENT = 0.5
"""Standard deviation of the positions of an appended object, in units of that of the scene."""
APPENDED_SCORE = 0.95
"""Score of the rows at the end, whose first one is known only up to a piece."""


def row_order(gaussians: Gaussians, in_file: np.ndarray | slice = slice(None)) -> Trace:
    """Detect rows at the end of an unsorted file unlike the rest; `in_file` is its order, (N,)."""
    score, order = np.zeros(len(gaussians), np.float32), np.arange(len(gaussians))[in_file]
    score[order[appended_rows(gaussians, in_file)]] = APPENDED_SCORE
    found = "are the last of the file and differ from all other rows"
    absent = "The last rows of the file do not differ from the others."
    return make_trace("row-order", score, found, absent)


def appended_rows(gaussians: Gaussians, in_file: np.ndarray | slice = slice(None)) -> slice:
    """Rows at the end that differ from those before, to within a piece; empty if none do."""
    pieces = min(PIECES, len(gaussians) // MIN_PIECE_ROWS)
    if pieces < 16:  # too few to estimate the usual deviation
        return slice(0)
    columns = np.concatenate([part[in_file] for part in _standardised(gaussians)], axis=1)
    bounds = np.linspace(0, len(columns), pieces + 1).round().astype(int)
    means = np.add.reduceat(columns, bounds[:-1]) / np.diff(bounds)[:, None]
    cuts = range(2 * pieces // 3, pieces)
    deviations = [_deviation(means, cut, len(columns) / pieces) for cut in cuts]
    cut = cuts[int(np.argmax(deviations))]
    inside = columns[bounds[cut] :, :3]
    wide = (inside.std(axis=0) > MAX_EXTENT * columns[:, :3].std(axis=0)).any()
    if max(deviations) < MIN_DEVIATION or wide or _autocorrelation(means[:cut]) > MAX_CORRELATION:
        return slice(0)
    return slice(bounds[cut], len(columns))


def _deviation(means: np.ndarray, cut: int, piece_rows: float) -> float:
    """Third largest deviation of the pieces from a cut on, in standard errors of their mean."""
    median, mad = median_and_mad(means[:cut])
    error = np.maximum(mad, 1 / np.sqrt(piece_rows)) / np.sqrt(len(means) - cut)
    return float(np.sort(np.abs(means[cut:].mean(axis=0) - median) / error, axis=None)[-3])


def _autocorrelation(means: np.ndarray) -> float:
    """Correlation of adjacent pieces, averaged over the attributes."""
    off = means - means.mean(axis=0)
    products = np.sum(off[1:] * off[:-1], axis=0) / np.maximum(np.sum(off**2, axis=0), 1e-9)
    return float(np.mean(np.abs(products)))


def _standardised(gaussians: Gaussians) -> Iterator[np.ndarray]:
    """Yield positions, sizes, opacities and colours in units of their MAD, clipped, (N, D) each."""
    log_scales = np.asarray(gaussians.log_scales)
    for part in (
        np.asarray(gaussians.means),
        log_scales.mean(axis=1, keepdims=True),
        np.ptp(log_scales, axis=1)[:, None],
        np.clip(np.asarray(gaussians.logit_opacities)[:, None], -6, 6),
        np.asarray(gaussians.sh)[:, 0],
    ):
        median, mad = median_and_mad(part.astype(np.float32, copy=False))
        yield np.clip((part - median) / (mad + 1e-6), -4, 4).astype(np.float32, copy=False)
