"""Masks and probability maps as image files, read as float32 in [0, 1].

A mask is grey: black is authentic, white is tampered, levels between them are probabilities.
One file does not show whether levels 0 and 1 of 8 bits are a 0/1 mask or the two darkest
probabilities; `gsc_jax.detectors.folder` decides once for a whole folder.
"""

import contextlib
import threading
from collections.abc import Iterator
from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np
import skimage  # whose submodules load when they are first used
from PIL import Image

from gsc_jax.io.files import atomic, check_allocation, existing_file
from gsc_jax.io.validation import reported, shown
from gsc_jax.scene import InputError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")
"""Suffixes of mask files, in lower case; upper case is accepted too."""
IMAGE_FORMATS = ("PNG", "JPEG", "TIFF", "BMP", "WEBP")
"""Their formats: Pillow would run other programs for some of the others."""
AS_STORED = ("1", "L", "LA", "I", "I;16", "I;16B", "F", "RGB", "RGBA")
"""Pillow's modes whose channels are grey levels or red, green and blue, and alpha."""
TRANSPARENT_LEVEL = {"1": 1 / 255, "L;2": 85, "L;4": 17, "RGB;16B": 1 / 256}
"""Level of a pixel per level of the transparent colour, where Pillow scales only the pixels."""
MIN_IS_WHITE = (262, 0)
"""TIFF tag and value of inverted levels, which Pillow ignores for 16 bits."""
ORIENTATION = 0x0112
"""EXIF tag that tells viewers how to turn an image; the value 1 is upright."""
_OPENING = threading.Lock()
BYTES_PER_PIXEL = 32
"""Memory of a coloured mask while it is reduced to one channel and resized, with 8 bytes each."""
MAX_PART_BYTES, MAX_NAME_BYTES = 240, 1000
"""Lengths of the names of cameras. Most file systems allow 255 bytes for a part and 4096 for a
path, to which the folder and a suffix are added."""

GREY_TOLERANCE_LEVELS = 8
"""Largest difference between the channels of a grey pixel. Lossy formats do not keep them equal:
Pillow's WebP changes grey noise by 1 level; the bound leaves room for other encoders."""


def read_probability(
    path: str | Path, *, zero_one: bool | None = None, max_bytes: int | None = None
) -> np.ndarray:
    """Read a mask or a probability map.

    Grey levels of 1, 8 or 16 bits are divided by the largest level of their type; floats are taken
    as they are. Colour is accepted where the channels are equal, or where the only colours are
    black and one other, for tampered (the usual palette mask). Transparent pixels are authentic.

    Args:
        path: An image file in one of `IMAGE_SUFFIXES`.
        zero_one: Whether 8-bit levels are 0 and 1 (True) or 0 to 255 (False). The default is True
            if no level of the file exceeds 1. Other types ignore it.
        max_bytes: Memory that may be allocated; see `memory_limit` for the default.

    Returns:
        Probability of tampering in [0, 1], shape (h, w) float32.

    Raises:
        InputError: If the file is missing, damaged, coloured or too large, or holds several images.
    """
    grey = read_grey(path, max_bytes=max_bytes)
    if grey.dtype == np.uint8 and (grey.max() <= 1 if zero_one is None else zero_one):
        grey = grey > 0
    return skimage.util.img_as_float32(grey)


def read_grey(path: str | Path, *, max_bytes: int | None = None) -> np.ndarray:
    """Read the stored grey levels of an image: bool, uint8, uint16, or floats in [0, 1], (h, w)."""
    path = existing_file(path, expected="a mask image")
    expected = ", expected a grey PNG; it may be cut short or of another format: write it again"
    with reported(f"{path}: cannot be read as an image", expected), open_image(path) as image:
        check_allocation(path, BYTES_PER_PIXEL * image.width * image.height, max_bytes)
        with contextlib.suppress(EOFError):
            image.seek(1)
            raise InputError(f"{path}: holds several pages or frames, expected one; save one")
        image.seek(0)
        pixels = _decoded(image)
        if image.getexif().get(ORIENTATION, 1) != 1:  # afterwards: Pillow may load the image for it
            raise InputError(f"{path}: its EXIF orientation turns it; save it upright without one")
    if pixels.dtype.name not in ("bool", "uint8", "uint16") and pixels.dtype.kind != "f":
        raise InputError(f"{path}: holds {pixels.dtype} levels, expected 1, 8 or 16 bits or float")
    if pixels.dtype.kind == "f" and not ((pixels >= 0) & (pixels <= 1)).all():
        raise InputError(f"{path}: float values must be finite and lie in [0, 1]")
    return pixels if pixels.ndim == 2 else _grey(pixels, path)


def write_probability(path: str | Path, probability: np.ndarray) -> None:
    """Write a probability map as 16-bit grey PNG.

    Halves are rounded down: 32768 / 65535 is above 0.5. Values outside [0, 1] raise InputError.
    """
    probability = np.asarray(probability, np.float64)
    if probability.ndim != 2 or not ((probability >= 0) & (probability <= 1)).all():
        raise InputError(
            f"{path}: cannot write an array of shape {probability.shape} as probabilities: "
            "expected finite values in [0, 1] of shape (height, width)"
        )
    _write(path, np.ceil(probability * 65535 - 0.5).astype(np.uint16))


def write_mask(path: str | Path, mask: np.ndarray) -> None:
    """Write a mask, True where tampered, shape (h, w), as 8-bit grey PNG of 0 and 255."""
    _write(path, np.asarray(mask, bool) * np.uint8(255))


def write_image(path: str | Path, rgb: np.ndarray) -> None:
    """Write a colour image, clipped to [0, 1], shape (H, W, 3), as 8-bit .png or as .jpg."""
    kind = "JPEG" if Path(path).suffix == ".jpg" else "PNG"
    _write(path, skimage.util.img_as_ubyte(np.clip(np.asarray(rgb, np.float32), 0, 1)), kind)


def image_path(folder: str | Path, name: str) -> Path:
    """Path of the image of a camera, `folder/name.png`, by which `FolderDetector` finds it.

    The name keeps its dots and folders; backslashes separate folders as slashes do. An empty name,
    one that leaves the folder, or one that no file can have, raises InputError.
    """
    windows = PureWindowsPath(name)
    leaves = not windows.name or windows.anchor or ".." in windows.parts
    # Lone surrogates cannot be encoded; file systems limit the bytes of each part of a path.
    whole, *parts = (len(part.encode(errors="replace")) for part in (str(windows), *windows.parts))
    long = whole > MAX_NAME_BYTES or max(parts, default=0) > MAX_PART_BYTES
    if leaves or long or "\0" in name or name != name.encode(errors="replace").decode():
        raise InputError(
            f"camera name {shown(name)} cannot name a file inside {folder}: expected a relative "
            f"path without '..', of Unicode, at most {MAX_PART_BYTES} bytes per part and "
            f"{MAX_NAME_BYTES} in total; rename the camera"
        )
    return Path(folder) / PurePosixPath(windows.as_posix() + ".png")


@contextlib.contextmanager
def open_image(path: Path) -> Iterator[Image.Image]:
    """Open an image of any size; `check_allocation` replaces Pillow's bound on the pixels."""
    with _OPENING:
        bound, Image.MAX_IMAGE_PIXELS = Image.MAX_IMAGE_PIXELS, None
        try:
            image = Image.open(path, formats=IMAGE_FORMATS)
        finally:
            Image.MAX_IMAGE_PIXELS = bound
    with image:
        yield image


def _decoded(image: Image.Image) -> np.ndarray:
    """Pixels, alpha last, with palettes, inks and inverted levels decoded, and no colour key."""
    tiles = getattr(image, "tile", []) if image.format == "PNG" else []
    rawmode = tiles[0].args if tiles else ""
    transparent = image.info.get("transparency")
    if image.mode not in AS_STORED:
        return np.array(image.convert("RGBA" if image.has_transparency_data else "RGB"))
    pixels, (tag, value) = np.array(image), MIN_IS_WHITE
    if image.mode == "I;16" and getattr(image, "tag_v2", {}).get(tag) == value:
        pixels = np.iinfo(pixels.dtype).max - pixels
    if transparent is None:
        return pixels
    level = np.array(transparent) * TRANSPARENT_LEVEL.get(str(rawmode), 1)
    pixels[np.atleast_3d(pixels == level.astype(int)).all(axis=2)] = 0
    return pixels


def _grey(pixels: np.ndarray, path: Path) -> np.ndarray:
    """Reduce two to four 8-bit channels to one, on black where there is alpha."""
    # One plane per channel: reductions over a last axis of three are several times slower.
    colours = np.ascontiguousarray(np.moveaxis(pixels, -1, 0)[: 1 if pixels.shape[2] == 2 else 3])
    lit = colours.any(axis=0)
    if np.ptp(colours, axis=0).max() <= GREY_TOLERANCE_LEVELS:
        grey = np.rint(colours.mean(axis=0))
    elif (colours[:, lit] == colours[:, lit][:, :1]).all():
        grey = lit * 255.0
    else:
        raise InputError(
            f"{path}: is a colour picture, expected a grey mask (black is authentic, white is "
            "tampered); give the masks, not the images"
        )
    if pixels.shape[2] in (2, 4):
        grey = np.rint(grey * (pixels[..., -1] / 255))
    return np.asarray(grey, np.uint8)


def _write(path: str | Path, pixels: np.ndarray, kind: str = "PNG") -> None:
    options = {"quality": 90, "subsampling": 0}  # sampled colours blur outlines
    # 16 bits hardly compress: level 6 takes 4 times as long for 6 % fewer bytes.
    options["compress_level"] = 1 if pixels.dtype == np.uint16 else 6
    with atomic(path) as temporary:
        Image.fromarray(pixels).save(temporary, kind, **options)
