"""Convert an image to the input of a network, and its output to a map at its own resolution."""

import numpy as np

from gsc_jax.detectors.specs import OnnxSpec

Size = tuple[int, int]


def fit_image(image: np.ndarray, target: Size, *, fit: str) -> tuple[np.ndarray, Size]:
    """Resize or pad an image.

    Args:
        image: Shape (H, W, 3).
        target: Height and width of the result.
        fit: "pad" shrinks a larger image with its aspect ratio and adds black at the bottom and the
            right; any other value resizes without keeping the aspect ratio.

    Returns:
        The image at the target size, float32, and the height and width without the padding.
    """
    if fit != "pad":
        return resize_bilinear(image, target), target
    shrink = min(1.0, target[0] / image.shape[0], target[1] / image.shape[1])
    height, width = (max(1, round(side * shrink)) for side in image.shape[:2])
    margins = ((0, target[0] - height), (0, target[1] - width), (0, 0))
    return np.pad(resize_bilinear(image, (height, width)), margins), (height, width)


def to_tensor(image: np.ndarray, spec: OnnxSpec) -> np.ndarray:
    """Normalise an image and add the batch axis.

    Args:
        image: RGB in [0, 1] at the input size of the network, shape (H, W, 3).
        spec: Channel order, layout and statistics of the network.

    Returns:
        Shape (1, 3, H, W) or (1, H, W, 3) float32.
    """
    colours = np.float32(spec.scale) * (image[..., ::-1] if spec.channels == "bgr" else image)
    tensor = (colours - np.array(spec.mean, np.float32)) / np.array(spec.std, np.float32)
    if spec.layout == "NCHW":
        tensor = tensor.transpose(2, 0, 1)
    return np.ascontiguousarray(tensor)[None]


def crop_map(probability: np.ndarray, target: Size, content: Size) -> np.ndarray:
    """Remove the padding from a map; upsample the map first if the crop would cut through a cell.

    Args:
        probability: Map of the whole network input at any resolution, shape (h, w).
        target: Height and width of the network input.
        content: Height and width of the part without padding, from `fit_image`.

    Returns:
        Map of the image without padding, float32.
    """
    if content == target:
        return probability
    rows, columns = (side * part for side, part in zip(probability.shape, content, strict=True))
    if rows % target[0] or columns % target[1]:
        return resize_bilinear(probability, target)[: content[0], : content[1]]
    return probability[: rows // target[0], : columns // target[1]]


def remap_threshold(probability: np.ndarray, threshold: float) -> np.ndarray:
    """Map a threshold in (0, 1) to 0.5, piecewise linearly.

    Returns:
        Values in [0, 1], float32, above 0.5 exactly where the probability exceeds the threshold.
    """
    remapped = np.interp(probability, (0, threshold, 1), (0, 0.5, 1)).astype(np.float32)
    half = np.float32(0.5)
    above = np.maximum(remapped, np.nextafter(half, np.float32(1)))  # rounding can reach 0.5
    return np.where(probability > threshold, above, np.minimum(remapped, half))


def resize_bilinear(image: np.ndarray, size: Size) -> np.ndarray:
    """Resize with bilinear interpolation, after a low-pass filter if the image shrinks."""
    from skimage.transform import resize

    image = np.asarray(image, np.float32)
    return image if image.shape[:2] == size else np.asarray(resize(image, size, order=1))
