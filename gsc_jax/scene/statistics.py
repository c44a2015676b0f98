"""Robust statistics that several packages share."""

import numpy as np

STD_PER_MAD = 1.4826
"""Standard deviation of a normal distribution in units of its median absolute deviation."""


def median_and_mad(values: np.ndarray, *, axis: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Compute location and scale that are robust to outliers.

    Args:
        values: Finite samples, any shape.
        axis: Axis of the samples.

    Returns:
        Median, and median absolute deviation in units of a normal standard deviation; both keep
        the axis with length 1.
    """
    median = np.median(values, axis=axis, keepdims=True)
    return median, STD_PER_MAD * np.median(np.abs(values - median), axis=axis, keepdims=True)
