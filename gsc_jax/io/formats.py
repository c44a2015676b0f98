"""Compressed scenes, decoded through `gsply` (the extra `formats`).

PlayCanvas `.compressed.ply`, `.spz` and `.sog` come back as the Gaussians that they quantise, in
the axes in which they are stored. Some writers of .spz turn a scene to y-up axes: the cameras of
the original .ply then look past it. gsply is never given a plain .ply, of which it misreads
properties that are not float32. What it cannot read is named with the tool that converts it.
"""

import importlib
import types
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from gsc_jax.scene import Gaussians, InputError

if TYPE_CHECKING:
    from plyfile import PlyData

SUFFIXES = (".spz", ".sog", ".splat", ".ksplat")
"""Suffixes of compressed scenes that are not PLY files."""

CHUNK_ROWS = 256
CHUNK_BYTES, VERTEX_BYTES, SH_BYTES = 18 * 4, 4 * 4, (9, 24, 45)


def read_compressed(path: str | Path) -> Gaussians:
    """Reads an .spz or .sog file, or a PlayCanvas .compressed.ply.

    Args:
        path: An existing file.

    Returns:
        All Gaussians of the file, NumPy float32, as exact as the format is.

    Raises:
        InputError: if gsply is not installed, does not know the format, or finds the file damaged.
    """
    path = Path(path)
    kind = path.suffix.lower()
    if kind in (".splat", ".ksplat"):
        raise InputError(f"{path}: {kind} files are not read here; {_conversion(path)}")
    gsply = _import_gsply(path)
    try:
        if kind == ".spz":
            return _gaussians(gsply.read_spz(path))
        if kind == ".sog":
            return _gaussians(gsply.sogread(path))
        return _gaussians(gsply.decompress_from_bytes(path.read_bytes()))
    except Exception as error:  # a decoder of foreign bytes may raise anything
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: gsply cannot read it ({reason}); {_conversion(path)}") from error


def is_compressed_ply(ply: "PlyData") -> bool:
    """Whether a PLY holds packed Gaussians, as PlayCanvas and SuperSplat compress them."""
    return "vertex" in ply and "packed_position" in ply["vertex"]


def check_compressed_ply(ply: "PlyData", path: str | Path) -> None:
    """Checks the layout that gsply takes for granted and reads out of bounds without.

    Args:
        ply: The file, as plyfile reads it.
        path: Its name, for the message.

    Raises:
        InputError: if the elements are not chunk, vertex and perhaps sh, of the known sizes.
    """
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
            f"{path}: compressed PLY of an unknown layout ({', '.join(names)}), expected chunks of "
            f"{CHUNK_ROWS} Gaussians as PlayCanvas writes them; {_conversion(Path(path))}"
        )


def _import_gsply(path: Path) -> types.ModuleType:
    try:
        return importlib.import_module("gsply")
    except ImportError as error:
        raise InputError(
            f"{path}: compressed scenes need gsply: pip install 'gsc_jax[formats]', "
            f"or {_conversion(path)}"
        ) from error


def _gaussians(data: Any) -> Gaussians:
    bands = [np.asarray(data.sh0)[:, None]]
    if data.shN is not None:
        bands.append(np.asarray(data.shN))
    return Gaussians(
        means=np.asarray(data.means, np.float32),
        log_scales=np.asarray(data.scales, np.float32),
        quats=np.asarray(data.quats, np.float32),
        logit_opacities=np.asarray(data.opacities, np.float32).reshape(-1),
        sh=np.concatenate(bands, axis=1, dtype=np.float32),
    )


def _conversion(path: Path) -> str:
    return f"convert it: npx @playcanvas/splat-transform {path.name} scene.ply"
