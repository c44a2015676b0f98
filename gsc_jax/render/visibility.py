"""Whether cameras see a scene at all."""

from collections.abc import Sequence

import numpy as np

from gsc_jax.render.orbit import opaque_means
from gsc_jax.render.projection import NEAR
from gsc_jax.scene import Gaussians, InputError
from gsc_jax.scene.camera import Camera

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
    points = _sample(opaque_means(gaussians))
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


def _sample(points: np.ndarray) -> np.ndarray:
    count = min(len(points), SAMPLE)
    return points[np.linspace(0, len(points) - 1, count).astype(np.int64)]


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
