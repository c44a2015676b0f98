"""Compressed scenes, decoded by `gsply` (the extra `formats`), and those of web viewers.

PlayCanvas `.compressed.ply`, `.spz` and SOG are read as the Gaussians that they quantise, in the
axes in which they are stored. Some writers of .spz rotate a scene to y-up axes; the cameras of the
original .ply then point past it. gsply must not be given a plain .ply: it silently misreads
properties that are not float32.
"""

import gzip
import importlib
import struct
from pathlib import Path
from typing import Any

import numpy as np
from plyfile import PlyData

from gsc_jax.io.files import check_allocation
from gsc_jax.io.sog import INDEX, META, read_sog
from gsc_jax.io.validation import reported, shown
from gsc_jax.io.web_formats import read_glb, read_ksplat, read_splat
from gsc_jax.scene import Gaussians, InputError

READERS = {".splat": read_splat, ".ksplat": read_ksplat, ".glb": read_glb}
SUFFIXES = (".spz", ".sog", *READERS)
"""Suffixes of compressed scenes that are not PLY files."""
CHUNK_ROWS = 256
CHUNK_BYTES, VERTEX_BYTES, SH_BYTES = 18 * 4, 4 * 4, (9, 24, 45)
"""Bytes per row of the elements of a .compressed.ply, those of `sh` for degree 1 to 3."""
SPZ_MAGIC, ZSTD_HEADER_BYTES = b"NGSP", 18
BYTES_PER_BYTE = 16
"""Memory per byte of quantised Gaussians: each becomes a float32, in up to four arrays."""
BLOCK_BYTES = 2**20


def read_compressed(path: Path, max_bytes: int | None = None) -> Gaussians:
    """Read all Gaussians of a compressed file, or of the folder of a SOG, NumPy float32.

    What a file expands to is compared with `max_bytes` before it is allocated. InputError if it is
    more, the file is damaged or of an unknown version, or gsply is needed and not installed.
    """
    kind = ".sog" if path.is_dir() else path.suffix.lower()
    if path.is_file():
        check_allocation(path, BYTES_PER_BYTE * path.stat().st_size, max_bytes)
        with path.open("rb") as file:
            if file.read(4) in (b"ply\n", b"ply\r") and kind in SUFFIXES:
                raise InputError(f"{path}: is a PLY file; rename it to {path.stem}.ply")
    gsply = None if kind in READERS else _gsply(path)
    with reported(f"{path}: damaged or unknown", f"; get a complete copy, or {_conversion(path)}"):
        if gsply is None:
            return READERS[kind](path, max_bytes)
        if kind == ".spz":
            _check_spz(path, max_bytes)
            return from_gsply(gsply.read_spz(path))
        if kind == ".sog":
            return read_sog(path, lambda data: from_gsply(gsply.sogread(data)), max_bytes)
        return from_gsply(gsply.decompress_from_bytes(path.read_bytes()))


def _gsply(path: Path) -> Any:
    try:
        return importlib.import_module("gsply")
    except ImportError as error:
        remedy = f"pip install 'gsc_jax[formats]', or {_conversion(path)}"
        raise InputError(f"{path}: compressed scenes need gsply: {remedy}") from error


def is_compressed_ply(ply: PlyData, path: Path) -> bool:
    """Return whether a parsed PLY holds packed Gaussians, as PlayCanvas and SuperSplat write them.

    A layout that gsply does not assume raises InputError: gsply would read out of bounds.
    """
    if "vertex" not in ply or "packed_position" not in ply["vertex"]:
        return False
    names = [element.name for element in ply.elements]
    sizes = [element.data.dtype.itemsize for element in ply.elements]
    counts = [len(element) for element in ply.elements]
    known = (
        names in (["chunk", "vertex"], ["chunk", "vertex", "sh"])
        and sizes[:2] == [CHUNK_BYTES, VERTEX_BYTES]
        and counts[0] * CHUNK_ROWS >= counts[1]
        and (len(names) == 2 or (sizes[2] in SH_BYTES and counts[2] == counts[1]))
        and (not ply.text and ply.byte_order == "<")
    )
    if not known:
        raise InputError(
            f"{path}: compressed PLY of an unknown layout ({shown(', '.join(names))}), expected "
            f"chunks of {CHUNK_ROWS} Gaussians as PlayCanvas writes them; {_conversion(path)}"
        )
    return True


def _check_spz(path: Path, max_bytes: int | None) -> None:
    """Refuse a .spz whose streams expand to more than is allowed; nothing of them is kept."""
    data = path.read_bytes()
    if not data.startswith(SPZ_MAGIC):
        with gzip.open(path) as stream:
            while stream.read(BLOCK_BYTES):
                check_allocation(path, BYTES_PER_BYTE * stream.tell(), max_bytes)
        return
    import zstandard  # only for version 4, whose table and streams state sizes

    streams, table = struct.unpack_from("<BI", data, 15)
    sizes = list(struct.iter_unpack("<QQ", data[table : table + 16 * streams]))
    check_allocation(path, BYTES_PER_BYTE * sum(size for _, size in sizes), max_bytes)
    start = table + 16 * streams
    for compressed_size, size in sizes:
        # The decoder allocates the size that the stream itself states.
        if zstandard.frame_content_size(data[start : start + ZSTD_HEADER_BYTES]) > size:
            raise ValueError("a stream is larger than the table of streams says")
        start += compressed_size


def from_gsply(data: Any) -> Gaussians:
    """Gaussians of a `gsply.GSData`."""
    bands = [data.sh0[:, None]] + ([] if data.shN is None else [data.shN])
    columns = {"means": data.means, "log_scales": data.scales, "quats": data.quats}
    columns |= {"logit_opacities": data.opacities.ravel(), "sh": np.concatenate(bands, axis=1)}
    return Gaussians(**{name: np.asarray(c, np.float32) for name, c in columns.items()})


def _conversion(path: Path) -> str:
    inside = [f"{path.name}/{name}" for name in (INDEX, META) if (path / name).is_file()]
    return f"convert it: npx @playcanvas/splat-transform {[*inside, path.name][0]} scene.ply"
