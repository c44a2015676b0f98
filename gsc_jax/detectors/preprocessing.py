"""Convert an image to the input of a network, and its output to a map at its own resolution."""

import numpy as np

from gsc_jax.detectors.specs import OnnxSpec
from gsc_jax.evidence.detector import resize_bilinear

Size = tuple[int, int]


def fit_image(
    image: np.ndarray, target: Size, *, fit: str, low_pass: bool = True
) -> tuple[np.ndarray, Size]:
    """Resize or pad an image (H, W, 3) to a target size; also return its size without the padding.

    "pad" shrinks a larger image with its aspect ratio and adds black at the bottom and the right;
    any other `fit` resizes without keeping the aspect ratio, by `resize_bilinear`.
    """
    if fit != "pad":
        return resize_bilinear(image, target, low_pass=low_pass), target
    shrink = min(1.0, target[0] / image.shape[0], target[1] / image.shape[1])
    height, width = (max(1, round(side * shrink)) for side in image.shape[:2])
    margins = ((0, target[0] - height), (0, target[1] - width), (0, 0))
    return np.pad(resize_bilinear(image, (height, width)), margins), (height, width)


def to_tensor(image: np.ndarray, spec: OnnxSpec) -> np.ndarray:
    """Normalise RGB in [0, 1], (H, W, 3), to an input (1, 3, H, W) or (1, H, W, 3) float32."""
    colours = np.float32(spec.scale) * (image[..., ::-1] if spec.channels == "bgr" else image)
    tensor = (colours - np.array(spec.mean, np.float32)) / np.array(spec.std, np.float32)
    tensor = tensor.transpose(2, 0, 1) if spec.layout == "NCHW" else tensor
    return np.ascontiguousarray(tensor)[None]


def crop_map(probability: np.ndarray, target: Size, content: Size) -> np.ndarray:
    """Remove the padding from a map of the whole input, which can have any resolution.

    Target and content are the sizes with and without padding. A map with cut cells is upsampled.
    """
    if content == target:
        return probability
    rows, columns = (side * part for side, part in zip(probability.shape, content, strict=True))
    if rows % target[0] or columns % target[1]:
        return resize_bilinear(probability, target)[: content[0], : content[1]]
    return probability[: rows // target[0], : columns // target[1]]


def remap_threshold(probability: np.ndarray, threshold: float) -> np.ndarray:
    """Map a threshold in (0, 1) to 0.5, piecewise linearly, float32.

    Values are above 0.5 exactly where the probability exceeds the threshold.
    """
    remapped = np.interp(probability, (0, threshold, 1), (0, 0.5, 1)).astype(np.float32)
    half = np.float32(0.5)
    above = np.maximum(remapped, np.nextafter(half, np.float32(1)))  # rounding can reach 0.5
    return np.where(probability > threshold, above, np.minimum(remapped, half))
