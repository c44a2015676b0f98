"""The pinhole camera: a pytree whose image size and name are static."""

import dataclasses
import functools

import jax
import numpy as np

from gsc_jax.scene.gaussians import Array


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["viewmat", "K"],
    meta_fields=["width", "height", "name"],
)
@dataclasses.dataclass(frozen=True, kw_only=True)
class Camera:
    """A pinhole camera. Width, height and name are static, the rest are leaves.

    The jitted functions of this package are given `viewmat`, `K` and the image size only, so a
    camera of another name recompiles nothing. (A chex.dataclass has no static fields.)

    Attributes:
        viewmat: World to camera, OpenCV axes, shape (4, 4) float32.
        K: Intrinsics in pixels, shape (3, 3) float32.
        width: Image width in pixels.
        height: Image height in pixels.
        name: What masks and outputs of this view are called; may hold dots and folders.
    """

    viewmat: Array
    K: Array
    width: int
    height: int
    name: str = ""

    @property
    def center(self) -> np.ndarray:
        """Position of the camera in the world, shape (3,) float32."""
        viewmat = np.asarray(self.viewmat)
        return -viewmat[:3, :3].T @ viewmat[:3, 3]

    def scaled(self, factor: float) -> "Camera":
        """The same camera with an image `factor` times as wide and high, at least one pixel."""
        return self.resized(round(self.width * factor), round(self.height * factor))

    def resized(self, width: int, height: int) -> "Camera":
        """The same camera with an image of this size, whatever its aspect, at least one pixel."""
        width, height = max(1, width), max(1, height)
        zoom = np.array([width / self.width, height / self.height, 1.0], np.float32)
        return dataclasses.replace(
            self, K=np.asarray(self.K) * zoom[:, None], width=width, height=height
        )


def intrinsics(focal: float, width: int, height: int) -> np.ndarray:
    """Matrix K of a camera with square pixels and a centred principal point, (3, 3) float32.

    Args:
        focal: Focal length in pixels.
        width: Image width in pixels.
        height: Image height in pixels.
    """
    return np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], np.float32)
