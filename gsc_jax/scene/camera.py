"""The pinhole camera: a pytree whose image size and name are static."""

import dataclasses

import jax
import numpy as np
from jax.core import Tracer

from gsc_jax.scene.errors import InputError, in_range
from gsc_jax.scene.gaussians import Array
from gsc_jax.scene.pytree import STATIC


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Camera:
    """A pinhole camera. Width, height and name are static, the rest are leaves.

    Attributes:
        viewmat: World to camera, OpenCV axes, shape (4, 4) float32.
        K: Intrinsics in pixels, shape (3, 3) float32; the first pixel has its centre at (0.5, 0.5).
        width: Image width in pixels.
        height: Image height in pixels.
        name: Name of the masks and outputs of this view; may contain dots and folders.

    Raises:
        ValueError: if the image has no pixel, or the name is not Unicode text.
    """

    viewmat: Array
    K: Array
    width: int = dataclasses.field(metadata=STATIC)
    height: int = dataclasses.field(metadata=STATIC)
    name: str = dataclasses.field(default="", metadata=STATIC)

    def __post_init__(self) -> None:
        """Check size and name: an empty image would fail, or be silently blank, in later steps."""
        for side in (self.width, self.height):
            if not in_range(side, 1, np.inf):
                raise ValueError(f"expected whole numbers of pixels above 0, got {side!r}")
        name = self.name  # lone surrogates have no encoding
        if not isinstance(name, str) or name != name.encode(errors="replace").decode():
            raise ValueError(f"camera name {name!r:.80} cannot name a file: expected Unicode")

    @property
    def center(self) -> Array:
        """Position of the camera in the world, shape (3,) float32."""
        # Sums of products: a matrix product on an accelerator may round to fewer bits.
        return -(self.viewmat[:3, :3] * self.viewmat[:3, 3:]).sum(axis=0)

    def scaled(self, factor: float) -> "Camera":
        """The same camera with an image `factor` times as wide and high, at least one pixel."""
        return self.resized(round(self.width * factor), round(self.height * factor))

    def resized(self, width: int, height: int) -> "Camera":
        """The same camera with an image of this size, whatever its aspect, at least one pixel."""
        width, height = max(1, width), max(1, height)
        zoom = np.array([width / self.width, height / self.height, 1.0], np.float32)
        K = np.asarray(self.K) * zoom[:, None]
        return dataclasses.replace(self, K=K, width=width, height=height)


def check_camera(camera: Camera) -> None:
    """Raise InputError if the matrices of a camera are not valid; TypeError if it is no camera.

    JAX rebuilds pytrees with arbitrary leaves, so that `__post_init__` cannot check them.
    """
    if not isinstance(camera, Camera):
        raise TypeError(f"expected a Camera, got {type(camera).__name__}")
    for name, side, last in (("viewmat", 4, (0, 0, 0, 1)), ("K", 3, (0, 0, 1))):
        matrix, wanted = getattr(camera, name), f"camera {camera.name!r}: {name} must be"
        if (shape := getattr(matrix, "shape", None)) != (side, side):
            found = f"{type(matrix).__name__} of shape {shape}" if shape else type(matrix).__name__
            raise InputError(f"{wanted} an array ({side}, {side}), got {found}")
        if isinstance(matrix, Tracer):
            continue
        if not matrix.dtype.isnative:  # JAX would take the bytes as they are
            raise InputError(f"{wanted} in the byte order of the machine, got {matrix.dtype}")
        values = np.asarray(matrix)  # at once: a jit around would trace operations of JAX
        if not (np.isfinite(values).all() and np.allclose(values[-1], last, atol=1e-4)):
            raise InputError(
                f"{wanted} finite with the last row {last}, not transposed, got {values.tolist()}"
            )
        if name == "viewmat" and np.linalg.cond(values[:3, :3]) > 1e6:
            raise InputError(f"{wanted} invertible, got {values.tolist()}")
        # Less skew than this moves pixels by less than a ten-thousandth of the image height.
        pinhole = abs(values[[0, 1], [1, 0]]).max() <= 1e-4 * values[0, 0] and values[1, 1] > 0
        if name == "K" and not pinhole:
            raise InputError(f"{wanted} without skew, focal lengths above 0, got {values.tolist()}")


def intrinsics(focal: float, width: int, height: int) -> np.ndarray:
    """Intrinsics with square pixels and a centred principal point, in pixels, (3, 3) float32."""
    return np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], np.float32)
