"""Small pictures that a page carries inside itself, with where the large ones lie beside it.

The more views there are, the smaller they get, so that a report can be mailed whatever the scene.
"""

import base64
import dataclasses
import io
import math
import os
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any
from urllib.parse import quote

from gsc_jax.cli.pictures import jpeg_path
from gsc_jax.cli.report.wording import share
from gsc_jax.io.masks import image_path
from gsc_jax.scene.parallel import WORKERS, ahead

SIDE, LEAST_SIDE = 320, 120
"""Longest side of a picture in pixels, and that of very many."""
MANY = 150
"""Views from which on they get smaller."""
QUALITY = 76
LEVELS = 8
"""Grey levels of a mask: enough for smooth edges."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Layer:
    """One of the pictures that there are of a view.

    Attributes:
        name: The folder of such pictures.
        title: What people choose it by.
    """

    name: str
    title: str


LAYERS = (
    Layer(name="render", title="Render"),
    Layer(name="detector", title="Detector mask"),
    Layer(name="masks", title="Final mask"),
    Layer(name="overlay", title="Overlay"),
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Picture:
    """A layer of a view.

    Attributes:
        layer: Its name.
        source: The small picture, as a data URI.
        full: Where the large one lies, relative to the folder, as a URL.
        alt: What is to be seen.
        width: Of the small picture, in pixels.
        height: Of the small picture, in pixels.
    """

    layer: str
    source: str
    full: str
    alt: str
    width: int
    height: int


def pictures(folder: Path, views: Sequence[dict[str, Any]]) -> Iterator[list[Picture]]:
    """The pictures of each view that lie in a folder of results.

    Args:
        folder: The folder.
        views: `per_view` of result.json.

    Yields:
        Of each view those layers that there are, in the order of `LAYERS`.
    """
    side = thumbnail_side(len(views))

    def of(view: dict[str, Any]) -> list[Picture]:
        paths = {layer.name: _path(folder, layer, view["name"]) for layer in LAYERS}
        return [
            _picture(folder, layer, paths[layer.name], view, side)
            for layer in LAYERS
            if paths[layer.name].is_file()
        ]

    with ThreadPoolExecutor(WORKERS) as pool:
        yield from ahead(pool, of, views)


def thumbnail_side(views: int) -> int:
    """Longest side of the pictures of so many views, in pixels; their bytes stay about the same."""
    return max(LEAST_SIDE, round(SIDE * min(1.0, math.sqrt(MANY / max(views, 1)))))


def url(path: Path, folder: Path) -> str:
    """A file as a link from a page in the folder, whatever its name holds."""
    return quote(os.fsencode(path.relative_to(folder).as_posix()))


def _path(folder: Path, layer: Layer, name: str) -> Path:
    place = image_path if layer.name in ("detector", "masks") else jpeg_path
    return place(folder / layer.name, name)


def _picture(folder: Path, layer: Layer, path: Path, view: dict[str, Any], side: int) -> Picture:
    source, width, height = thumbnail(path, side)
    return Picture(
        layer=layer.name,
        source=source,
        full=url(path, folder),
        alt=_alt(layer, view),
        width=width,
        height=height,
    )


def _alt(layer: Layer, view: dict[str, Any]) -> str:
    said = {
        "render": "",
        "detector": f", {share(view['detector_share'] or 0.0)} flagged",
        "masks": f", {share(view['tampered_share'])} tampered",
        "overlay": f": the render with {share(view['tampered_share'])} marked as tampered",
    }
    return f"{layer.title} of {view['name']}{said[layer.name]}"


def thumbnail(path: Path, side: int) -> tuple[str, int, int]:
    """A small picture as a data URI, and its width and height.

    Args:
        path: A .jpg, or a grey .png, of which a palette of a few levels is left.
        side: Its longest side in pixels, at most.
    """
    from PIL import Image

    lossy = path.suffix == ".jpg"
    with Image.open(path) as picture:
        picture.draft("RGB", (side, side))
        small = picture.convert("RGB" if lossy else "L")
    small.thumbnail((side, side), Image.Resampling.BOX)
    written = io.BytesIO()
    if lossy:
        small.save(written, "JPEG", quality=QUALITY, optimize=True)
    else:
        small.quantize(LEVELS).save(written, "PNG", optimize=True)
    kind = "jpeg" if lossy else "png"
    text = base64.b64encode(written.getvalue()).decode()
    return f"data:image/{kind};base64,{text}", small.width, small.height
