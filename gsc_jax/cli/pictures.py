"""Pictures for people: masks drawn into the render, and sheets of views side by side.

The mark must show on any background and to any eye: a tint between red and magenta, whose outline
is light with dark on either side of it.
"""

import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from gsc_jax.io.files import atomic
from gsc_jax.io.masks import image_path

TINT = np.array([1.0, 0.0, 0.4], np.float32)
TINT_STRENGTH = 0.45
LIGHT, DARK = np.array([1.0, 0.95, 0.2], np.float32), np.zeros(3, np.float32)
CELL_INCHES, CELL_DPI = 3.2, 110
QUALITY = 90
"""Of a JPEG that is looked at closely; colours are kept at full size, for outlines."""


def overlay(rgb: np.ndarray, mask: np.ndarray) -> np.ndarray:
    """Draws a mask into a picture, tinted and outlined.

    Args:
        rgb: The picture in [0, 1], shape (H, W, 3).
        mask: What to mark, shape (H, W) bool.

    Returns:
        A new picture, shape (H, W, 3) float32; where nothing is marked, the same colours.
    """
    rgb, mask = np.asarray(rgb, np.float32), np.asarray(mask, bool)
    tinted = (1 - TINT_STRENGTH) * rgb + TINT_STRENGTH * TINT
    picture = np.where(mask[..., None], tinted, rgb)
    width = max(1, round(min(mask.shape) / 240))
    outline = _grow(mask, width) & ~mask
    halo = _grow(outline, width) & ~outline
    picture[halo] = 0.4 * picture[halo] + 0.6 * DARK
    picture[outline] = LIGHT
    return picture


def jpeg_path(folder: str | Path, name: str) -> Path:
    """Where the picture of a camera goes that is only looked at: `image_path`, but .jpg."""
    return image_path(folder, name).with_suffix(".jpg")


def write_jpeg(path: str | Path, rgb: np.ndarray) -> None:
    """Writes a picture that is only looked at, with the folders that its path names.

    Args:
        path: The .jpg to write or to replace.
        rgb: Colours, clipped to [0, 1], shape (H, W, 3).

    Raises:
        InputError: if the file cannot be written.
    """
    from PIL import Image
    from skimage.util import img_as_ubyte

    picture = Image.fromarray(img_as_ubyte(np.clip(np.asarray(rgb, np.float32), 0, 1)))
    with atomic(path) as temporary:
        picture.save(temporary, quality=QUALITY, subsampling=0)


def contact_sheet(
    path: str | Path,
    rows: Sequence[Sequence[np.ndarray]],
    *,
    titles: Sequence[str],
    labels: Sequence[str],
) -> None:
    """Writes pictures as a table.

    Args:
        path: The .png to write or to replace.
        rows: Pictures of each row, (H, W, 3) or grey (H, W), in [0, 1] or bool.
        titles: Names of the columns.
        labels: Names of the rows.

    Raises:
        InputError: if the file cannot be written.
    """
    from matplotlib.figure import Figure

    height, width = rows[0][0].shape[:2]
    size = (CELL_INCHES * len(titles), (CELL_INCHES * height / width + 0.04) * len(rows) + 0.3)
    figure = Figure(figsize=size, dpi=CELL_DPI, layout="constrained")
    table = figure.subplots(len(rows), len(titles), squeeze=False)
    for axes_row, pictures, label in zip(table, rows, labels, strict=True):
        axes_row[0].set_ylabel(label, fontsize=8)
        for axes, picture in zip(axes_row, pictures, strict=True):
            axes.imshow(np.asarray(picture, np.float32), cmap="gray", vmin=0, vmax=1)
            axes.set(xticks=[], yticks=[])
    for axes, title in zip(table[0], titles, strict=True):
        axes.set_title(title, fontsize=10)
    with atomic(path) as temporary, warnings.catch_warnings():
        # A camera may be called anything; what the font lacks is drawn as a box.
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
        figure.savefig(temporary)


def _grow(mask: np.ndarray, pixels: int) -> np.ndarray:
    from scipy.ndimage import binary_dilation

    return np.asarray(binary_dilation(mask, iterations=pixels))
