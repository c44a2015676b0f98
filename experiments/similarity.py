"""How alike two images are: structural similarity (SSIM) and signal-to-noise ratio (PSNR)."""

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.scene import Array

SIGMA = 1.5
"""Standard deviation of the window of the SSIM in pixels (Wang et al. 2004)."""
REACH = 5
"""Pixels of the window to each side of its centre (Wang et al. 2004)."""
LUMINANCE = 0.01**2
"""Constant of the SSIM that steadies the ratio of means, for values in [0, 1]."""
CONTRAST = 0.03**2
"""Constant of the SSIM that steadies the ratio of variances, for values in [0, 1]."""


def ssim(one: jax.Array, other: jax.Array) -> jax.Array:
    """Structural similarity of two images in [0, 1] per pixel, (H, W, 3) (Wang et al. 2004)."""
    height, width, _ = one.shape
    maps = jnp.concatenate([one, other, one * one, other * other, one * other], axis=2)
    rows, columns = _window(height), _window(width)
    smooth = jnp.einsum("hi,ijc,wj->hwc", rows, maps, columns)
    mean, mean2, square, square2, product = jnp.split(smooth, 5, axis=2)
    variances = square - mean**2 + square2 - mean2**2
    luminance = (2 * mean * mean2 + LUMINANCE) / (mean**2 + mean2**2 + LUMINANCE)
    structure = (2 * (product - mean * mean2) + CONTRAST) / (variances + CONTRAST)
    return luminance * structure


def _window(size: int) -> np.ndarray:
    """The Gaussian window as a matrix (size, size); zero outside of the image."""
    offset = np.arange(size)[:, None] - np.arange(size)
    weights = np.exp(-0.5 * (offset / SIGMA) ** 2) * (np.abs(offset) <= REACH)
    reach = np.arange(-REACH, REACH + 1)
    return (weights / np.exp(-0.5 * (reach / SIGMA) ** 2).sum()).astype(np.float32)


def psnr(one: Array, other: Array) -> float:
    """Peak signal-to-noise ratio of images in [0, 1], in dB."""
    return float(-10 * np.log10(np.mean(np.square(np.subtract(one, other))) + 1e-12))
