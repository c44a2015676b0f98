"""Incorporation as editors make it: cut from another capture, lit like its place, contact cleaned.

An object is cut from its background, well or with some of the background left on it; pasted by
`paste_object`, which adapts its scale; its colours get the exposure, the white balance and the
contrast of the Gaussians around it (Reinhard et al. 2001, in RGB); and at the contact, what lies
below the ground of the object and what of the scene is inside of it is deleted.
"""

import dataclasses

import numpy as np
from scipy.spatial import ConvexHull, Delaunay, KDTree, QhullError

from gsc_jax.benchmark import regions
from gsc_jax.benchmark.incorporation import paste_object
from gsc_jax.scene import Gaussians

STRENGTH = (0.4, 0.9)
"""Share of the way to the colours of the place that an object goes, at least and at most."""
MAX_GAIN = 1.6
"""The contrast of an object is multiplied by at most this number, and by at least its inverse."""
PLACE_REACH = 2.0
"""An object takes on the light of what lies within this many of its radii from its middle."""
GROUND_DEPTH = 0.02
"""Share of the height of an object that may lie below the ground."""
CORE = 0.9
"""Size of the core of an object in which nothing of the scene is left, relative to its hull."""


def incorporate(
    gaussians: Gaussians,
    visibility: regions.Visibility,
    size: float,
    rng: np.random.Generator,
    donor: Gaussians,
) -> regions.ProposedEdit:
    """Paste an object, light it like what is around it, and delete what overlaps there.

    The arguments are those of `paste_object`.
    """
    pasted = paste_object(gaussians, visibility, size, rng, donor)
    scene, labels = pasted.gaussians, pasted.labels
    lit = lit_like(scene, labels, place_of(scene, labels), rng.uniform(*STRENGTH))
    deleted = contact(lit, labels, visibility.up)
    what = (
        f"{pasted.description}, lit like its place, with {np.sum(deleted & labels):,} of its "
        f"Gaussians and {np.sum(deleted & ~labels):,} of the scene deleted at the contact"
    )
    kept = np.flatnonzero(~deleted)
    return regions.ProposedEdit(lit.take(kept), labels[kept], what)


def place_of(scene: Gaussians, labels: np.ndarray) -> np.ndarray:
    """Opaque Gaussians of the scene around an object, (N,) bool; the nearest if there is none."""
    means, opaque = np.asarray(scene.means, np.float64), np.asarray(scene.opacities) > 0.5
    center = np.median(means[labels], axis=0)
    apart = np.where(opaque & ~labels, np.linalg.norm(means - center, axis=1), np.inf)
    radius = np.quantile(np.linalg.norm(means[labels] - center, axis=1), 0.9)
    return (apart <= max(PLACE_REACH * radius, apart.min())) & np.isfinite(apart)


def lit_like(scene: Gaussians, labels: np.ndarray, place: np.ndarray, strength: float) -> Gaussians:
    """Bring mean and spread of the colours of an object nearer to those of its place.

    `labels` (N,) bool mark the object and `place` (N,) bool its place. With a `strength` of 0 the
    colours stay as they are, with 1 they have the mean of the place. The map is affine in each
    channel: the higher harmonics are multiplied as the contrast is.
    """
    sh = np.array(scene.sh, np.float64)
    opaque = labels & (np.asarray(scene.opacities) > 0.5)
    own, other = sh[opaque if opaque.any() else labels, 0], sh[place, 0]
    ratio = (other.std(axis=0) + 1e-3) / (own.std(axis=0) + 1e-3)
    gain = np.clip(ratio, 1 / MAX_GAIN, MAX_GAIN) ** strength
    mean = own.mean(axis=0) + strength * (other.mean(axis=0) - own.mean(axis=0))
    sh[labels] *= gain
    sh[labels, 0] += mean - gain * own.mean(axis=0)
    return dataclasses.replace(scene, sh=sh.astype(np.float32))


def contact(scene: Gaussians, labels: np.ndarray, up: np.ndarray) -> np.ndarray:
    """Gaussians to delete where an object touches the scene, (N,) bool.

    The ground is at the median height of the Gaussians of the scene that are nearest to the foot of
    the object. Deleted are those of the object that are too deep below it, and those of the scene
    that are above it in the core of the object.
    """
    means = np.asarray(scene.means, np.float64)
    levels, rows = means @ up, np.flatnonzero(labels)
    foot, top = np.quantile(levels[rows], [0.02, 0.98])
    low = rows[levels[rows] <= foot + 0.1 * (top - foot)]
    others = np.flatnonzero(~labels & (np.asarray(scene.opacities) > 0.5))
    near = others[KDTree(means[others]).query(means[low])[1]]
    ground = np.median(levels[near])
    depth = GROUND_DEPTH * (top - foot)
    return np.where(
        labels, levels < ground - depth, _in_core(means, means[rows]) & (levels > ground + depth)
    )


def _in_core(points: np.ndarray, body: np.ndarray) -> np.ndarray:
    """Whether points (N, 3) lie in the shrunk convex hull of a body (M, 3), shape (N,)."""
    center = np.median(body, axis=0)
    apart = np.linalg.norm(body - center, axis=1)
    body = body[apart <= np.quantile(apart, 0.98)]
    try:
        corners = body[ConvexHull(body).vertices]
    except QhullError:  # a flat object has no core
        return np.zeros(len(points), bool)
    return Delaunay(center + CORE * (corners - center)).find_simplex(points) >= 0
