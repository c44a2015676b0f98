"""Cameras as poses that a viewer can jump to."""

import dataclasses

import numpy as np

from gsc_jax.render.projection import NEAR
from gsc_jax.scene import Array, Camera

MIN_LEVEL = 0.2
"""Sine of the angle between view and vertical below which the up of the image is used instead."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Pose:
    """A camera in OpenCV axes.

    Attributes:
        name: Name of the camera.
        wxyz: Rotation from camera to world as a unit quaternion, shape (4,).
        position: World units, shape (3,).
        look_at: Point in the middle of the image at the median depth, shape (3,).
        up: Unit up direction of the image, level with the scene if possible, shape (3,).
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


def pose(camera: Camera, means: Array, *, up: Array, near: float = NEAR) -> Pose:
    """Convert a camera; its principal point is taken to be the middle of the image.

    The depth of what it looks at comes from the `means` of some or all Gaussians, (N, 3), beyond
    the near plane; `up` is the unit up direction of the scene.
    """
    from scipy.spatial.transform import Rotation

    rotation, K = np.asarray(camera.viewmat, np.float64)[:3, :3], np.asarray(camera.K, np.float64)
    right, down, forward = rotation
    position = np.asarray(camera.center, np.float64)
    half_width, half_height = camera.width / (2 * K[0, 0]), camera.height / (2 * K[1, 1])
    x, y, z = rotation @ (np.asarray(means, np.float64) - position).T
    visible = (z > near) & (abs(x) < half_width * z) & (abs(y) < half_height * z)
    depth = float(np.median(z[visible])) if visible.any() else 1.0
    level = np.asarray(up, np.float64) - (up @ right) * right
    is_level = level @ -down > MIN_LEVEL
    return Pose(
        name=camera.name,
        wxyz=Rotation.from_matrix(rotation.T).as_quat(scalar_first=True),
        position=position,
        look_at=position + depth * forward,
        up=level / np.linalg.norm(level) if is_level else -down,
        fov=2 * float(np.arctan(half_height)),
        aspect=half_width / half_height,
    )
