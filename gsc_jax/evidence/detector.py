"""What `locate` asks of a 2D tampering detector, and what it makes of its output.

The detectors themselves are in `gsc_jax.detectors`; a function of the image or a mapping of masks
by camera name serves as well. An output is resized once, as probabilities, and thresholded once.
"""

import dataclasses
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from gsc_jax.scene import Camera, InputError


class Detector(Protocol):
    """A 2D tampering detector. A plain function of the image will do for `locate`, too.

    It may have a sequence `warnings` of what a user should know; `locate` passes them on.
    """

    @property
    def needs_image(self) -> bool:
        """Whether it looks at the render; if not, none is made."""
        ...

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        """The cameras it has something to say on; raises InputError when there is none."""
        ...

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        """Probability of tampering, at any size, of an image (H, W, 3) in [0, 1]."""
        ...


def fit_to_view(probability: Any, camera: Camera) -> np.ndarray:
    """A detector's output at the size of a view, resized once, as probabilities.

    Args:
        probability: Shape (h, w), or with axes of length 1; boolean or in [0, 1].
        camera: The view.

    Returns:
        Shape (H, W), float32. To be thresholded once, strictly above 0.5.

    Raises:
        InputError: if the output is not such an image.
    """
    from skimage.transform import resize

    output: np.ndarray = np.asarray(probability, np.float32)
    if output.ndim > 2:
        output = output.reshape([side for side in output.shape if side != 1])
    if output.ndim != 2 or not output.size:
        raise InputError(
            f"The detector's output for view {camera.name!r} has shape {np.shape(probability)}; "
            "expected one probability per pixel, (height, width)."
        )
    if not (np.isfinite(output).all() and output.min() >= 0 and output.max() <= 1):
        raise InputError(
            f"The detector's output for view {camera.name!r} is not a probability: its values are "
            f"{output.min():.4g} to {output.max():.4g}, expected 0 to 1. Apply its sigmoid or "
            "divide by 255."
        )
    size = (camera.height, camera.width)
    if output.shape == size:
        return output
    shrinks = output.shape[0] > size[0] or output.shape[1] > size[1]
    resized = resize(output, size, order=1, anti_aliasing=shrinks)
    return np.asarray(resized, np.float32).clip(0.0, 1.0)


@dataclasses.dataclass(frozen=True)
class _Function:
    """A function of the image as a detector."""

    function: Callable[[np.ndarray], Any]
    needs_image = True

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        return list(cameras)

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        del camera
        return self.function(typing.cast(np.ndarray, image))


@dataclasses.dataclass(frozen=True)
class _Masks:
    """Given probabilities by camera name as a detector."""

    masks: Mapping[str, Any]
    needs_image = False

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        found = [camera for camera in cameras if camera.name in self.masks]
        if not found:
            raise InputError(
                f"No camera has a mask: the cameras are called like {cameras[0].name!r}, the masks "
                f"like {next(iter(self.masks), None)!r}."
            )
        return found

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        del image
        return self.masks[camera.name]


def as_detector(detector: Any) -> Detector:
    """Wrap a function of the image, or a mapping of probabilities, as a detector."""
    if hasattr(detector, "select"):
        return detector
    return _Masks(detector) if isinstance(detector, Mapping) else _Function(detector)
