"""Up direction of a scene without cameras, from its floor.

A floor is level and at the bottom: for a direction, the share of the area of flat, level Gaussians
in the lowest fifth of the scene, minus that in the highest fifth. The direction where this is
largest is the up direction, if it stands out, and if the floor is not an upright side of a tall
object; otherwise -y, the up of most scenes from COLMAP.
"""

import contextlib

import numpy as np

from gsc_jax.render.orbit import DEFAULT_UP
from gsc_jax.render.spherical_harmonics import even_directions
from gsc_jax.scene import Gaussians, InputError
from gsc_jax.scene.gaussians import rotation_matrices

MIN_GAUSSIANS, MAX_GAUSSIANS, DIRECTIONS = 1000, 20_000, 400
"""Sizes of the sample of the Gaussians, and directions that are compared, 10 degrees apart."""
LEVEL_COSINE, NEAR_COSINE = np.cos(np.radians([20, 10]))
"""Normals up to this angle from the direction are level; axes up to this one are taken as meant."""
SLAB, FLAT_RATIO = 0.2, 0.7
"""Part of the height that holds the floor; largest ratio of the axes of a flat Gaussian."""
MIN_RATIO, MAX_ASPECT = 1.5, 1.9
"""Advantage over directions at more than 45 degrees, 1.8 to 20 in outdoor scenes and rooms and 1 to
1.7 in most single objects, and ratio of the sides of a floor, 2 to 6 for the sides of statues."""
AXES = dict(zip(("x", "y", "z", "-x", "-y", "-z"), [*np.eye(3), *-np.eye(3)], strict=True))


def parse_up(text: str) -> np.ndarray:
    """Unit vector of "z", "-y" or "0,0.1,1"; InputError for others."""
    if text in AXES:
        return AXES[text].copy()
    with contextlib.suppress(ValueError):
        vector = np.array([float(part) for part in text.split(",")])
        if vector.shape == (3,) and np.isfinite(vector).all() and vector.any():
            vector /= np.abs(vector).max()  # so that the norm neither overflows nor underflows
            return vector / np.linalg.norm(vector)
    raise InputError(f"--up {text}: expected one of {', '.join(AXES)}, or three numbers as 0,0,1")


def up_text(up: np.ndarray) -> str:
    """A unit vector as `parse_up` reads it."""
    names = [name for name, axis in AXES.items() if np.allclose(axis, up)]
    return names[0] if names else ",".join(f"{value:.2f}" for value in up)


def estimated_up(gaussians: Gaussians) -> np.ndarray:
    """Unit up direction of Gaussians that can be rendered, (3,); -y if no floor stands out."""
    rows = np.flatnonzero(np.asarray(gaussians.logit_opacities) > 0)
    rows = rows if len(rows) else np.arange(len(gaussians))
    rows = rows[np.linspace(0, len(rows) - 1, min(len(rows), MAX_GAUSSIANS)).astype(int)]
    if len(rows) < MIN_GAUSSIANS:
        return DEFAULT_UP.copy()
    means, normals, areas = _surfels(gaussians.take(rows))
    candidates = np.concatenate([list(AXES.values()), even_directions(DIRECTIONS)])
    floors = np.array([_floor(means, normals, areas, up) for up in candidates])
    best = candidates[np.argmax(floors)]
    apart = candidates @ best < np.sqrt(0.5)
    if floors.max() <= MIN_RATIO * max(floors[apart].max(), 0) or not _is_wide(means, best):
        return DEFAULT_UP.copy()
    return next((axis.copy() for axis in AXES.values() if axis @ best > NEAR_COSINE), best)


def _surfels(gaussians: Gaussians) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Centres, normals, and relative areas, 0 for Gaussians that are not flat."""
    log_scales = np.asarray(gaussians.log_scales, np.float64)
    shortest = log_scales.argmin(axis=1)[:, None, None]
    normals = np.take_along_axis(rotation_matrices(gaussians), shortest, axis=2)[..., 0]
    scales = np.sort(np.exp(log_scales), axis=1)
    areas = scales[:, 2] * scales[:, 1] * (scales[:, 0] < FLAT_RATIO * scales[:, 1])
    areas = np.minimum(areas, np.percentile(areas, 99))  # not a few huge floaters
    return np.asarray(gaussians.means, np.float64), normals, areas / max(areas.sum(), 1e-300)


def _floor(means: np.ndarray, normals: np.ndarray, areas: np.ndarray, up: np.ndarray) -> float:
    """Area of the floor minus that of the ceiling."""
    heights = means @ up
    low, high = np.percentile(heights, [2, 98])
    level, margin = np.abs(normals @ up) > LEVEL_COSINE, SLAB * (high - low)
    floor, ceiling = level & (heights < low + margin), level & (heights > high - margin)
    return float(areas[floor].sum() - areas[ceiling].sum())


def _is_wide(means: np.ndarray, up: np.ndarray) -> bool:
    """Whether the sides of a scene across a direction have about the same length."""
    across = means @ np.linalg.svd(up[None])[2][1:].T
    _, axes = np.linalg.eigh(np.cov(across.T))
    sides = np.ptp(np.percentile(across @ axes, [2, 98], axis=0), axis=0)
    return bool(sides.max() < MAX_ASPECT * sides.min())
