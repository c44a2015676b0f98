"""Views of a scene: cameras around it, and whether given cameras see it at all.

The commonest trouble of all is a scene and cameras that do not belong together, because an exporter
normalised the scene or the poses follow another convention; then every image is empty and every
result is zero. Counting the centres in the frustums tells before anything is rendered. Only opaque
Gaussians count here: faint ones are often floaters far outside.
"""

from collections.abc import Sequence

import numpy as np

from gsc_jax.scene import Array, Camera, Gaussians, InputError

ELEVATIONS = np.radians([10.0, 25.0, 40.0])
"""Angles above the horizon that an orbit takes in turn."""

RADIUS_PERCENTILE = 90
MARGIN = 1.1
"""How much farther away an orbit is than its sphere needs to fill the image."""


def orbit_cameras(
    gaussians: Gaussians,
    n: int,
    *,
    width: int = 640,
    height: int = 480,
    fov_degrees: float = 60.0,
    up: Array | Sequence[float] | None = None,
    seed: int = 0,
) -> list[Camera]:
    """Cameras on a circle around a scene, at three elevations, all looking at its centre.

    The centre is the median of the opaque Gaussians; the distance is such that a sphere around
    most of them fills the image, so that floaters move neither.

    Args:
        gaussians: The scene.
        n: Number of cameras, called orbit_000, orbit_001 and so on.
        width: Image width in pixels.
        height: Image height in pixels.
        fov_degrees: Horizontal field of view.
        up: Direction that is up in the world, any length, shape (3,); by default -y, as in scenes
            from COLMAP.
        seed: Decides the azimuth of the first camera.

    Returns:
        n cameras, NumPy float32.

    Raises:
        InputError: if there are no cameras to place, or an argument is out of its range.
    """
    up = np.array([0.0, -1.0, 0.0]) if up is None else np.asarray(up, np.float64)
    if (
        n < 1
        or not 0 < fov_degrees < 180
        or up.shape != (3,)
        or not 0 < np.linalg.norm(up) < np.inf
    ):
        raise InputError(
            f"orbit of {n} cameras, field of view {fov_degrees} degrees, up {up}: expected at "
            "least one camera, an angle between 0 and 180, and a direction of three numbers"
        )
    center, radius = _extent(gaussians)
    focal = 0.5 * width / np.tan(0.5 * np.radians(fov_degrees))
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], np.float32)
    distance = MARGIN * radius / np.sin(np.arctan(0.5 * min(width, height) / focal))
    up = up / np.linalg.norm(up)
    return [
        Camera(
            viewmat=look_at(center + distance * direction, center, up),
            K=K,
            width=width,
            height=height,
            name=f"orbit_{index:03d}",
        )
        for index, direction in enumerate(_directions(n, up, seed))
    ]


def opaque_means(gaussians: Gaussians) -> np.ndarray:
    """Centres of the Gaussians with an opacity above one half, or of all if there are none."""
    means = np.asarray(gaussians.means, np.float64)
    opaque = np.asarray(gaussians.logit_opacities) > 0
    return means[opaque] if opaque.any() else means


def _extent(gaussians: Gaussians) -> tuple[np.ndarray, float]:
    """Centre and radius; a scene without any extent gets three standard deviations."""
    means = opaque_means(gaussians)
    center = np.median(means, axis=0)
    radius = np.percentile(np.linalg.norm(means - center, axis=1), RADIUS_PERCENTILE)
    largest = np.asarray(gaussians.log_scales, np.float64).max(axis=1)
    return center, max(float(radius), 3 * float(np.exp(np.median(largest))))


def _directions(n: int, up: np.ndarray, seed: int) -> np.ndarray:
    """Unit vectors from the centre to the cameras, shape (n, 3)."""
    azimuths = np.random.default_rng(seed).uniform(0, 2 * np.pi)
    azimuths = azimuths + 2 * np.pi * np.arange(n) / n
    elevations = np.resize(ELEVATIONS, n)
    side = np.cross(up, np.eye(3)[np.argmin(np.abs(up))])
    side /= np.linalg.norm(side)
    flat = np.outer(np.cos(azimuths), side) + np.outer(np.sin(azimuths), np.cross(up, side))
    return np.cos(elevations)[:, None] * flat + np.outer(np.sin(elevations), up)


def look_at(eye: np.ndarray, target: np.ndarray, up: np.ndarray) -> np.ndarray:
    """World to camera [4, 4] float32 of a level camera at `eye` that looks at `target`."""
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    viewmat = np.eye(4)
    viewmat[:3, :3] = right, np.cross(forward, right), forward
    viewmat[:3, 3] = -viewmat[:3, :3] @ eye
    return viewmat.astype(np.float32)


def mean_up(cameras: Sequence[Camera]) -> np.ndarray:
    """Up direction of a scene, shape (3,): cameras are mostly held level, with y pointing down."""
    up = -np.mean([np.asarray(camera.viewmat)[1, :3] for camera in cameras], axis=0)
    return up / np.linalg.norm(up)
