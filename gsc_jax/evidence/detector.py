"""The interface of 2D tampering detectors, and the resizing of their outputs.

Implementations are in `gsc_jax.detectors`; a function of the image or a mapping of probability maps
by camera name serves as well. An output is resized once, as probabilities, and thresholded once.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Protocol

import numpy as np

from gsc_jax.scene import Array, Camera, InputError

ROUNDING = 1e-3
"""Accepted excess over [0, 1], about the rounding of float16 near 1 (machine epsilon 9.8e-4)."""
LEAST_SIDE = 4
"""Least side of a map in pixels, if the view is not smaller: fewer are a score, not a map."""
ASPECT_TOLERANCE = 0.1
"""Largest log of the aspect of a map relative to that of its view, beside one pixel of rounding.
It leaves room for images that were padded to a multiple of 32 pixels."""


class Detector(Protocol):
    """A 2D tampering detector.

    It may have `warnings`, sentences that `locate` passes on, and `diagnostics`, a dictionary by
    camera name: `observe` puts back the entries of views that an interrupted run has judged.
    """

    @property
    def needs_image(self) -> bool:
        """Whether the detector needs the rendered image; otherwise nothing is rendered for it."""
        ...

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        """Cameras for which the detector has an output; raises InputError if there are none."""
        ...

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        """Probability map of any size for an image (H, W, 3) in [0, 1]."""
        ...


def fit_to_view(probability: Any, camera: Camera) -> np.ndarray:
    """Resize a probability map to the size of a view, (H, W) float32, without a threshold.

    The map (h, w), or with axes of length 1, is boolean or in [0, 1]; others raise InputError.
    """
    output = _as_map(probability, camera)
    if not (output.min() >= -ROUNDING and output.max() <= 1 + ROUNDING):
        unknown = np.isnan(output).sum()
        found = f"{output.min():.4g} to {output.max():.4g}, expected 0 to 1. Apply its sigmoid or"
        raise InputError(
            f"The detector's output for view {camera.name!r} is not a probability: its values are "
            + (f"NaN in {unknown:,} pixels." if unknown else f"{found} divide by 255.")
        )
    return resize_bilinear(output, (camera.height, camera.width)).clip(0.0, 1.0)


def resize_bilinear(image: Array, size: tuple[int, int], *, low_pass: bool = True) -> np.ndarray:
    """Resize (h, w) or (h, w, D) bilinearly, by default after a low-pass filter if it shrinks.

    Beyond the border, it has the values at the border.
    """
    from skimage.transform import resize

    image = np.asarray(image, np.float32)
    if image.shape[:2] == size:
        return image
    return np.asarray(resize(image, size, order=1, mode="edge", anti_aliasing=low_pass))


def _as_map(probability: Any, camera: Camera) -> np.ndarray:
    """The output of a detector, (h, w) float32, without further axes of length 1."""
    if callable(getattr(probability, "detach", None)):  # torch: with gradients, in half precision
        probability = probability.detach().cpu().float()
    try:
        with np.errstate(over="ignore"):  # infinities are refused
            output = np.asarray(probability, np.float32)
    except Exception as error:  # tensors of any library may come here
        raise InputError(
            f"The detector's output for view {camera.name!r} is a {type(probability).__name__}, "
            "expected an array of probabilities, (height, width)."
        ) from error
    while output.ndim > 2 and 1 in output.shape:  # one by one: a view may be one pixel wide
        fits = output.shape[0] > 1 or output.shape[:-1] == (camera.height, camera.width)
        output = output.squeeze(-1 if fits and output.shape[-1] == 1 else output.shape.index(1))
    least = min(LEAST_SIDE, camera.height, camera.width)
    if output.ndim != 2 or min(output.shape) < least:
        raise InputError(
            f"The detector's output for view {camera.name!r} has shape {np.shape(probability)}; "
            "expected one probability per pixel, (height, width), of at least "
            f"{least} x {least} pixels."
        )
    return output


def same_view(probability: Any, camera: Camera) -> np.ndarray:
    """The map, if it can show the whole view: it has its aspect, or is square.

    Square maps are of networks that do not keep the aspect; others raise InputError.
    """
    output, aspect = _as_map(probability, camera), camera.width / camera.height
    height, width = output.shape
    distortion = abs(np.log(width / height / aspect))
    if height != width and distortion > ASPECT_TOLERANCE + 1 / min(height, width):
        raise InputError(
            f"The mask of {camera.name!r} has {width} x {height} pixels, the view {camera.width} x "
            f"{camera.height}; expected masks of the same views: of the same aspect, or square."
        )
    return output


@dataclasses.dataclass(frozen=True)
class _FunctionDetector:
    function: Callable[[np.ndarray], Any]
    needs_image = True

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        return list(cameras)

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:
        try:  # with a copy, which the function may change: torch wants writable arrays
            probability = self.function(np.array(image))
        except Exception as error:
            error.add_note(f"The detector was shown view {camera.name!r}.")
            raise
        return same_view(probability, camera)


@dataclasses.dataclass(frozen=True)
class _MappingDetector:
    maps: Mapping[str, Any]
    needs_image = False

    def select(self, cameras: Sequence[Camera]) -> list[Camera]:
        if not (found := [camera for camera in cameras if camera.name in self.maps]):
            raise InputError(
                f"No camera has a mask: camera names are like {cameras[0].name!r}, mask names like "
                f"{next(iter(self.maps), None)!r}."
            )
        return found

    def __call__(self, image: np.ndarray | None, camera: Camera) -> np.ndarray:  # noqa: ARG002
        if camera.name not in self.maps:
            raise InputError(f"Camera {camera.name!r} has no mask; leave it out, or give one.")
        return same_view(self.maps[camera.name], camera)


def as_detector(detector: Any, cameras: Sequence[Camera] = ()) -> Detector:
    """Wrap a function of the image, or probability maps, as a detector.

    Probability maps are a mapping by camera name, or any iterable with one for each of the cameras;
    more or fewer maps raise InputError; anything else, also a torch module, raises ValueError.
    """
    if hasattr(detector, "select"):
        return detector
    if isinstance(detector, Mapping):
        return _MappingDetector(detector)
    if hasattr(detector, "named_parameters"):
        raise InputError(
            "detector is a torch module, expected a function of the image (H, W, 3) in [0, 1]; "
            "wrap it: docs/detectors.md, section 'Without ONNX', has an example"
        )
    if callable(detector):
        return _FunctionDetector(detector)
    if isinstance(detector, str) or not hasattr(detector, "__iter__"):
        raise ValueError(
            "detector must be a detector, a function of the image, or probability maps by camera "
            f"name, got {type(detector).__name__}; for a folder of masks, FolderDetector(path)"
        )
    if len(maps := list(detector)) != len(cameras):
        raise InputError(
            f"expected a mask for each of {len(cameras)} cameras, in their order, got "
            f"{len(maps)}; give masks by camera name to leave cameras out"
        )
    return _MappingDetector({c.name: one for c, one in zip(cameras, maps, strict=True)})
