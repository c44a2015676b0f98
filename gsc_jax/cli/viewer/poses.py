"""Cameras as a viewer moves among them: where they are, what they look at, and what is up."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from gsc_jax.render.projection import NEAR
from gsc_jax.scene import Array, Camera

TILTED = 0.2
"""Sine of the angle between view and vertical below which the vertical is of no use as up."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Pose:
    """Where a camera is and what it sees, OpenCV axes.

    Attributes:
        name: Name of the camera.
        wxyz: Rotation from camera to world as a unit quaternion, shape (4,).
        position: World units, shape (3,).
        look_at: What it looks at: the middle of the image at the typical depth, shape (3,).
        up: Unit direction that is up in its image and as vertical as can be, shape (3,).
        fov: Vertical field of view in radians.
        aspect: Width over height.
    """

    name: str
    wxyz: np.ndarray
    position: np.ndarray
    look_at: np.ndarray
    up: np.ndarray
    fov: float
    aspect: float


def upward(cameras: Sequence[Camera]) -> np.ndarray:
    """What is up in a scene, as photographs are mostly taken upright.

    Args:
        cameras: The cameras, at least one.

    Returns:
        A unit direction, shape (3,); -y where they disagree.
    """
    ups = np.array([-np.asarray(camera.viewmat, np.float64)[1, :3] for camera in cameras])
    mean = ups.mean(axis=0)
    length = np.linalg.norm(mean)
    return mean / length if length > TILTED else np.array([0.0, -1.0, 0.0])


def pose(camera: Camera, means: Array, *, up: Array, near: float = NEAR) -> Pose:
    """Where a camera is, and what to turn around when looking from it.

    Args:
        camera: The camera; its principal point is taken for the middle of the image.
        means: Centres of the scene, all or some of them, shape (N, 3).
        up: Unit direction that is up in the scene, shape (3,).
        near: Near plane in world units.

    Returns:
        The pose.
    """
    from scipy.spatial.transform import Rotation

    viewmat, K = np.asarray(camera.viewmat, np.float64), np.asarray(camera.K, np.float64)
    right, down, forward = viewmat[:3, :3]
    position = camera.center.astype(np.float64)
    half_width, half_height = camera.width / (2 * K[0, 0]), camera.height / (2 * K[1, 1])
    x, y, z = viewmat[:3, :3] @ (np.asarray(means, np.float64) - position).T
    seen = (z > near) & (abs(x) < half_width * z) & (abs(y) < half_height * z)
    depth = float(np.median(z[seen])) if seen.any() else 1.0
    level = np.asarray(up, np.float64) - (up @ right) * right
    upright = level @ -down > TILTED
    return Pose(
        name=camera.name,
        wxyz=Rotation.from_matrix(viewmat[:3, :3].T).as_quat(scalar_first=True),
        position=position,
        look_at=position + depth * forward,
        up=level / np.linalg.norm(level) if upright else -down,
        fov=2 * float(np.arctan(half_height)),
        aspect=half_width / half_height,
    )
