"""Compressed scenes, decoded by `gsply` (the extra `formats`).

PlayCanvas `.compressed.ply`, `.spz` and `.sog` are read as the Gaussians that they quantise, in the
axes in which they are stored. Some writers of .spz rotate a scene to y-up axes; the cameras of the
original .ply then point past it. gsply must not be given a plain .ply: it silently misreads
properties that are not float32.
"""

import importlib
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
"""Bytes per row of the elements of a .compressed.ply, those of `sh` for degree 1 to 3."""


def read_compressed(path: Path) -> Gaussians:
    """Read all Gaussians of a .spz or .sog file or a PlayCanvas .compressed.ply, NumPy float32.

    Raises:
        InputError: If gsply is not installed, does not know the format, or finds the file damaged.
    """
    kind = path.suffix.lower()
    if kind in (".splat", ".ksplat"):
        raise InputError(f"{path}: {kind} files are not supported; {_conversion(path)}")
    try:
        gsply = importlib.import_module("gsply")
    except ImportError as error:
        raise InputError(
            f"{path}: compressed scenes need gsply: pip install 'gsc_jax[formats]', "
            f"or {_conversion(path)}"
        ) from error
    readers = {".spz": gsply.read_spz, ".sog": gsply.sogread}
    try:
        if kind in readers:
            return _gaussians(readers[kind](path))
        return _gaussians(gsply.decompress_from_bytes(path.read_bytes()))
    except Exception as error:  # a decoder may raise anything on damaged bytes
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: gsply cannot read it ({reason}); {_conversion(path)}") from error


def is_compressed_ply(ply: "PlyData", path: Path) -> bool:
    """Return whether a parsed PLY holds packed Gaussians, as PlayCanvas and SuperSplat write them.

    Raises:
        InputError: If its elements differ from the layout that gsply assumes: gsply would read out
            of bounds.
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
            f"{path}: compressed PLY of an unknown layout ({', '.join(names)}), expected chunks of "
            f"{CHUNK_ROWS} Gaussians as PlayCanvas writes them; {_conversion(path)}"
        )
    return True


def _gaussians(data: Any) -> Gaussians:
    """Gaussians of a `gsply.GSData`."""
    bands = [data.sh0[:, None]] + ([] if data.shN is None else [data.shN])
    return Gaussians(
        means=np.asarray(data.means, np.float32),
        log_scales=np.asarray(data.scales, np.float32),
        quats=np.asarray(data.quats, np.float32),
        logit_opacities=np.asarray(data.opacities, np.float32).reshape(-1),
        sh=np.concatenate(bands, axis=1, dtype=np.float32),
    )


def _conversion(path: Path) -> str:
    return f"convert it: npx @playcanvas/splat-transform {path.name} scene.ply"
