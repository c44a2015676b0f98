"""Modification: change the colour, texture, size or shape of a region of a scene.

Colours change by a map of RGB that applies to all harmonics. Size and shape change by a warp of
space, which acts on a Gaussian by its Jacobian J: the covariance S becomes J S J^T, from which
scales and rotation are decomposed again.
"""

import dataclasses
import itertools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from gsc_jax.benchmark import regions
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Gaussians
from gsc_jax.scene.gaussians import concatenate

KINDS = ("colour", "texture", "scale", "shape")


def modify_region(
    gaussians: Gaussians, visibility: regions.Visibility, size: float, rng: np.random.Generator
) -> regions.ProposedEdit:
    """Change a random region that covers `size`, a median share of the pixels, in a random way."""
    kind = str(rng.choice(KINDS))
    factor = rng.uniform(1.3, 1.7) if kind == "scale" else 1.0
    region = regions.draw_object(gaussians, visibility, size / factor**2, rng)
    before = gaussians.take(region.rows)
    if kind == "colour":
        after, change = recolour(before, rng)
    elif kind == "texture":
        after, change = add_pattern(before, region, rng)
    elif kind == "scale":
        after = warp_gaussians(before, lambda x: scaling(x, region, factor))
        change = f"made {factor:.1f} times as large"
    elif rng.random() < 0.5:  # of kind "shape", like the next one
        angle = rng.choice([-1, 1]) * rng.uniform(90, 200)
        after = warp_gaussians(before, lambda x: twist(x, region, np.radians(angle)))
        change = f"its middle twisted by {angle:.0f} degrees"
    else:
        height = rng.uniform(0.4, 0.8) * region.radius
        after = warp_gaussians(before, lambda x: bulge(x, region, height))
        change = f"its middle lifted by {height:.2g}"
    # A warp that fades out leaves the border as it was: those rows stay authentic to the bit.
    changed = changed_rows(before, after, region.radius)
    rows = region.rows[changed]
    labels = np.isin(np.arange(len(gaussians)), rows)
    what = f"a region of {len(rows):,} Gaussians, {change}"
    edited = with_rows(gaussians, rows, after.take(changed))
    return regions.ProposedEdit(edited, labels, what, gaussians)


def warp_gaussians(gaussians: Gaussians, warp: Callable[[jax.Array], jax.Array]) -> Gaussians:
    """Move Gaussians by a map of points (3,), and reshape them by its Jacobian."""
    # One compilation instead of one per operation, since each region has another size.
    moved, jacobians = jax.jit(jax.vmap(lambda x: (warp(x), jax.jacfwd(warp)(x))))(gaussians.means)
    rotations = Rotation.from_quat(np.asarray(gaussians.rotations), scalar_first=True).as_matrix()
    shapes = np.asarray(jacobians, np.float64) @ rotations * np.asarray(gaussians.scales)[:, None]
    axes, scales = _match_axes(rotations, *np.linalg.svd(shapes)[:2])
    quats = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    before = np.asarray(gaussians.quats, np.float64)
    quats *= np.sign(np.sum(quats * before, axis=1, keepdims=True) + 1e-30)
    quats = (quats * np.linalg.norm(before, axis=1, keepdims=True)).astype(np.float32)
    sizes = np.log(np.maximum(scales, 1e-30)).astype(np.float32)
    return dataclasses.replace(gaussians, means=np.asarray(moved), log_scales=sizes, quats=quats)


def _match_axes(
    rotations: np.ndarray, axes: np.ndarray, scales: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Order and orient axes (N, 3, 3) like the columns of rotations, and their scales likewise."""
    # The singular value decomposition sorts axes by size, which would reveal warped Gaussians.
    match = np.einsum("nij,nik->njk", rotations, axes)
    orders = np.array(list(itertools.permutations(range(3))))
    agreement = np.abs(match[:, np.arange(3), orders]).sum(axis=-1)
    order = orders[np.argmax(agreement, axis=1)]
    axes = np.take_along_axis(axes, order[:, None], axis=2)
    axes = axes * np.sign(np.sum(axes * rotations, axis=1, keepdims=True) + 1e-30)
    axes[..., 2] *= np.sign(np.linalg.det(axes))[:, None]
    return axes, np.take_along_axis(scales, order, axis=1)


def changed_rows(before: Gaussians, after: Gaussians, radius: float) -> np.ndarray:
    """Mask of the rows of which a parameter visibly changed, shape (N,)."""
    tolerances = {"means": 1e-3 * radius, "log_scales": 1e-2, "quats": 1e-2, "sh": 1e-3}
    tolerances["logit_opacities"] = 1e-2
    differs = [
        np.abs(np.asarray(getattr(after, name)) - getattr(before, name)) > tolerance
        for name, tolerance in tolerances.items()
    ]
    return np.any([d.reshape(len(d), -1).any(axis=1) for d in differs], axis=0)


def recolour(gaussians: Gaussians, rng: np.random.Generator) -> tuple[Gaussians, str]:
    """Rotate the hue of all harmonics and shift the base colour; also describe the change."""
    angle = rng.uniform(80, 280)
    # A rotation about the grey axis of RGB keeps 0.5 + Y h consistent for every harmonic h.
    rotation = Rotation.from_rotvec(np.radians(angle) * np.ones(3) / np.sqrt(3)).as_matrix()
    sh = np.asarray(gaussians.sh) @ rotation.T
    sh[:, 0] += (rng.choice([-1, 1]) * rng.uniform(0.05, 0.15) + _tint(rng, 0.2)) / Y0
    recoloured = dataclasses.replace(gaussians, sh=sh.astype(np.float32))
    return recoloured, f"its hue turned by {angle:.0f} degrees and its colour shifted"


def add_pattern(
    gaussians: Gaussians, region: regions.Region, rng: np.random.Generator
) -> tuple[Gaussians, str]:
    """Add stripes or checks of another colour to a region; also describe the change."""
    wavelength = rng.uniform(0.25, 0.5) * region.radius
    axes = np.linalg.svd(np.cross(region.towards, np.eye(3)))[2][:2]
    phases = 2 * np.pi * (np.asarray(gaussians.means) - region.center) @ axes.T / wavelength
    checks = rng.random() < 0.5
    pattern = np.sin(phases[:, 0]) * (np.sin(phases[:, 1]) if checks else 1)
    sh = np.array(gaussians.sh)
    sh[:, 0] += np.where(pattern > 0, 1, -1)[:, None] * (_tint(rng, 0.15) + 0.12) / Y0
    patterned = dataclasses.replace(gaussians, sh=sh.astype(np.float32))
    return patterned, f"{'checks' if checks else 'stripes'} {wavelength:.2g} wide printed on it"


def scaling(x: jax.Array, region: regions.Region, factor: float) -> jax.Array:
    """Scale a point of a region about its centre."""
    center = jnp.asarray(region.center, jnp.float32)
    # A small shift towards the cameras keeps an enlarged sheet in front of its surroundings.
    lift = jnp.asarray(0.03 * region.radius * region.towards, jnp.float32)
    return center + lift + jnp.float32(factor) * (x - center)


def twist(x: jax.Array, region: regions.Region, angle: float) -> jax.Array:
    """Rotate a point of a region about the direction to the cameras, most at its centre."""
    center, axis, along, across, decay = _split(x, region)
    turn = jnp.float32(angle) * decay
    return center + along + (jnp.cos(turn) * across + jnp.sin(turn) * jnp.cross(axis, across))


def bulge(x: jax.Array, region: regions.Region, height: float) -> jax.Array:
    """Shift a point of a region towards the cameras, most at its centre."""
    _, axis, _, _, decay = _split(x, region)
    return x + jnp.float32(height) * decay * axis


def _split(x: jax.Array, region: regions.Region) -> tuple[jax.Array, ...]:
    """Centre, axis, offset along and across the axis, and decay from 1 on the axis to 0."""
    axis, center = (jnp.asarray(v, jnp.float32) for v in (region.towards, region.center))
    offset = x - center
    along = jnp.dot(offset, axis) * axis
    across = offset - along
    decay = jnp.maximum(1 - jnp.dot(across, across) / (1.2 * region.radius) ** 2, 0.0)
    return center, axis, along, across, decay**2


def _tint(rng: np.random.Generator, strength: float) -> np.ndarray:
    """Random shift of RGB that does not change grey."""
    tint = rng.normal(size=3)
    tint -= tint.mean()
    return strength * tint / np.linalg.norm(tint)


def with_rows(gaussians: Gaussians, rows: np.ndarray, changed: Gaussians) -> Gaussians:
    """Copy of a scene with other Gaussians in these rows."""
    order = np.arange(len(gaussians))
    order[rows] = len(gaussians) + np.arange(len(changed))
    return concatenate([gaussians, changed]).take(order)
