"""Cameras inside a room, where those of an orbit would look at its walls from behind.

Surfaces are found along rays, from the Gaussians that cover most: along a ray, each has the opacity
of the point nearest to its centre in its own metric; at the surface, half of the light is absorbed.
"""

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from gsc_jax.render.orbit import look_at, opaque_means, scene_extent
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.camera import intrinsics
from gsc_jax.scene.gaussians import rotation_matrices

MAX_GAUSSIANS = 20_000
"""Gaussians of largest opacity times area in which surfaces are looked for."""
HIDDEN_SHARE, CONTENT_SHARE = 0.5, 0.01
"""A room hides its centre from more than this share of an orbit (0.6 to 0.8; 0 to 0.2 outdoors, 0
to 0.75 in single objects), and has contents: this share of its Gaussians, or more, is nearer to the
centre than a quarter of the radius (0.03 to 0.06 in rooms, 0 in a hollow vase)."""
LIFTS = np.linspace(0, 0.5, 6)
"""Heights of the cameras over the centre that are tried, in radii of the scene."""
REACH, FOV_DEGREES = 0.75, 80.0
"""Part of the way to the wall behind a camera, and a horizontal field of view for rooms."""
MIN_LOG_SCALE = -12.0


def moved_indoors(
    gaussians: Gaussians, cameras: Sequence[Camera], up: np.ndarray
) -> list[Camera] | None:
    """Move the cameras of an orbit that a wall hides the centre from into the room.

    Each looks at that wall from inside, over the centre. The others stay: they look through an
    opening, or from above. None if the centre is hidden from few cameras, as it is outdoors. All
    Gaussians can be rendered; `up` is the unit up direction, shape (3,).
    """
    center, radius = scene_extent(gaussians)
    surface = surface_finder(gaussians)
    rays = [np.asarray(camera.center, np.float64) - center for camera in cameras]
    hidden = [surface(center + ray, -ray) < np.linalg.norm(ray) - radius / 2 for ray in rays]
    nearby = np.linalg.norm(opaque_means(gaussians) - center, axis=1) < radius / 4
    if np.mean(hidden) <= HIDDEN_SHARE or np.mean(nearby) < CONTENT_SHARE:
        return None
    level = [ray - (ray @ up) * up for ray in rays]
    away = [0.1 * up - ray / np.linalg.norm(ray) for ray in level]
    heights = [center + lift * radius * up for lift in LIFTS]
    free = np.array([[min(surface(eye, ray), radius) for ray in away] for eye in heights])
    room = np.median(free, axis=1)
    chosen = int(np.argmax(room >= 0.8 * room.max()))  # not above what has no ceiling
    reach = np.maximum(REACH * free[chosen], 0.05 * radius)
    moved = list(cameras)
    for i in np.flatnonzero(hidden):
        viewmat = look_at(heights[chosen] + reach[i] * away[i], center, up)
        focal = 0.5 * moved[i].width / np.tan(np.radians(FOV_DEGREES / 2))
        K = intrinsics(focal, moved[i].width, moved[i].height)
        moved[i] = dataclasses.replace(moved[i], viewmat=viewmat, K=K)
    return moved


def surface_finder(gaussians: Gaussians) -> Callable[[np.ndarray, np.ndarray], float]:
    """Function from origin and direction of a ray, (3,), to its distance to a surface, or inf."""
    log_scales = np.maximum(np.asarray(gaussians.log_scales, np.float64), MIN_LOG_SCALE)
    opacities = np.asarray(gaussians.opacities, np.float64)
    size = np.log(np.maximum(opacities, 1e-9)) + np.sort(log_scales, axis=1)[:, 1:].sum(axis=1)
    rows = np.argsort(-size)[:MAX_GAUSSIANS]
    means, opacities = np.asarray(gaussians.means, np.float64)[rows], opacities[rows]
    # Distances in the metric of a Gaussian are those after a multiplication by this matrix.
    whitening = (rotation_matrices(gaussians.take(rows)) / np.exp(log_scales[rows])[:, None]).mT
    centers = (whitening @ means[:, :, None])[..., 0]

    def surface(origin: np.ndarray, direction: np.ndarray) -> float:
        step = whitening @ (direction / np.linalg.norm(direction))
        offset = centers - whitening @ origin
        distance = (offset * step).sum(axis=1) / (step * step).sum(axis=1)
        off_axis = ((offset - distance[:, None] * step) ** 2).sum(axis=1)
        alpha = np.minimum(opacities * np.exp(-0.5 * off_axis), 0.99)
        ahead = np.flatnonzero((distance > 0) & (alpha > 1 / 255))
        order = ahead[np.argsort(distance[ahead])]
        half = np.flatnonzero(np.cumsum(np.log1p(-alpha[order])) < np.log(0.5))
        return float(distance[order[half[0]]]) if len(half) else np.inf

    return surface
