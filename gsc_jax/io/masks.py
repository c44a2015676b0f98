"""Masks and probability maps as image files: grey levels in, float32 in [0, 1] out, and back.

A mask is grey: black is authentic, white is tampered, between them lie probabilities. Colour, alpha
and palettes are accepted where they can mean one thing only. Whether levels 0 and 1 of 8 bits are
a 0/1 mask or the two darkest probabilities cannot be told from one file, so the rule is spelled out
at `read_probability`; who holds a whole folder should decide once for all of it, and does
(`gsc_jax.detectors.folder`). What is written here reads back with the same decision in every pixel:
`p > 0.5` holds for what was read exactly where it held for what was written.
"""

from pathlib import Path, PurePosixPath, PureWindowsPath

import numpy as np

from gsc_jax.io.files import atomic
from gsc_jax.scene import InputError

IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".bmp", ".webp")
"""Suffixes of mask files, in lower case; upper case is accepted too."""

CHROMA_TOLERANCE = 8 / 255
"""Channels that differ by less are grey: JPEG and WebP do not keep them equal."""


def read_probability(path: str | Path, *, zero_one: bool | None = None) -> np.ndarray:
    """Reads a mask or a probability map.

    Grey of 1, 8 or 16 bits and float are divided by the largest level of their type. Colour is
    accepted where its channels are equal, or where the only colours are black and one other, which
    then means tampered (the usual palette mask). Transparent is authentic. An 8-bit file whose
    largest level is 1 is read as a 0/1 mask; an all-black one is all zero either way.

    Args:
        path: An image file in one of `IMAGE_SUFFIXES`.
        zero_one: Whether levels of 8 bits are 0 and 1 (True) or 0 to 255 (False); by default
            they are 0 and 1 where the file has none above 1. Nothing else than 8 bits asks.

    Returns:
        Probability of tampering in [0, 1], shape (h, w) float32.

    Raises:
        InputError: If the file is missing, empty, broken, coloured or no single picture.
    """
    from skimage.util import img_as_float32

    grey = read_grey(path)
    if grey.dtype == np.uint8 and (is_zero_one(grey) if zero_one is None else zero_one):
        grey = grey > 0
    return img_as_float32(grey)


def read_grey(path: str | Path) -> np.ndarray:
    """Reads the grey levels of a picture as they are stored.

    Args:
        path: An image file in one of `IMAGE_SUFFIXES`.

    Returns:
        Levels, shape (h, w), bool, uint8, uint16, or floats in [0, 1].

    Raises:
        InputError: As `read_probability`.
    """
    path = Path(path)
    frames = _read_frames(path)
    if len(frames) != 1:
        raise InputError(f"{path}: holds {len(frames)} pages or frames, expected one; save one")
    pixels = frames[0]
    if pixels.dtype.name not in ("bool", "uint8", "uint16") and pixels.dtype.kind != "f":
        raise InputError(f"{path}: holds {pixels.dtype} levels, expected 1, 8 or 16 bits or float")
    if pixels.dtype.kind == "f" and not ((pixels >= 0) & (pixels <= 1)).all():
        raise InputError(f"{path}: float values must be finite and lie in [0, 1]")
    return _grey(pixels, path)


def is_zero_one(grey: np.ndarray) -> bool:
    """Whether these are 8-bit levels of which none is above 1."""
    return grey.dtype == np.uint8 and grey.max() <= 1


def write_probability(path: str | Path, probability: np.ndarray) -> None:
    """Writes a probability map as 8-bit grey PNG, with the folders that its path names.

    Halves are rounded down, so that 0.5 stays undecided instead of becoming 128 / 255. A map of
    which no level exceeds 1 is written black: it would read as a 0/1 mask.

    Args:
        path: The file to write.
        probability: Values in [0, 1], shape (h, w).

    Raises:
        InputError: If the values are no probabilities.
    """
    probability = np.asarray(probability, np.float64)
    if probability.ndim != 2 or not ((probability >= 0) & (probability <= 1)).all():
        raise InputError(
            f"{path}: cannot write an array of shape {probability.shape} as probabilities: "
            "expected finite values in [0, 1] of shape (height, width)"
        )
    levels = np.ceil(probability * 255 - 0.5).astype(np.uint8)
    _write(path, np.zeros_like(levels) if is_zero_one(levels) else levels)


def write_mask(path: str | Path, mask: np.ndarray) -> None:
    """Writes a mask as 8-bit grey PNG, 0 or 255, with the folders that its path names.

    Args:
        path: The file to write.
        mask: True where tampered, shape (h, w) bool.
    """
    from skimage.util import img_as_ubyte

    _write(path, img_as_ubyte(np.asarray(mask, bool)))


def write_image(path: str | Path, rgb: np.ndarray) -> None:
    """Writes a colour image as 8-bit PNG, with the folders that its path names.

    Args:
        path: The file to write.
        rgb: Colours, clipped to [0, 1], shape (H, W, 3).
    """
    from skimage.util import img_as_ubyte

    _write(path, img_as_ubyte(np.clip(np.asarray(rgb, np.float32), 0, 1)))


def image_path(folder: str | Path, name: str) -> Path:
    """Where the image of a camera goes: `folder/name.png`, dots and folders in the name kept.

    Args:
        folder: The folder of such images.
        name: Name of the camera; backslashes separate folders as slashes do.

    Returns:
        The path; `FolderDetector(folder)` finds it again by the same name.

    Raises:
        InputError: If the name is empty or would leave the folder.
    """
    windows = PureWindowsPath(name)
    if not windows.name or windows.anchor or ".." in windows.parts:
        raise InputError(
            f"camera name {name!r} cannot name a file inside {folder}: expected a relative path "
            "without '..'; rename the camera"
        )
    return Path(folder) / PurePosixPath(windows.as_posix() + ".png")


def _read_frames(path: Path) -> list[np.ndarray]:
    """All the pictures of a file, as they are stored."""
    import imageio.v3 as iio

    if not path.is_file():
        found = "is a folder" if path.is_dir() else "does not exist"
        raise InputError(f"{path}: {found}, expected a mask image")
    content = path.read_bytes()
    if not content:
        raise InputError(f"{path}: the file is empty, expected a mask image; write it again")
    try:
        # From memory: given a path, imageio leaves files open that it cannot read.
        return list(iio.imiter(content, plugin="pillow"))
    except Exception as trouble:  # the decoders have no common base class for broken files
        raise InputError(
            f"{path}: cannot be read as an image, expected a grey PNG; it may be cut short or of "
            "another format: write it again"
        ) from trouble


def _grey(pixels: np.ndarray, path: Path) -> np.ndarray:
    """One channel of one to four, over black where there is alpha."""
    if pixels.ndim == 2:
        return pixels
    colours = pixels[..., : 1 if pixels.shape[2] < 3 else 3]
    grey = _equal_channels(colours)
    if grey is None:
        grey = _black_and_one_other(colours)
    if grey is None:
        raise InputError(
            f"{path}: is a colour picture, expected a grey mask (black is authentic, white is "
            "tampered); give the masks, not the images"
        )
    if pixels.shape[2] in (2, 4):
        opacity = pixels[..., -1] / _top(pixels.dtype)
        grey = np.rint(grey * opacity) if grey.dtype.kind != "f" else grey * opacity
    return grey.astype(pixels.dtype)


def _equal_channels(colours: np.ndarray) -> np.ndarray | None:
    wide = colours.astype(np.float64)
    if np.ptp(wide, axis=-1).max() > CHROMA_TOLERANCE * _top(colours.dtype):
        return None
    grey = wide.mean(axis=-1)
    return (grey if colours.dtype.kind == "f" else np.rint(grey)).astype(colours.dtype)


def _black_and_one_other(colours: np.ndarray) -> np.ndarray | None:
    """White where the picture is not black, if all of that has one colour."""
    lit = colours.any(axis=-1)
    one = (colours[lit] == colours[lit][:1]).all()
    return (lit * _top(colours.dtype)).astype(colours.dtype) if one else None


def _top(dtype: np.dtype) -> int:
    """The level that means 1."""
    return int(np.iinfo(dtype).max) if dtype.kind == "u" else 1


def _write(path: str | Path, pixels: np.ndarray) -> None:
    import imageio.v3 as iio

    with atomic(path) as temporary:
        iio.imwrite(temporary, pixels, plugin="pillow", extension=".png")
