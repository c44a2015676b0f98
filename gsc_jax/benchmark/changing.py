"""Modification: a region of a scene with other colours, texture, size or shape.

Colours change by a map of RGB that all harmonics follow. Size and shape change by a warp of space,
which acts on a Gaussian by its local linear part J: the covariance becomes J S J^t, and scales and
rotation are read from it again.
"""

import dataclasses
import itertools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.benchmark.draft import Draft, Unsuitable
from gsc_jax.benchmark.regions import CONTRAST, Region, Sight, grow, pick
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Gaussians

Warp = Callable[[jax.Array], jax.Array]

MIN_ROWS = 8
"""Regions of fewer Gaussians are no region."""
KINDS = ("colour", "texture", "scale", "shape")


def modified(gaussians: Gaussians, sight: Sight, size: float, rng: np.random.Generator) -> Draft:
    """Change a compact region of a scene; chance says which and how.

    Args:
        gaussians: N Gaussians of the scene.
        sight: What the cameras see of them.
        size: Median share of the pixels that the changed region is to cover.
        rng: Source of randomness.

    Returns:
        The N Gaussians in their order.

    Raises:
        Unsuitable: if the region is next to empty.
    """
    kind = str(rng.choice(KINDS))
    factor = rng.uniform(1.3, 1.7) if kind == "scale" else 1.0
    seed = pick(sight, 1, rng)[0]
    region = grow(gaussians, sight, seed, size / factor**2, contrast=CONTRAST)
    if len(region.rows) < MIN_ROWS:
        raise Unsuitable(f"a region of {len(region.rows)} Gaussians")
    before = gaussians.take(region.rows)
    if kind == "colour":
        after, what = recolored(before, rng)
    elif kind == "texture":
        after, what = patterned(before, region, rng)
    elif kind == "scale":
        after = warped(before, resized(region, factor))
        what = f"made {factor:.1f} times as large"
    else:
        after, what = _reshaped(before, region, rng)
    # A warp that fades out leaves the rim as it was: those rows stay, bit by bit, and authentic.
    rows = np.flatnonzero(_changed(before, after, region.radius))
    labels = np.zeros(len(gaussians), bool)
    labels[region.rows[rows]] = True
    return Draft(
        _with_rows(gaussians, region.rows[rows], after.take(rows)),
        labels,
        f"a region of {len(rows):,} Gaussians, {what}",
        gaussians,
    )


def warped(gaussians: Gaussians, warp: Warp) -> Gaussians:
    """Move Gaussians by a smooth map of space, and reshape them by its local linear part.

    Args:
        gaussians: N Gaussians with finite means; their colours stay.
        warp: Map of one point, shape (3,), to another.

    Returns:
        The warped Gaussians, float32.
    """
    from scipy.spatial.transform import Rotation

    means = jnp.asarray(gaussians.means)
    # One compilation instead of one per operation, for each region has another size.
    moved, jacobians = jax.jit(jax.vmap(lambda x: (warp(x), jax.jacfwd(warp)(x))))(means)
    turns = Rotation.from_quat(np.asarray(gaussians.rotations), scalar_first=True).as_matrix()
    axes, scales, _ = np.linalg.svd(
        np.asarray(jacobians, np.float64) @ turns * np.asarray(gaussians.scales)[:, None]
    )
    axes, scales = _in_order_of(turns, axes, scales)
    quats = Rotation.from_matrix(axes).as_quat(scalar_first=True)
    before = np.asarray(gaussians.quats, np.float64)
    quats *= np.sign(np.sum(quats * before, axis=1, keepdims=True) + 1e-30)
    return dataclasses.replace(
        gaussians,
        means=np.asarray(moved),
        log_scales=np.log(np.maximum(scales, 1e-30)).astype(np.float32),
        quats=(quats * np.linalg.norm(before, axis=1, keepdims=True)).astype(np.float32),
    )


def _in_order_of(
    turns: np.ndarray, axes: np.ndarray, scales: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Axes and scales in the order and sense of the columns of rotations, shapes (N, 3, 3).

    The decomposition sorts them by size, which would mark a warped Gaussian whatever the warp.
    """
    match = np.einsum("nij,nik->njk", turns, axes)
    orders = np.array(list(itertools.permutations(range(3))))
    fits = np.abs(match[:, np.arange(3), orders]).sum(axis=-1)
    order = orders[np.argmax(fits, axis=1)]
    axes = np.take_along_axis(axes, order[:, None], axis=2)
    axes = axes * np.sign(np.sum(axes * turns, axis=1, keepdims=True) + 1e-30)
    axes[..., 2] *= np.sign(np.linalg.det(axes))[:, None]
    return axes, np.take_along_axis(scales, order, axis=1)


def _changed(before: Gaussians, after: Gaussians, radius: float) -> np.ndarray:
    """The rows whose place, size, rotation or colour is another now, shape (N,)."""
    tolerances = {"means": 1e-3 * radius, "log_scales": 1e-2, "quats": 1e-2, "sh": 1e-3}
    differs = [
        np.abs(np.asarray(getattr(after, name)) - getattr(before, name)) > tolerance
        for name, tolerance in tolerances.items()
    ]
    return np.any([d.reshape(len(d), -1).any(axis=1) for d in differs], axis=0)


def recolored(gaussians: Gaussians, rng: np.random.Generator) -> tuple[Gaussians, str]:
    """Turn the hue of all harmonics and shift the plain colour; says by how much."""
    from scipy.spatial.transform import Rotation

    angle = rng.uniform(80, 280)
    # A turn about the grey axis of RGB leaves 0.5 + Y h consistent for every harmonic h.
    turn = Rotation.from_rotvec(np.radians(angle) * np.ones(3) / np.sqrt(3)).as_matrix()
    sh = np.asarray(gaussians.sh) @ turn.T
    shift = rng.choice([-1, 1]) * rng.uniform(0.05, 0.15) + _tint(rng, 0.2)
    sh[:, 0] += shift / Y0
    recoloured = dataclasses.replace(gaussians, sh=sh.astype(np.float32))
    return recoloured, f"its hue turned by {angle:.0f} degrees and its colour shifted"


def patterned(
    gaussians: Gaussians, region: Region, rng: np.random.Generator
) -> tuple[Gaussians, str]:
    """Print stripes or checks of another colour over a region."""
    wave = rng.uniform(0.25, 0.5) * region.radius
    axes = np.linalg.svd(np.cross(region.towards, np.eye(3)))[2][:2]
    phases = 2 * np.pi * (np.asarray(gaussians.means) - region.center) @ axes.T / wave
    checks = rng.random() < 0.5
    pattern = np.sin(phases[:, 0]) * (np.sin(phases[:, 1]) if checks else 1)
    sh = np.array(gaussians.sh)
    sh[:, 0] += np.where(pattern > 0, 1, -1)[:, None] * (_tint(rng, 0.15) + 0.12) / Y0
    printed = dataclasses.replace(gaussians, sh=sh.astype(np.float32))
    return printed, f"{'checks' if checks else 'stripes'} {wave:.2g} wide printed on it"


def _reshaped(before: Gaussians, region: Region, rng: np.random.Generator) -> tuple[Gaussians, str]:
    if rng.random() < 0.5:
        angle = rng.choice([-1, 1]) * rng.uniform(90, 200)
        after = warped(before, twisted(region, np.radians(angle)))
        return after, f"its middle twisted by {angle:.0f} degrees"
    swell = rng.uniform(0.4, 0.8) * region.radius
    return warped(before, swollen(region, swell)), f"its middle lifted by {swell:.2g}"


def resized(region: Region, factor: float) -> Warp:
    """The warp that scales a region about its middle."""
    center = jnp.asarray(region.center, jnp.float32)
    # A little towards the cameras, or a sheet that grows would lie within what is around it.
    lift = jnp.asarray(0.03 * region.radius * region.towards, jnp.float32)
    return lambda x: center + lift + jnp.float32(factor) * (x - center)


def twisted(region: Region, angle: float) -> Warp:
    """The warp that turns a region about the line to the cameras, most in its middle."""
    axis, center = (jnp.asarray(v, jnp.float32) for v in (region.towards, region.center))

    def warp(x):
        offset = x - center
        along = jnp.dot(offset, axis) * axis
        across = offset - along
        fall = jnp.maximum(1 - jnp.dot(across, across) / (1.2 * region.radius) ** 2, 0.0)
        turn = jnp.float32(angle) * fall**2
        turned = jnp.cos(turn) * across + jnp.sin(turn) * jnp.cross(axis, across)
        return center + along + turned

    return warp


def swollen(region: Region, height: float) -> Warp:
    """The warp that lifts a region towards the cameras, most in its middle."""
    axis, center = (jnp.asarray(v, jnp.float32) for v in (region.towards, region.center))

    def warp(x):
        offset = x - center
        across = offset - jnp.dot(offset, axis) * axis
        fall = jnp.maximum(1 - jnp.dot(across, across) / (1.2 * region.radius) ** 2, 0.0)
        return x + jnp.float32(height) * fall**2 * axis

    return warp


def _tint(rng: np.random.Generator, strength: float) -> np.ndarray:
    """A shift of RGB without a change of grey."""
    tint = rng.normal(size=3)
    tint -= tint.mean()
    return strength * tint / np.linalg.norm(tint)


def _with_rows(gaussians: Gaussians, rows: np.ndarray, changed: Gaussians) -> Gaussians:
    def put(leaf, new):
        leaf = np.array(leaf)
        leaf[rows] = new
        return leaf

    return jax.tree.map(put, gaussians, changed)
