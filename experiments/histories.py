"""Harmless histories of a scene: moved, cropped, pruned, in another order, at a lower detail.

None of them is an edit: they treat the whole scene alike, or leave out what is at its border or
hardly visible.
"""

import functools
from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.special import expit, logit

from gsc_jax.benchmark.incorporation import transformed
from gsc_jax.scene import Gaussians
from gsc_jax.scene.gaussians import rotation_matrices

OPACITY_STEP = 1 / 255
"""Step of opacities in 8 bits."""
MIN_OPACITY = 0.05
"""Opacity below which Gaussians are pruned."""


def moved(gaussians: Gaussians, rng: np.random.Generator) -> Gaussians:
    """Turn, scale and shift the scene."""
    turn = Rotation.from_quat(rng.normal(size=4)).as_matrix()
    return transformed(gaussians, turn, float(np.exp(rng.uniform(-1, 1))), rng.normal(size=3))


def cropped(gaussians: Gaussians, rng: np.random.Generator) -> np.ndarray:
    """Rows that are left when one cuts away up to a fifth at each side of two axes."""
    means, keep = np.asarray(gaussians.means), np.ones(len(gaussians), bool)
    for axis in rng.permutation(3)[:2]:
        low, high = np.quantile(means[:, axis], [rng.uniform(0, 0.2), 1 - rng.uniform(0, 0.2)])
        keep &= (means[:, axis] >= low) & (means[:, axis] <= high)
    return np.flatnonzero(keep)


def level_of_detail(gaussians: Gaussians) -> tuple[Gaussians, np.ndarray]:
    """Merge pairs of Gaussians that are neighbours in Morton order; the last of an odd number goes.

    A merged Gaussian has the mean and covariance of the pair, weighted by opacity times area, and
    the sum of these products. Returns the M merged Gaussians, and the row of the heavier one of
    each pair, (M,).
    """
    order = morton_order(np.asarray(gaussians.means))[: len(gaussians) // 2 * 2].reshape(-1, 2)
    opacities = expit(np.asarray(gaussians.logit_opacities, np.float64))
    masses = (opacities * _area(np.asarray(gaussians.log_scales)))[order] + 1e-30
    weights = masses / masses.sum(axis=1, keepdims=True)

    def mean(values: np.ndarray) -> np.ndarray:
        return np.einsum("np,np...->n...", weights, values)

    means = np.asarray(gaussians.means, np.float64)[order]
    offsets = means - mean(means)[:, None]
    axes = rotation_matrices(gaussians)[order] * np.exp(gaussians.log_scales)[order][..., None, :]
    covariances = axes @ axes.swapaxes(-1, -2) + offsets[..., None] * offsets[..., None, :]
    log_scales, quats = _axes(mean(covariances))
    first = np.take_along_axis(order, weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    merged = Gaussians(
        means=mean(means).astype(np.float32),
        log_scales=log_scales,
        quats=quats,
        logit_opacities=logits(masses.sum(axis=1) / _area(log_scales)),
        sh=mean(np.asarray(gaussians.sh)[order]).astype(np.float32),
    )
    return merged, first


def morton_order(means: np.ndarray) -> np.ndarray:
    """Indices that sort centres (N, 3) along a Morton curve of 2^10 cells per axis."""
    low, extent = means.min(axis=0), np.maximum(np.ptp(means, axis=0), 1e-12)
    cells = np.minimum((means - low) / extent * 2**10, 2**10 - 1).astype(np.int64)
    bits = [(cells[:, axis] >> bit & 1) << 3 * bit + axis for axis in range(3) for bit in range(10)]
    return np.argsort(functools.reduce(np.add, bits), kind="stable")


def unit_quats(gaussians: Gaussians) -> np.ndarray:
    """Unit quaternions with w >= 0, shape (N, 4)."""
    quats = np.asarray(gaussians.rotations)
    return quats * np.where(quats[:, :1] < 0, -1, 1).astype(np.float32)


def logits(opacities: np.ndarray) -> np.ndarray:
    """Logits of opacities that are at least half a step of 8 bits from 0 and 1."""
    return logit(np.clip(opacities, OPACITY_STEP / 2, 1 - OPACITY_STEP / 2)).astype(np.float32)


def _area(log_scales: np.ndarray) -> np.ndarray:
    """Mean of the areas of the three sections through the axes, (N,), up to a factor."""
    scales = np.exp(np.asarray(log_scales, np.float64))
    return (scales * np.roll(scales, 1, axis=1)).sum(axis=1)


def _axes(covariances: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Log scales (N, 3) and quaternions (N, 4) of covariances (N, 3, 3)."""
    variances, axes = np.linalg.eigh(covariances)
    axes[np.linalg.det(axes) < 0, :, 0] *= -1
    quats = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    log_scales = 0.5 * np.log(np.maximum(variances, 1e-14))
    return log_scales.astype(np.float32), quats.astype(np.float32)


SELECTIONS: dict[str, Callable[[Gaussians, np.random.Generator], np.ndarray]] = {
    "cropped": cropped,
    "pruned": lambda g, _: np.flatnonzero(expit(g.logit_opacities) >= MIN_OPACITY),
    "Morton order": lambda g, _: morton_order(np.asarray(g.means)),
    "random order": lambda g, rng: rng.permutation(len(g)),
}
"""Histories that keep some rows, in some order, unchanged; each returns them."""
