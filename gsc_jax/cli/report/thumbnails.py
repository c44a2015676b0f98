"""Thumbnails inside the page, with links to the full images beside it.

Thumbnails get smaller with the number of views, so that the page stays small enough for an e-mail.
"""

import base64
import io
import math
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

from gsc_jax.cli.pictures import jpeg_path
from gsc_jax.cli.report.wording import share
from gsc_jax.io.masks import image_path
from gsc_jax.scene.parallel import WORKERS, bounded_map

LAYERS = {
    "render": "Render",
    "detector": "Probability map",
    "masks": "Final mask",
    "overlay": "Overlay",
}
"""Images of a view: folder and title, in the order of their keys."""
MAX_SIDE_PIXELS, MIN_SIDE_PIXELS = 320, 120
"""Longest side of a thumbnail: the width of a column, and what is still recognisable."""
FULL_SIZE_VIEWS = 150
"""Views up to which thumbnails have full size: a test checks that 200 take less than 14 MB."""
JPEG_QUALITY = 76
GREY_LEVELS = 8
"""Grey levels of a mask: enough for smooth edges."""


class Thumbnail(NamedTuple):
    """An image of a view: its layer, the thumbnail as a data URI, and the URL of the full image."""

    layer: str
    source: str
    full: str
    alt: str


def thumbnails(folder: Path, views: Sequence[dict[str, Any]]) -> Iterator[list[Thumbnail]]:
    """Yield the existing layers of each view, in the order of `LAYERS`.

    Args:
        folder: Folder of results.
        views: `per_view` of result.json.
    """
    side = thumbnail_side(len(views))

    def of_view(view: dict[str, Any]) -> list[Thumbnail]:
        made = []
        for layer in LAYERS:
            place = image_path if layer in ("detector", "masks") else jpeg_path
            path = place(folder / layer, view["name"])
            if path.is_file():
                made.append(
                    Thumbnail(layer, data_uri(path, side), url(path, folder), _alt(layer, view))
                )
        return made

    with ThreadPoolExecutor(WORKERS) as pool:
        yield from bounded_map(pool, of_view, views)


def thumbnail_side(views: int) -> int:
    """Longest side of thumbnails in pixels, such that their bytes in total stay about the same."""
    scale = min(1.0, math.sqrt(FULL_SIZE_VIEWS / max(views, 1)))
    return max(MIN_SIDE_PIXELS, round(MAX_SIDE_PIXELS * scale))


def url(path: Path, folder: Path) -> str:
    """Percent-encoded URL of a file, relative to a page in the folder."""
    return quote(os.fsencode(path.relative_to(folder).as_posix()))


def data_uri(path: Path, side: int) -> str:
    """Shrink a .jpg, or a grey .png with few levels, to a data URI; `side` is in pixels."""
    from PIL import Image

    lossy = path.suffix == ".jpg"
    with Image.open(path) as image:
        image.draft("RGB", (side, side))
        small = image.convert("RGB" if lossy else "L")
    small.thumbnail((side, side), Image.Resampling.BOX)
    file = io.BytesIO()
    if lossy:
        small.save(file, "JPEG", quality=JPEG_QUALITY, optimize=True)
    else:
        small.quantize(GREY_LEVELS).save(file, "PNG", optimize=True)
    text = base64.b64encode(file.getvalue()).decode()
    return f"data:image/{'jpeg' if lossy else 'png'};base64,{text}"


def _alt(layer: str, view: dict[str, Any]) -> str:
    tampered = share(view["tampered_share"])
    detail = {
        "render": "",
        "detector": f", {share(view['detector_share'] or 0.0)} flagged",
        "masks": f", {tampered} tampered",
        "overlay": f", render with {tampered} marked as tampered",
    }
    return f"{LAYERS[layer]} of {view['name']}{detail[layer]}"
