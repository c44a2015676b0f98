"""What a viewer is given: Gaussians as coloured ellipsoids.

Colours are those of the constant harmonic, as browsers' splat renderers evaluate no others. What is
shown is decided by colours and opacities alone, so that switching moves no Gaussian: what is not to
be seen has opacity 0.
"""

import dataclasses
from typing import Literal, get_args

import numpy as np

from gsc_jax.io.ply import LUMA
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Array, Gaussians

Mode = Literal["original", "heat map", "tampered only", "authentic only"]
MODES: tuple[Mode, ...] = get_args(Mode)

COLORMAP = "viridis"
"""Perceptually uniform, and the same to colour-blind eyes."""
SHADE = 0.35
"""How much of a heat map is the scene in grey, so that things are recognised in it."""

HALF_TYPICAL = 0.1
HALF_LARGEST = 250.0
"""Typical and largest standard deviation in half precision, whose squares must not over- or
underflow: viewers store covariances in it."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Splats:
    """N ellipsoids, NumPy float32.

    Attributes:
        centers: World units, shape (N, 3).
        covariances: World units squared, shape (N, 3, 3).
        rgbs: Colours in [0, 1], shape (N, 3).
        opacities: In [0, 1], shape (N, 1).
    """

    centers: np.ndarray
    covariances: np.ndarray
    rgbs: np.ndarray
    opacities: np.ndarray

    def __len__(self) -> int:
        """The number of ellipsoids."""
        return len(self.centers)


def splats(gaussians: Gaussians) -> Splats:
    """The ellipsoids of a scene, covariance R S S^T R^T.

    Args:
        gaussians: N Gaussians.

    Returns:
        N splats.
    """
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_quat(np.asarray(gaussians.rotations), scalar_first=True).as_matrix()
    axes = turned * np.asarray(gaussians.scales, np.float64)[:, None, :]
    rgbs = 0.5 + Y0 * np.asarray(gaussians.sh, np.float32)[:, 0]
    return Splats(
        centers=np.asarray(gaussians.means, np.float32),
        covariances=(axes @ axes.swapaxes(1, 2)).astype(np.float32),
        rgbs=np.clip(rgbs, 0, 1),
        opacities=np.asarray(gaussians.opacities, np.float32)[:, None],
    )


def largest(gaussians: Gaussians, count: int, *, first: np.ndarray) -> np.ndarray:
    """The Gaussians that show most: those of largest opacity times area.

    Args:
        gaussians: N Gaussians.
        count: How many, at most.
        first: Which come before all others, if they can be seen at all, shape (N,) bool.

    Returns:
        Rows, ascending, shape (min(N, count),) int64.
    """
    if count >= len(gaussians):
        return np.arange(len(gaussians))
    axes = np.sort(np.asarray(gaussians.log_scales, np.float64), axis=1)
    opacities = np.asarray(gaussians.opacities, np.float64)
    with np.errstate(divide="ignore"):  # invisible ones come last
        shows = np.log(opacities) + axes[:, 1] + axes[:, 2]
    order = np.lexsort((-shows, ~(first & np.isfinite(shows))))
    return np.sort(order[:count])


def heat(score: Array) -> np.ndarray:
    """The colours of a score, from dark to light.

    Args:
        score: In [0, 1], shape (N,).

    Returns:
        RGB in [0, 1], shape (N, 3) float32.
    """
    from matplotlib import colormaps

    return colormaps[COLORMAP](np.asarray(score, np.float64))[:, :3].astype(np.float32)


def shaded(rgbs: np.ndarray, light: np.ndarray) -> np.ndarray:
    """Colours mixed with the grey of others.

    Args:
        rgbs: Colours in [0, 1], shape (N, 3).
        light: Colours whose grey is taken, shape (N, 3).

    Returns:
        RGB in [0, 1], shape (N, 3).
    """
    return (1 - SHADE) * rgbs + SHADE * (light @ LUMA)[:, None].astype(np.float32)


def shown(
    splats: Splats, score: Array, mode: Mode, threshold: float
) -> tuple[np.ndarray, np.ndarray]:
    """What a mode shows.

    Args:
        splats: N splats in their own colours.
        score: Of tampering, shape (N,).
        mode: What is asked for.
        threshold: Tampered is what scores above it.

    Returns:
        Colours (N, 3) and opacities (N, 1), 0 for what is hidden.
    """
    if mode == "original":
        return splats.rgbs, splats.opacities
    if mode == "heat map":
        return shaded(heat(score), splats.rgbs), splats.opacities
    visible = (np.asarray(score) > threshold) == (mode == "tampered only")
    return splats.rgbs, splats.opacities * visible[:, None]


def half_unit(splats: Splats) -> float:
    """The length to measure in so that covariances can be stored in half precision.

    Args:
        splats: N splats.

    Returns:
        World units per unit; 1 where no splat has an extent.
    """
    deviations = np.sqrt(np.diagonal(splats.covariances, axis1=1, axis2=2).max(axis=1))
    typical = float(np.median(deviations))
    return typical / HALF_TYPICAL if typical > 0 else 1.0


def fitting_half(covariances: np.ndarray) -> np.ndarray:
    """Covariances, scaled down where half precision would overflow.

    Args:
        covariances: Shape (N, 3, 3).

    Returns:
        The same shape; of what was too large, the form is kept.
    """
    spread = np.diagonal(covariances, axis1=1, axis2=2).max(axis=1)
    factors = np.minimum(1, HALF_LARGEST**2 / np.maximum(spread, 1e-30))
    return covariances * factors[:, None, None].astype(np.float32)
