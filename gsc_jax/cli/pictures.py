"""Pictures for people: masks drawn into renders, and tables of pictures."""

import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import scipy  # whose submodules load when they are first used

from gsc_jax.io.files import atomic
from gsc_jax.io.masks import image_path

TINT = np.array([1.0, 0.0, 0.4], np.float32)
TINT_STRENGTH = 0.45
OUTLINE = np.array([1.0, 0.95, 0.2], np.float32)
"""Outline beside a dark halo and a tint between red and magenta: visible on any background."""
CANDIDATE = np.array([0.1, 0.45, 1.0], np.float32)
"""Tint of what would be the edit if there was one."""
CELL_INCHES, CELL_DPI = 3.2, 110
SHEET_ROWS = 4
"""Rows of a table of pictures: as many as fit on a screen."""


def overlay(rgb: np.ndarray, mask: np.ndarray, tint: np.ndarray = TINT) -> np.ndarray:
    """Tint and outline a mask (H, W) in a copy of a picture (H, W, 3) in [0, 1]."""
    rgb, mask = np.asarray(rgb, np.float32), np.asarray(mask, bool)
    picture = np.where(mask[..., None], (1 - TINT_STRENGTH) * rgb + TINT_STRENGTH * tint, rgb)
    width = max(1, round(min(mask.shape) / 240))  # 2 pixels in a render of 640x480
    outline = np.asarray(scipy.ndimage.binary_dilation(mask, iterations=width)) & ~mask
    halo = np.asarray(scipy.ndimage.binary_dilation(outline, iterations=width)) & ~outline
    picture[halo] *= 0.4
    picture[outline] = OUTLINE
    return picture


def layer_path(folder: str | Path, layer: str, name: str) -> Path:
    """File of a picture of a camera in a folder of results: .jpg for people, .png for masks."""
    path = image_path(Path(folder) / layer, name)
    return path.with_suffix(".jpg") if layer in ("render", "overlay") else path


def contact_sheet(
    path: Path, rows: Mapping[str, Sequence[np.ndarray]], *, titles: Sequence[str]
) -> None:
    """Write rows of pictures, (H, W, 3) or grey (H, W), in [0, 1] or bool, into a .png."""
    from matplotlib.figure import Figure

    height, width = next(iter(rows.values()))[0].shape[:2]
    wide, high = CELL_INCHES * len(titles) + 0.2, CELL_INCHES * height / width * len(rows) + 0.25
    figure = Figure((wide, high), dpi=CELL_DPI)  # a layout engine would draw everything twice
    figure.subplots_adjust(0.2 / wide, 0.002, 0.998, 1 - 0.25 / high, wspace=0.01, hspace=0.01)
    table = figure.subplots(len(rows), len(titles), squeeze=False)
    for axes_row, (label, pictures) in zip(table, rows.items(), strict=True):
        axes_row[0].set_ylabel(label, fontsize=8, parse_math=False)  # two "$" are no formula
        for axes, picture in zip(axes_row, pictures, strict=True):
            axes.imshow(np.asarray(picture, np.float32), cmap="gray", vmin=0, vmax=1)
            axes.set(xticks=[], yticks=[])
    for axes, title in zip(table[0], titles, strict=True):
        axes.set_title(title, fontsize=10)
    with atomic(path) as temporary, warnings.catch_warnings():
        # Names of cameras may contain characters that the font lacks, drawn as boxes.
        warnings.filterwarnings("ignore", "Glyph .* missing from font", UserWarning)
        figure.savefig(temporary)
