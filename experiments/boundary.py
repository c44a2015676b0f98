"""SAGD's boundary decomposition: cut Gaussians that cross the border of a mask to the part inside.

A Gaussian is represented by the long axis of its projection. Where that segment crosses the border
of the mask, the Gaussian is shrunk to the part inside and moved along its longest axis in space.
The part outside is not kept as a second Gaussian, since only the object is wanted.
"""

import dataclasses

import numpy as np

from gsc_jax.render.projection import LOW_PASS, NEAR, project
from gsc_jax.scene import Array, Camera, Gaussians
from gsc_jax.scene.gaussians import rotation_matrices

REACH = 1.5
"""Half the length of the segment, in standard deviations of the projection."""
SHRINK = 0.8
"""Factor of the axes, times the share of the segment inside (as in SAGD)."""
SAMPLES = 128
"""Points on a segment, ends included, so that the share inside is never 0."""


def sagd_boundary(
    gaussians: Gaussians, labels: Array, camera: Camera, mask: Array, *, near: float = NEAR
) -> Gaussians:
    """SAGD's boundary decomposition for one view (Hu et al., SAGD, arXiv 2401.17857).

    It is applied view after view, to its own result. With rho the share inside of
    the segment mu +- 1.5 sqrt(lambda) e, of the 2D covariance without the low-pass, all axes are
    scaled by 0.8 rho and the centre moves by 1.5 (1 - rho) of the largest standard deviation along
    its axis, towards the end that is inside.

    Args:
        gaussians: N Gaussians.
        labels: Selected Gaussians, shape (N,) bool.
        camera: The view.
        mask: Mask of the view, tampered where > 0.5, shape (H, W); points outside of the image
            count as outside of the mask.
        near: Near plane in world units.

    Returns:
        N Gaussians; only selected and visible ones with exactly one end inside differ.

    Raises:
        ValueError: if labels or mask have another shape.
    """
    labels, mask = np.asarray(labels, bool), np.asarray(mask) > 0.5
    if labels.shape != (len(gaussians),):
        raise ValueError(f"labels must be ({len(gaussians)},), got {labels.shape}")
    if mask.shape != (camera.height, camera.width):
        raise ValueError(f"mask must be ({camera.height}, {camera.width}), got {mask.shape}")
    splats = project(gaussians, camera, near=near)
    rows = np.flatnonzero(labels & np.asarray(splats.visible))
    centers = np.asarray(splats.means)[rows]
    halves = REACH * _long_axes(np.asarray(splats.covs)[rows])
    first, last = _inside(mask, centers - halves), _inside(mask, centers + halves)
    crossing = first != last
    rows, centers = rows[crossing], centers[crossing]
    inward = np.where(last[crossing, None], 1, -1) * halves[crossing]
    steps = np.linspace(-1, 1, SAMPLES, dtype=np.float32)[:, None]
    rho = _inside(mask, centers[:, None] + steps * inward[:, None]).mean(axis=1)
    return _cut(gaussians, rows, rho, inward, camera)


def _cut(
    gaussians: Gaussians, rows: np.ndarray, rho: np.ndarray, inward: np.ndarray, camera: Camera
) -> Gaussians:
    """Shrink rows to the share rho, and move them so that their projections move inward."""
    means, log_scales = np.array(gaussians.means), np.array(gaussians.log_scales)
    longest = log_scales[rows].argmax(axis=1)
    axes = rotation_matrices(gaussians.take(rows))[np.arange(len(rows)), :, longest]
    towards = np.sum(_image_motion(means[rows], axes, camera) * inward, axis=1)
    length = REACH * (1 - rho) * np.exp(log_scales[rows].max(axis=1))
    means[rows] += (np.sign(towards) * length)[:, None] * axes
    log_scales[rows] += np.log(SHRINK * rho)[:, None]
    return dataclasses.replace(gaussians, means=means, log_scales=log_scales)


def _long_axes(covs: np.ndarray) -> np.ndarray:
    """sqrt(lambda) e of the larger eigenvalue of (xx, xy, yy) minus the low-pass, (M, 2)."""
    xx, xy, yy = covs.T
    middle, difference = (xx + yy) / 2 - LOW_PASS, (xx - yy) / 2
    length = np.sqrt(np.maximum(middle + np.hypot(difference, xy), 0))
    angle = np.arctan2(xy, difference) / 2
    return length[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _inside(mask: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Whether points (..., 2) in pixels lie in the mask, shape (...) bool."""
    height, width = mask.shape
    within = np.all((points >= 0) & (points < [width, height]), axis=-1)
    column, row = np.moveaxis(np.where(within[..., None], points, 0).astype(int), -1, 0)
    return within & mask[row, column]


def _image_motion(means: np.ndarray, axes: np.ndarray, camera: Camera) -> np.ndarray:
    """Direction in the image in which centres move along axes, up to a positive factor."""
    viewmat, K = np.asarray(camera.viewmat), np.asarray(camera.K)
    x, y, z = (means @ viewmat[:3, :3].T + viewmat[:3, 3]).T
    dx, dy, dz = (axes @ viewmat[:3, :3].T).T
    return np.stack([K[0, 0] * (z * dx - x * dz), K[1, 1] * (z * dy - y * dz)], axis=-1)
