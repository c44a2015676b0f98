"""Tolerances between float32 and the float64 reference.

A pixel may differ by a hundredth of the 2e-3 that the design allows; at a cut-off (alpha 1/255, T
1e-4, the order of nearly equal depths) it may also differ by the slack of the reference.
"""

import numpy as np

PIXEL_MAX = 2e-5
PIXEL_MEAN = 2e-6
SUM = 2e-5
"""Error of accumulated sums, relative to the largest sum."""
ADJOINT = 1e-5
"""Error of <W c, m> - <c, W^T m>, relative to <W |c|, |m|>."""
ROUNDING = 2e-6
"""Difference between two orders of the same float32 sum of terms below 1."""


def assert_same_image(image, expected, jump) -> None:
    """Compare images (H, W, D) in [0, 1]; `jump` (H, W) is the slack of the reference."""
    difference = np.abs(np.asarray(image, np.float64) - expected).max(axis=-1)
    clear = difference[jump == 0]
    assert clear.size > 0.7 * difference.size, "too few pixels are far from every cut-off"
    assert clear.max() < PIXEL_MAX, f"a pixel is off by {clear.max():.1e}"
    assert clear.mean() < PIXEL_MEAN, f"pixels are off by {clear.mean():.1e} on average"
    excess = (difference - jump).max()
    assert excess < PIXEL_MAX, f"a pixel jumps by {excess:.1e} more than its cut-offs explain"


def assert_same_sums(sums, expected) -> None:
    """Compare sums over pixels, shape (N, D)."""
    sums = np.asarray(sums, np.float64)
    assert sums.shape == expected.shape
    scale = max(1.0, np.abs(expected).max(initial=0.0))
    worst = np.abs(sums - expected).max(initial=0.0) / scale
    assert worst < SUM, f"a sum is off by {worst:.1e}"
