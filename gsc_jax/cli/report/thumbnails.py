"""Thumbnails inside the page, small enough for an e-mail, with links to the full images."""

import base64
import io
import math
import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote

import numpy as np
from PIL import Image

from gsc_jax.cli.pictures import layer_path
from gsc_jax.scene.parallel import map_views

LAYERS = {"render": "Render", "detector": "Probability map"}
LAYERS |= {"masks": "Final mask", "overlay": "Overlay"}
"""Images of a view: folder and title, in the order of their keys."""
MAX_SIDE_PIXELS, MIN_SIDE_PIXELS = 320, 120
"""Longest side of a thumbnail: the width of a column, and what is still recognisable."""
FULL_SIZE_VIEWS = 150
"""Views up to which thumbnails have full size: a test checks that 200 take less than 14 MB."""
GREY_LEVELS = 8
"""Grey levels of a mask: enough for smooth edges."""


class Thumbnail(NamedTuple):
    """An image of a view: its layer, the thumbnail as a data URI, and the URL of the full image."""

    layer: str
    source: str
    full: str


def thumbnails(folder: Path, names: Sequence[str]) -> Iterator[list[Thumbnail]]:
    """The images of each view in a folder of results: those of `LAYERS` that exist."""
    side = thumbnail_side(len(names))

    def of_view(name: str) -> list[Thumbnail]:
        return [
            Thumbnail(layer, data_uri(path, side), url(path, folder))
            for layer in LAYERS
            if (path := layer_path(folder, layer, name)).is_file()
        ]

    return map_views(of_view, names)


def thumbnail_side(views: int) -> int:
    """Longest side of thumbnails in pixels, such that their bytes in total stay about the same."""
    side = MAX_SIDE_PIXELS * math.sqrt(FULL_SIZE_VIEWS / max(views, 1))
    return min(MAX_SIDE_PIXELS, max(MIN_SIDE_PIXELS, round(side)))


def url(path: Path, folder: Path) -> str:
    """Percent-encoded URL of a file, relative to a page in the folder."""
    return quote(os.fsencode(path.relative_to(folder).as_posix()))


def data_uri(path: Path, side: int) -> str:
    """Shrink a .jpg, or a grey .png, to a data URI; `side` is in pixels."""
    lossy = path.suffix == ".jpg"
    with Image.open(path) as image:
        image.draft("RGB", (side, side))
        if image.mode.startswith("I"):  # 16 bits, which Pillow clips
            small = Image.fromarray((np.asarray(image) >> 8).astype(np.uint8))
        else:
            small = image.convert("RGB" if lossy else "L")
    small.thumbnail((side, side), Image.Resampling.BOX)
    file = io.BytesIO()
    kind, picture = ("jpeg", small) if lossy else ("png", small.quantize(GREY_LEVELS))
    picture.save(file, kind, quality=76, optimize=True)  # PNG has no quality
    return f"data:image/{kind};base64,{base64.b64encode(file.getvalue()).decode()}"
