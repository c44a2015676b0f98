"""Robust statistics that several packages share."""

import numpy as np

STD_PER_MAD = 1.4826
"""Standard deviation of a normal distribution in units of its median absolute deviation."""


def median_and_mad(values: np.ndarray, *, axis: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Median and median absolute deviation in normal standard deviations; both keep the axis."""
    median = np.median(values, axis=axis, keepdims=True)
    return median, STD_PER_MAD * np.median(np.abs(values - median), axis=axis, keepdims=True)


def principal_axes(centred: np.ndarray, count: int) -> np.ndarray:
    """At most `count` principal axes of values (N, D) of mean 0, largest first, shape (D, count).

    From the small matrix of products: a singular value decomposition takes ten times as long.
    """
    return np.linalg.eigh(centred.T @ centred)[1][:, : -count - 1 : -1]


def superiority(values: np.ndarray, chosen: np.ndarray) -> float:
    """Probability that a chosen value exceeds one of the others, ties counted half, shapes (N,).

    Mann and Whitney's U by pair of numbers; NaN without a pair. `scipy.stats` imports slowly.
    """
    others, own = np.sort(values[~chosen]), np.sort(values[chosen])
    below = [np.searchsorted(others, own, side) for side in ("left", "right")]
    return float(np.mean(below) / len(others)) if len(own) and len(others) else float("nan")
