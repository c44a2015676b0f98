"""Check that cameras see a scene, by projecting the centres of its opaque Gaussians.

The most common cause of empty images is a scene that does not belong to the cameras, because an
exporter has normalised it or because the poses follow another convention.
"""

from collections.abc import Iterator, Sequence

import numpy as np

from gsc_jax.render.orbit import opaque_means, scene_extent
from gsc_jax.render.projection import MIN_ALPHA, NEAR
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Camera, Gaussians, InputError
from gsc_jax.scene.gaussians import check_shapes

MAX_POINTS = 20_000
"""Number of sampled centres: a share of 1 % has a standard error below 0.1 %."""
MIN_SHARE, LOW_SHARE = 0.01, 0.1
"""Shares of the Gaussians: the check fails if all cameras together see less than the first, and
warns if they, or the median camera, see less than the second; most captures see most of theirs."""
MIN_SPAN, MIN_MARGIN = 0.05, 0.3
"""Least width of the scene and distance of the principal point from a border, in image sizes."""
MAX_COLOUR = 5
"""Distance of a base colour from 0.5 above which it may have been stored as 0 to 255."""
MAX_BLIND = 1 / 3
"""Share of cameras that see too little, above which they are said to be of another scene."""

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
CONVENTIONS = {
    "with OpenGL axes (y up, z backward)": lambda viewmat: FLIP @ viewmat,
    "as world-to-camera": np.linalg.inv,
    "as world-to-camera with OpenGL axes": lambda viewmat: FLIP @ np.linalg.inv(viewmat),
}
"""Conventions of poses other than camera-to-world with OpenCV axes, and how to convert a viewmat
that was read with the wrong one."""

NO_CONVENTION = (
    "; do they belong together? The exporter may have normalised the scene, or the poses may be "
    "world-to-camera or have OpenGL axes"
)


def check_views(
    gaussians: Gaussians, cameras: Sequence[Camera], *, near: float = NEAR
) -> list[str]:
    """Check the share of Gaussians that are visible from at least one camera; return warnings.

    They are one line each: cameras that see little, a low share, a near plane (in world units) that
    cuts most away, another scale. InputError below 1 %, and for want of cameras or Gaussians.
    """
    check_shapes(gaussians)
    if not cameras:
        raise InputError("no cameras for the scene; give at least one")
    if not len(gaussians):
        raise InputError("the scene has no Gaussians")
    points = opaque_means(gaussians)
    points = points[np.linspace(0, len(points) - 1, min(len(points), MAX_POINTS)).astype(np.int64)]
    depths = _depths(points, cameras)
    seen = depths > near
    share, share_ahead = seen.any(axis=0).mean(), (depths > 0).any(axis=0).mean()
    # The median: if poses were read in a wrong convention, a few cameras see the scene by chance.
    typical = float(np.median(shares := np.mean(depths > 0, axis=1)))
    if share_ahead < MIN_SHARE:
        advice = _better_convention(points, cameras, typical) or NO_CONVENTION
        raise InputError(f"the cameras see {share_ahead:.2%} of the Gaussians{advice}")
    if share < MIN_SHARE:
        raise InputError(_near_message(depths, near))
    warnings = list(storage_warnings(gaussians, points).values())
    if seen.sum() < 0.5 * (depths > 0).sum():
        warnings.append(_near_message(depths, near))
    if share < LOW_SHARE:
        warnings.append(f"the cameras together see only {share:.1%} of the Gaussians")
    diameter, depth = 2 * scene_extent(gaussians)[1], np.median(depths[depths > 0])
    warnings += _mismatches(cameras, diameter / depth)
    seeing = shares >= min(MIN_SHARE, 0.1 / len(cameras))
    if blind := [camera.name for camera, sees in zip(cameras, seeing, strict=True) if not sees]:
        names = ", ".join(blind[:5]) + (", ..." if len(blind) > 5 else "")
        advice = _better_convention(points, cameras, typical)
        advice = advice or NO_CONVENTION * (len(blind) > MAX_BLIND * len(cameras))
        warnings.append(f"{len(blind)} of {len(cameras)} cameras see too little: {names}{advice}")
    elif typical < LOW_SHARE <= share:
        warnings.append(f"a typical camera sees {typical:.1%} of the scene; few masks can agree")
    return warnings


def _mismatches(cameras: Sequence[Camera], ratio: np.floating) -> Iterator[str]:
    """Warn of intrinsics of another image size, and if scene size over depth, `ratio`, is low."""
    K = np.stack([np.asarray(c.K)[:2] / [[c.width], [c.height]] for c in cameras])  # relative
    if (span := ratio * np.median(K[:, 0, 0])) < MIN_SPAN:
        yield f"the scene is {span:.1%} as wide as a typical image; is it at the cameras' scale?"
    off = (np.abs(K[:, :, 2] - 0.5) > 0.5 - MIN_MARGIN).any(axis=1).mean()
    if off > MAX_BLIND:
        yield f"{off:.0%} of the principal points are far from the middle; is K of another size?"


def _depths(points: np.ndarray, cameras: Sequence[Camera], convert=np.asarray) -> np.ndarray:
    """Depths of the points inside each image, 0 outside of it, shape (cameras, points)."""
    depths = np.zeros((len(cameras), len(points)), np.float32)
    for row, camera in zip(depths, cameras, strict=True):
        viewmat = convert(np.asarray(camera.viewmat, np.float64))
        pixels = (points @ viewmat[:3, :3].T + viewmat[:3, 3]) @ np.asarray(camera.K, np.float64).T
        u, v, z = pixels.T
        inside = (u >= 0) & (u <= camera.width * z) & (v >= 0) & (v <= camera.height * z)
        row[inside] = z[inside]
    return depths


def _better_convention(points: np.ndarray, cameras: Sequence[Camera], typical: float) -> str:
    """Advice to read the poses in another convention, if a typical camera then sees far more."""
    shares = {
        name: np.median(np.mean(_depths(points, cameras, convert) > 0, axis=1))
        for name, convert in CONVENTIONS.items()
    }
    best = max(shares, key=shares.__getitem__)
    if (share := shares[best]) <= max(LOW_SHARE, 3 * typical):
        return ""
    return f"; perhaps the poses are to be read {best}: a camera then typically sees {share:.0%}"


def storage_warnings(gaussians: Gaussians, points: np.ndarray) -> dict[str, str]:
    """Warn of scales, opacities and colours in unusual units, and of positions that are rounded."""
    found, log_scales = _colour_warnings(gaussians), np.asarray(gaussians.log_scales)
    extent = np.ptp(np.percentile(points, [10, 90], axis=0), axis=0).max()
    size = np.exp(np.median(log_scales))
    if np.mean(log_scales >= 0) >= 0.99 and size >= 0.05 * extent:
        found["linear scales"] = (
            "the Gaussians are as large as the scene: its scales may not have been stored as "
            "logarithms; take the logarithm of scale_0, scale_1 and scale_2"
        )
    distance = np.median(np.abs(points).max(axis=1))
    if 0 < size < 4 * (step := np.spacing(np.float32(distance))):
        found["rounded positions"] = (
            f"positions {distance:.0e} from the origin are rounded to steps of {step:.2g}, while "
            f"Gaussians have a size of {size:.2g}; export scene and cameras near the origin"
        )
    return found


def _colour_warnings(gaussians: Gaussians) -> dict[str, str]:
    """Warn of opacities that were not stored as log odds, and of colours in 0 to 255."""
    found, logits = {}, np.asarray(gaussians.logit_opacities)
    low, high = logits.min(), logits.max()
    if 0 <= low < high and (high <= 1 or (20 < high < 256 and not (logits % 1).any())):
        found["linear opacities"] = (
            f"all opacities are from 0 to {1 if high <= 1 else 255}: they may not have been stored "
            "as log odds"
        )
    if (np.asarray(gaussians.opacities) < MIN_ALPHA).all():
        found["all invisible"] = (
            "no Gaussian can be seen: all opacities are below 1/255; are they stored as log odds?"
        )
    if np.mean(np.abs(Y0 * np.asarray(gaussians.sh)[:, 0]).max(axis=1) > MAX_COLOUR) > 0.5:
        found["8-bit colours"] = "most base colours are far beyond 0 to 1; are they in 0 to 255?"
    return found


def _near_message(depths: np.ndarray, near: float) -> str:
    ahead = depths[depths > 0]
    cut, fitting = np.mean(ahead <= near), 0.5 * np.percentile(ahead, 1)
    return (
        f"the near plane at {near:g} cuts away {cut:.0%} of the Gaussians in front of the cameras; "
        f"use near={fitting:.1g} (--near), or scale scene and cameras up"
    )
