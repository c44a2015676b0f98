"""Gaussians as viser draws them: coloured ellipsoids without view-dependent colour."""

import dataclasses
from typing import TYPE_CHECKING

import numpy as np

from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Gaussians
from gsc_jax.scene.gaussians import rotation_matrices

if TYPE_CHECKING:
    import viser

TYPICAL_HALF, LARGEST_HALF = 0.1, 250.0
"""Typical and largest standard deviation whose square fits float16, in which viser stores it."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Splats:
    """N ellipsoids, NumPy float32.

    Centers and standard deviations (`scales`) along the axes, (N, 3), are in world units; colours,
    (N, 3), and opacities, (N, 1), in [0, 1]. Covariances have shape (N, 3, 3).
    """

    centers: np.ndarray
    covariances: np.ndarray
    rgbs: np.ndarray
    opacities: np.ndarray
    scales: np.ndarray


def splats(gaussians: Gaussians) -> Splats:
    """Convert Gaussians; the covariance is R S S^T R^T."""
    scales = np.asarray(gaussians.scales)
    axes = rotation_matrices(gaussians) * scales.astype(np.float64)[:, None, :]
    return Splats(
        centers=np.asarray(gaussians.means, np.float32),
        covariances=(axes @ axes.swapaxes(1, 2)).astype(np.float32),
        rgbs=np.clip(0.5 + Y0 * np.asarray(gaussians.sh, np.float32)[:, 0], 0, 1),
        opacities=np.asarray(gaussians.opacities, np.float32)[:, None],
        scales=scales,
    )


def by_importance(splats: Gaussians, *, labelled: np.ndarray) -> np.ndarray:
    """All rows in an order of which the first ones already show the edit and what surrounds it.

    The largest in opacity times area, by turns from the `labelled` visible ones and the others.
    """
    axes = np.sort(np.asarray(splats.scales, np.float64), axis=1)
    sizes = np.ravel(splats.opacities) * axes[:, 1] * axes[:, 2]
    order = np.argsort(-sizes, kind="stable")
    first = (labelled & (sizes > 0))[order]
    turn = np.where(first, np.cumsum(first), np.cumsum(~first) - 0.5)
    return order[np.argsort(turn, kind="stable")]


def half_precision_unit(splats: Splats) -> float:
    """World units per unit of length in which typical covariances fit float16; 1 for points."""
    deviations = np.sqrt(np.diagonal(splats.covariances, axis1=1, axis2=2).max(axis=1))
    typical = float(np.median(deviations)) if len(deviations) else 0.0
    return typical / TYPICAL_HALF if typical > 0 else 1.0


def fit_half_precision(covariances: np.ndarray) -> np.ndarray:
    """Scale down covariances (N, 3, 3) that overflow float16, and keep their shape."""
    spread = np.diagonal(covariances, axis1=1, axis2=2).max(axis=1)
    factors = np.minimum(1, LARGEST_HALF**2 / np.maximum(spread, 1e-30))
    return covariances * factors[:, None, None].astype(np.float32)


def add_splats(server: "viser.ViserServer", name: str, splats: Splats, unit: float) -> None:
    """Add splats as a node of the scene, stored in a `unit` of length."""
    server.scene.add_gaussian_splats(
        name,
        centers=splats.centers / unit,
        covariances=fit_half_precision(splats.covariances / unit**2),
        rgbs=splats.rgbs,
        opacities=splats.opacities,
        scale=unit,
    )
