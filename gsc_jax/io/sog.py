"""SOG of PlayCanvas: a .sog bundle, a folder of its files, or the folder of a streamed scene.

A streamed scene has an index whose tree names rows of SOG folders for each level of detail. Level
0, the finest, is read, and the environment, which all levels share.
https://developer.playcanvas.com/user-manual/gaussian-splatting/formats/streamed-sog/
"""

import io
import json
import zipfile
from collections import defaultdict
from collections.abc import Callable
from pathlib import Path

import jax
from PIL import Image

from gsc_jax.io.files import check_allocation, existing_file
from gsc_jax.io.tables import BYTES_PER_CHARACTER, read_table
from gsc_jax.scene import Gaussians, InputError
from gsc_jax.scene.gaussians import concatenate

META, INDEX = "meta.json", "lod-meta.json"
BYTES_PER_PIXEL = 80
"""Memory per pixel of the images of a SOG: the pixels, and the Gaussian that they describe."""
TABLES = {("scales", "codebook"): 256, ("scales", "mins"): 3, ("scales", "maxs"): 3}
TABLES |= {("sh0", "codebook"): 256, ("sh0", "mins"): 4, ("sh0", "maxs"): 4}
TABLES |= {("shN", "codebook"): 256}
"""Lengths of tables in the meta.json of a SOG, of version 2 and of the one before."""


def sog_folder(path: str | Path) -> Path | None:
    """The path if it is the folder of a scene, streamed or not; None elsewhere.

    The meta.json in it raises InputError: a digest of that file would not be one of the scene.
    """
    path = Path(path)
    if path.name in (INDEX, META) and path.is_file():
        raise InputError(f"{path}: lists the files of a SOG; name the folder {path.parent}")
    return path if any((path / name).is_file() for name in (INDEX, META)) else None


def read_sog(path: Path, decode: Callable[[bytes], Gaussians], max_bytes: int | None) -> Gaussians:
    """Read all Gaussians; `decode` reads a checked bundle. ValueError or KeyError if damaged."""
    if (path / INDEX).is_file():
        return _read_streamed(path, decode, max_bytes)
    data = _bundle(path, max_bytes) if path.is_dir() else path.read_bytes()
    return decode(_checked(data, path, max_bytes))


def _read_streamed(
    folder: Path, decode: Callable[[bytes], Gaussians], max_bytes: int | None
) -> Gaussians:
    index = read_table(folder / INDEX, remedy="export the scene again", max_bytes=max_bytes)
    files, ranges, nodes = dict(enumerate(index["filenames"])), defaultdict(list), [index["tree"]]
    while nodes:
        node = nodes.pop()
        nodes += reversed(node.get("children", []))
        if part := node.get("lods", {}).get("0"):
            place = _chunk(folder, files[part["file"]])
            ranges[place].append((int(part["offset"]), int(part["count"])))
    if environment := index.get("environment"):
        ranges[_chunk(folder, environment)].append((0, None))  # all of its rows
    parts, needed = [], 0
    for place, rows in ranges.items():
        left = None if max_bytes is None else max_bytes - needed
        chunk = decode(_checked(_bundle(place, left), place, left))
        needed += 2 * sum(leaf.nbytes for leaf in jax.tree.leaves(chunk))
        check_allocation(folder, needed, max_bytes)
        end = 0
        for start, count in sorted(rows):
            stop = len(chunk) if count is None else start + count
            if not end <= start <= stop <= len(chunk):
                raise ValueError(f"{place.name} has no rows {start} to {stop}, or two nodes have")
            end = stop
            parts.append(chunk.take(slice(start, stop)))
    if not parts:
        raise ValueError("no Gaussians of level 0")
    return concatenate(parts)


def _chunk(folder: Path, name: str) -> Path:
    """The folder of a meta.json that an index names, inside its own: it may be a stranger's."""
    path = folder / name
    if path.name != META or not path.resolve().is_relative_to(folder.resolve()):
        raise ValueError(f"{name} is not a {META} inside the folder")
    return path.resolve().parent


def _bundle(folder: Path, max_bytes: int | None) -> bytes:
    """The bundle of a folder of a meta.json and its images."""
    stream = io.BytesIO()
    images = sorted(p for p in folder.glob("*.webp") if p.resolve().parent == folder.resolve())
    with zipfile.ZipFile(stream, "w", strict_timestamps=False) as archive:
        for path in (folder / META, *images):
            size = existing_file(path, expected="a part of a SOG").stat().st_size
            check_allocation(folder, 2 * (stream.tell() + size), max_bytes)
            archive.write(path, path.name)
    return stream.getvalue()


def _checked(data: bytes, path: Path, max_bytes: int | None) -> bytes:
    """A SOG, if its entries and images have allowed sizes, and the tables those gsply indexes."""
    needed = 0
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        entries = {entry.filename: entry for entry in archive.infolist()}
        if len(entries) < len(archive.infolist()):
            raise ValueError("two entries of the same name")
        for name, entry in entries.items():
            if entry.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED):
                raise ValueError(f"{name} is compressed in an unusual way")
            needed += (BYTES_PER_CHARACTER if name == META else 1) * entry.file_size
            check_allocation(path, needed, max_bytes)
            if name != META:
                with archive.open(entry) as file, Image.open(file, formats=["WEBP"]) as image:
                    needed += BYTES_PER_PIXEL * image.width * image.height
        check_allocation(path, needed, max_bytes)
        meta = json.loads(archive.read(META))
    # gsply reads tables of these lengths without a check.
    for (attribute, table), length in TABLES.items():
        if (found := len(meta.get(attribute, {}).get(table, range(length)))) != length:
            raise ValueError(f"{attribute}.{table} has {found} entries, expected {length}")
    if not meta.get("count", 1) > 0:
        raise ValueError("no Gaussians")
    return data
