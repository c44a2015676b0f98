"""Robust statistics that several packages share."""

import numpy as np

NORMAL = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


def median_and_mad(values: np.ndarray, *, axis: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Location and scale that outliers do not move.

    Args:
        values: Finite, any shape.
        axis: Axis of the samples.

    Returns:
        Median, and median absolute deviation in units of a normal standard deviation; both keep
        the axis with length 1.
    """
    median = np.median(values, axis=axis, keepdims=True)
    return median, NORMAL * np.median(np.abs(values - median), axis=axis, keepdims=True)
