"""A C loop over the same lists (`limit.c`), compiled here, as the limit of the machine."""

import ctypes
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np

from gsc_jax.render.tiles import TILE, View

SOURCE = Path(__file__).with_name("limit.c")
FLAGS = ["-O3", "-march=native", "-ffast-math", "-fopenmp", "-shared"]


class Counts(ctypes.Structure):
    """Numbers of pairs of pixel and Gaussian."""

    _fields_ = (("evaluated", ctypes.c_long), ("needed", ctypes.c_long))


class Blended(NamedTuple):
    """An image [H, W, D] and the numbers of pairs."""

    image: np.ndarray
    evaluated: int
    needed: int


Blend = Callable[..., Blended]


def compiled() -> Blend | None:
    """The loop as `blend(view, features, threads=1, counting=False)`; None without a compiler."""
    compiler = shutil.which("cc")
    if compiler is None:
        return None
    with tempfile.TemporaryDirectory() as folder:
        library = str(Path(folder) / "limit.so")
        built = subprocess.run(
            [compiler, *FLAGS, "-fPIC", str(SOURCE), "-o", library, "-lm"], capture_output=True
        )
        if built.returncode:
            return None
        loop = ctypes.CDLL(library).blend
    loop.restype = Counts

    def blend(view: View, features, *, threads: int = 1, counting: bool = False) -> Blended:
        rows, columns = -(-view.height // TILE), -(-view.width // TILE)
        features = np.ascontiguousarray(features, np.float32)
        channels = features.shape[1]
        arrays = [np.ascontiguousarray(x) for x in (view.ids, view.tiles, view.starts, view.counts)]
        ids, tiles, starts, lengths = (x.ctypes.data_as(ctypes.c_void_p) for x in arrays)
        splats = np.ascontiguousarray(view.splats)
        out = np.zeros((rows * columns, channels, TILE, TILE), np.float32)
        pointers = [ctypes.c_void_p(x.ctypes.data) for x in (splats, features, out)]
        listed = int(np.sum(arrays[1] < rows * columns))
        counts = loop(
            pointers[0], pointers[1], channels, ids, tiles, starts, lengths, listed, columns,
            pointers[2], int(counting), threads,
        )  # fmt: skip
        cells = out.reshape(rows, columns, channels, TILE, TILE).transpose(0, 3, 1, 4, 2)
        image = cells.reshape(rows * TILE, columns * TILE, channels)[: view.height, : view.width]
        return Blended(image, counts.evaluated, counts.needed)

    return blend
