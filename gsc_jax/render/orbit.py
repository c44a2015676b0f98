"""Cameras around a scene, and poses that look at a point.

Only opaque Gaussians define where a scene is: faint ones are often floaters far outside.
"""

from collections.abc import Sequence

import numpy as np

from gsc_jax.scene import Array, Camera, Gaussians, InputError
from gsc_jax.scene.camera import intrinsics
from gsc_jax.scene.errors import in_range
from gsc_jax.scene.gaussians import usable_rows

ELEVATIONS = np.radians([10.0, 25.0, 40.0])
"""Angles above the horizon that the cameras of an orbit take in turn: usual ones in captures."""
RADIUS_PERCENTILE = 90
"""Percentile of the distances from the centre that is the radius of a scene: most Gaussians."""
DISTANCE_MARGIN = 1.1
"""Distance of an orbit in units of the distance at which the scene exactly fills the image."""
FOV_DEGREES = 0.01, 179.0
"""Fields of view of an orbit: beyond them, a pinhole camera has no usable focal length."""
DEFAULT_UP = np.array([0.0, -1.0, 0.0])
"""Up direction of most scenes from COLMAP."""
MAX_SIDE = MAX_CAMERAS = 10**6
"""Largest side of an image in pixels, and number of cameras."""
MIN_MEAN_UP = 1e-3
"""Length of a mean of unit vectors below which they cancel, and only rounding gives a direction."""


def orbit_cameras(
    gaussians: Gaussians,
    n: int,
    *,
    size: tuple[int, int] = (640, 480),
    fov_degrees: float = 60.0,
    up: Array | Sequence[float] = (0.0, -1.0, 0.0),
    seed: int = 0,
) -> list[Camera]:
    """Place cameras on a circle around a scene, at three elevations, looking at its centre.

    The centre is the median of the opaque Gaussians. A sphere around most of them fills the image.
    Rows that cannot be rendered are ignored.

    Args:
        gaussians: The scene.
        n: Number of cameras; their names are orbit_000, orbit_001 and so on.
        size: Image width and height in pixels.
        fov_degrees: Horizontal field of view, 0.01 to 179.
        up: Up direction of the world, any length, shape (3,); -y in most scenes from COLMAP.
        seed: Seed of the azimuth of the first camera.

    Returns:
        n cameras, NumPy float32.

    Raises:
        InputError: if n, size, field of view or up is invalid, or no Gaussian can be rendered.
    """
    up = np.asarray(up, np.float64)
    valid_up = up.shape == (3,) and 0 < np.linalg.norm(up) < np.inf
    valid_size = np.shape(size) == (2,) and all(in_range(side, 1, MAX_SIDE) for side in size)
    valid = in_range(n, 1, MAX_CAMERAS) and in_range(fov_degrees, *FOV_DEGREES)
    if not (valid and valid_size and valid_up):
        raise InputError(
            f"orbit of {n!r} cameras, size {size}, field of view {fov_degrees!r} degrees, up {up}: "
            "expected at least one camera, whole numbers of cameras and pixels, an angle from "
            "0.01 to 179, and a direction of three numbers"
        )
    (width, height), (center, radius) = size, scene_extent(gaussians)
    focal = 0.5 * width / np.tan(0.5 * np.radians(fov_degrees))
    distance = DISTANCE_MARGIN * radius / np.sin(np.arctan(0.5 * min(size) / focal))
    up = up / np.linalg.norm(up)
    K, eyes = intrinsics(focal, width, height), center + distance * _directions(n, up, seed)
    return [
        Camera(viewmat=pose, K=K.copy(), width=width, height=height, name=f"orbit_{index:03d}")
        for index, pose in enumerate(look_at(eye, center, up) for eye in eyes)
    ]


def opaque_means(gaussians: Gaussians) -> np.ndarray:
    """Centres of the Gaussians with an opacity above one half, or of all if there are none."""
    means = np.asarray(gaussians.means, np.float64)
    opaque = np.asarray(gaussians.logit_opacities) > 0
    return means[opaque] if opaque.any() else means


def scene_extent(gaussians: Gaussians) -> tuple[np.ndarray, float]:
    """Centre and radius of a scene; the radius is at least three standard deviations."""
    gaussians = gaussians.take(np.flatnonzero(usable_rows(gaussians)))
    if not len(gaussians):
        raise InputError("the scene has no Gaussian that can be rendered")
    means = opaque_means(gaussians)
    center = np.median(means, axis=0)
    radius = np.percentile(np.linalg.norm(means - center, axis=1), RADIUS_PERCENTILE)
    largest = np.asarray(gaussians.log_scales, np.float64).max(axis=1)
    # At a smaller distance, rounding would leave no direction from the camera to the centre.
    least = float(np.finfo(np.float32).eps) * max(1.0, float(np.abs(center).max()))
    return center, max(float(radius), 3 * float(np.exp(np.median(largest))), least)


def _directions(n: int, up: np.ndarray, seed: int) -> np.ndarray:
    """Unit vectors from the centre to the cameras, shape (n, 3)."""
    azimuths = np.random.default_rng(seed).uniform(0, 2 * np.pi) + 2 * np.pi * np.arange(n) / n
    elevations = np.resize(ELEVATIONS, n)
    side = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    side /= np.linalg.norm(side)
    flat = np.outer(np.cos(azimuths), side) + np.outer(np.sin(azimuths), np.cross(up, side))
    return np.cos(elevations)[:, None] * flat + np.outer(np.sin(elevations), up)


def look_at(eye: np.ndarray, target: np.ndarray, up: np.ndarray) -> np.ndarray:
    """World to camera, (4, 4) float32, of a level camera at `eye` that looks at `target`."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    viewmat = np.eye(4)
    viewmat[:3, :3] = right, np.cross(forward, right), forward
    viewmat[:3, 3] = -viewmat[:3, :3] @ eye
    return viewmat.astype(np.float32)


def mean_up(cameras: Sequence[Camera]) -> np.ndarray:
    """Up direction of a scene, unit, (3,): the mean over cameras; `DEFAULT_UP` if they cancel."""
    up = -np.mean([np.asarray(camera.viewmat, np.float64)[1, :3] for camera in cameras], axis=0)
    length = np.linalg.norm(up)
    return up / length if length > MIN_MEAN_UP else DEFAULT_UP.copy()
