"""An image brought to the size that a network takes, and its map brought back: pure functions.

The map keeps the resolution of the network; whoever compares it with a view resizes it, once.
"""

import numpy as np

from gsc_jax.detectors.specs import OnnxSpec

Size = tuple[int, int]


def fit_image(image: np.ndarray, target: Size, *, fit: str) -> tuple[np.ndarray, Size]:
    """Resizes or pads an image.

    Args:
        image: Shape (H, W, 3).
        target: Height and width wanted.
        fit: "pad" shrinks the image if it is larger, keeping its aspect, and adds black at the
            bottom and the right; anything else resizes it, whatever its aspect.

    Returns:
        The image at the wanted size, float32, and the height and width in it that show the image.
    """
    if fit != "pad":
        return _resize(image, target), target
    shrink = min(1.0, target[0] / image.shape[0], target[1] / image.shape[1])
    height, width = (max(1, round(side * shrink)) for side in image.shape[:2])
    margins = ((0, target[0] - height), (0, target[1] - width), (0, 0))
    return np.pad(_resize(image, (height, width)), margins), (height, width)


def to_tensor(image: np.ndarray, spec: OnnxSpec) -> np.ndarray:
    """The network's input of one image: channels in its order, its statistics, a batch of one.

    Args:
        image: RGB in [0, 1] at the size that the network takes, shape (H, W, 3).
        spec: What the network takes.

    Returns:
        `(scale * image - mean) / std`, shape (1, 3, H, W) or (1, H, W, 3) float32.
    """
    colours = np.float32(spec.scale) * (image[..., ::-1] if spec.channels == "bgr" else image)
    tensor = (colours - np.array(spec.mean, np.float32)) / np.array(spec.std, np.float32)
    return np.ascontiguousarray(tensor.transpose(2, 0, 1) if spec.layout == "NCHW" else tensor)[
        None
    ]


def crop_map(probability: np.ndarray, target: Size, content: Size) -> np.ndarray:
    """The part of a map that shows the image, upsampled first where that would cut a cell.

    Args:
        probability: The map of the whole input at any resolution, shape (h, w).
        target: Height and width of the input.
        content: Height and width of the image in it, as `fit_image` says.

    Returns:
        The map of the image alone, float32.
    """
    if content == target:
        return probability
    rows, columns = (side * part for side, part in zip(probability.shape, content, strict=True))
    if rows % target[0] or columns % target[1]:
        return _resize(probability, target)[: content[0], : content[1]]
    return probability[: rows // target[0], : columns // target[1]]


def remap(probability: np.ndarray, *, threshold: float) -> np.ndarray:
    """Moves a threshold to 0.5, piecewise linearly.

    Args:
        probability: Values in [0, 1].
        threshold: What shall become 0.5, in (0, 1).

    Returns:
        Values in [0, 1], float32, above 0.5 exactly where they were above the threshold.
    """
    remapped = np.interp(probability, (0, threshold, 1), (0, 0.5, 1)).astype(np.float32)
    half = np.float32(0.5)
    above = np.maximum(remapped, np.nextafter(half, np.float32(1)))  # float32 may round it to 0.5
    return np.where(probability > threshold, above, np.minimum(remapped, half))


def _resize(image: np.ndarray, size: Size) -> np.ndarray:
    """Bilinear, with a low-pass filter where it shrinks."""
    from skimage.transform import resize

    image = np.asarray(image, np.float32)
    return image if image.shape[:2] == size else np.asarray(resize(image, size, order=1))
