"""Views of a scene: cameras around it, and whether given cameras see it at all.

The commonest trouble of all is a scene and cameras that do not belong together, because an exporter
normalised the scene or the poses follow another convention; then every image is empty and every
result is zero. Counting the centres in the frustums tells before anything is rendered. Only opaque
Gaussians count here: faint ones are often floaters far outside.
"""

from collections.abc import Sequence

import numpy as np

from gsc_jax.errors import InputError
from gsc_jax.projection import NEAR
from gsc_jax.scene import Array, Camera, Gaussians

ELEVATIONS = np.radians([10.0, 25.0, 40.0])
"""Angles above the horizon that an orbit takes in turn."""

RADIUS_PERCENTILE = 90
MARGIN = 1.1
"""How much farther away an orbit is than its sphere needs to fill the image."""

SAMPLE = 20_000
MIN_SHARE, LOW_SHARE = 0.01, 0.1
"""Shares of the Gaussians that cameras must see together, and should see."""

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
READINGS = {
    "with OpenGL axes (y up, z backward)": lambda viewmat: FLIP @ viewmat,
    "as world-to-camera": np.linalg.inv,
    "as world-to-camera with OpenGL axes": lambda viewmat: FLIP @ np.linalg.inv(viewmat),
}
"""What a pose may be instead of camera-to-world with OpenCV axes: how its viewmat is mended."""

NO_READING = (
    "; do they belong together? The exporter may have normalised the scene, or the poses may be "
    "world-to-camera or have OpenGL axes"
)


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


def check_views(
    gaussians: Gaussians, cameras: Sequence[Camera], *, near: float = NEAR
) -> list[str]:
    """Tells whether cameras see a scene, from the share of Gaussians inside any frustum.

    Large scenes are sampled evenly, so this takes well under a second.

    Args:
        gaussians: The scene.
        cameras: Cameras that are said to be of it.
        near: Depth below which nothing is rendered, in world units.

    Returns:
        Warnings, one line each: cameras that see nothing, a low share, a near plane that cuts
        most away. Empty if all is well.

    Raises:
        InputError: if there are no cameras, if together they see next to nothing, or if the near
            plane cuts away next to everything.
    """
    if not cameras:
        raise InputError("no cameras to look at the scene with; give at least one")
    if not len(gaussians):
        raise InputError("the scene has no Gaussians")
    points = _sample(_opaque_means(gaussians))
    viewmats = [np.asarray(camera.viewmat, np.float64) for camera in cameras]
    depths = _depths(points, viewmats, cameras)
    seen = depths > near
    share, share_ahead = seen.any(axis=0).mean(), (depths > 0).any(axis=0).mean()
    if share_ahead < MIN_SHARE:
        advice = _reading(points, viewmats, cameras) or NO_READING
        raise InputError(f"the cameras see {share_ahead:.2%} of the Gaussians{advice}")
    if share < MIN_SHARE:
        raise InputError(_near_message(depths, near))
    warnings = _scale_warnings(gaussians, points)
    if seen.sum() < 0.5 * (depths > 0).sum():
        warnings.append(_near_message(depths, near))
    if share < LOW_SHARE:
        warnings.append(f"the cameras together see only {share:.1%} of the Gaussians")
    blind = [camera.name for camera, row in zip(cameras, depths, strict=True) if not row.any()]
    if blind:
        named = ", ".join(blind[:5]) + (", ..." if len(blind) > 5 else "")
        advice = _reading(points, viewmats, cameras)
        warnings.append(f"{len(blind)} of {len(cameras)} cameras see nothing: {named}{advice}")
    return warnings


def _opaque_means(gaussians: Gaussians) -> np.ndarray:
    means = np.asarray(gaussians.means, np.float64)
    opaque = np.asarray(gaussians.logit_opacities) > 0
    return means[opaque] if opaque.any() else means


def _sample(points: np.ndarray) -> np.ndarray:
    count = min(len(points), SAMPLE)
    return points[np.linspace(0, len(points) - 1, count).astype(np.int64)]


def _extent(gaussians: Gaussians) -> tuple[np.ndarray, float]:
    """Centre and radius; a scene without any extent gets three standard deviations."""
    means = _opaque_means(gaussians)
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


def _depths(
    points: np.ndarray, viewmats: Sequence[np.ndarray], cameras: Sequence[Camera]
) -> np.ndarray:
    """Depths of the points inside each image, 0 outside of it, shape (cameras, points)."""
    depths = np.zeros((len(cameras), len(points)), np.float32)
    for row, viewmat, camera in zip(depths, viewmats, cameras, strict=True):
        pixels = (points @ viewmat[:3, :3].T + viewmat[:3, 3]) @ np.asarray(camera.K, np.float64).T
        u, v, z = pixels.T
        inside = (u >= 0) & (u <= camera.width * z) & (v >= 0) & (v <= camera.height * z)
        row[inside] = z[inside]
    return depths


def _reading(points: np.ndarray, viewmats: Sequence[np.ndarray], cameras: Sequence[Camera]) -> str:
    """The reading of the poses with which the typical camera sees much more; empty if none is."""
    current = _typical_share(_depths(points, viewmats, cameras))
    shares = {}
    for reading, mend in READINGS.items():
        mended = [mend(viewmat) for viewmat in viewmats]
        shares[reading] = _typical_share(_depths(points, mended, cameras))
    best = max(shares, key=shares.__getitem__)
    if shares[best] <= max(LOW_SHARE, 3 * current):
        return ""
    return (
        f"; perhaps the poses are to be read {best}: a camera would then typically see "
        f"{shares[best]:.0%}"
    )


def _scale_warnings(gaussians: Gaussians, points: np.ndarray) -> list[str]:
    """Scales that were stored as they are, not as logarithms, make every Gaussian huge."""
    log_scales = np.asarray(gaussians.log_scales)
    extent = np.ptp(np.percentile(points, [10, 90], axis=0), axis=0).max()
    if np.mean(log_scales >= 0) < 0.99 or np.exp(np.median(log_scales)) < 0.05 * extent:
        return []
    return [
        "the Gaussians are as large as the scene: its scales may not have been stored as "
        "logarithms; take the logarithm of scale_0, scale_1 and scale_2"
    ]


def _typical_share(depths: np.ndarray) -> float:
    # The median, because with any wrong reading some camera looks at the scene by chance.
    return float(np.median(np.mean(depths > 0, axis=1)))


def _near_message(depths: np.ndarray, near: float) -> str:
    ahead = depths[depths > 0]
    cut = np.mean(ahead <= near)
    fitting = 0.5 * np.percentile(ahead, 1)
    return (
        f"the near plane at {near:g} cuts away {cut:.0%} of what the cameras look at; the scene is "
        f"small for it: near={fitting:.1g} (--near) would fit, or scale scene and cameras up"
    )
