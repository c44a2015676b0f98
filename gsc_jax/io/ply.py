"""Scenes as .ply files, read by property name, so that the layout of any exporter is accepted.

plyfile does the parsing: any order of properties, ascii or binary of either byte order, values and
extra properties of any type. A result is the input scene plus one property. Rows that cannot be
rendered are excluded from the Gaussians, counted by reason, and stay in the file.
"""

import copy
import dataclasses
import io
import re
import shutil
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
from plyfile import PlyData, PlyElement, PlyElementParseError, PlyProperty

from gsc_jax.io import compressed
from gsc_jax.io.files import atomic, check_allocation, existing_file
from gsc_jax.io.layout import REST_COUNTS, checked_scores, decode, encode
from gsc_jax.io.sog import sog_folder
from gsc_jax.io.validation import brief, reported, shown
from gsc_jax.scene import Array, Gaussians, InputError, invalid_rows
from gsc_jax.scene.gaussians import usable_rows
from gsc_jax.scene.parallel import blocks
from gsc_jax.scene.pytree import short_repr

LUMA = np.array([0.299, 0.587, 0.114])
"""Weights of red, green and blue in the luminance (ITU-R BT.601)."""
PACKED = {b"\x1f\x8b": "gunzip -c", b"PK": "unzip -p", b"BZh": "bunzip2 -c", b"\xfd7zXZ": "xz -dc"}
"""Command that unpacks a compressed file, by the first bytes of the file."""
MAX_HEADER_BYTES = 2**16
"""Headers of scenes have 2 kB; plyfile would search the whole file for the end of one."""
BYTES_PER_BYTE, BYTES_PER_NUMBER, BYTES_PER_LIST = 3, 8, 160
"""Memory per byte of a binary file: the file, its Gaussians and temporary columns. Memory per
property and row of a text or of lists, where plyfile allocates all rows before it reads one."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlyScene:
    """A scene and the content of its file.

    Attributes:
        gaussians: The N Gaussians that can be rendered, NumPy float32.
        rows: Row of each of them in the file, ascending, shape (N,) int64.
        ply: The whole file, in memory; for a compressed scene its INRIA layout.
        dropped: Number of excluded rows by reason; a row counts under its first reason.
    """

    gaussians: Gaussians
    rows: np.ndarray
    ply: PlyData
    dropped: dict[str, int]

    __repr__ = short_repr

    @property
    def total(self) -> int:
        """Number of rows in the file, including the excluded ones."""
        return len(self.ply["vertex"])

    @property
    def dropped_summary(self) -> str:
        """One line about the excluded rows; empty if there are none."""
        reasons = ", ".join(f"{reason}: {count}" for reason, count in self.dropped.items())
        count = sum(self.dropped.values())
        return f"left out {count} of {self.total} Gaussians ({reasons})" if count else ""

    def expand(self, values: Array) -> np.ndarray:
        """Distribute values per Gaussian, shape (N, ...), to the rows of the file, (total, ...).

        Excluded rows get 0; another number of values raises ValueError.
        """
        values = np.asarray(values)
        if values.shape[:1] != self.rows.shape:
            raise ValueError(f"expected {len(self.rows)} values, got shape {values.shape}")
        expanded = np.zeros((self.total, *values.shape[1:]), values.dtype)
        expanded[self.rows] = values
        return expanded


def read_ply(path: str | Path, *, max_bytes: int | None = None) -> PlyScene:
    """Read a scene with the whole content of its file.

    Supported are the INRIA, gsplat, SuperSplat, GS-Checker and 2DGS layouts of degree 0 to 3, and
    those of `gsc_jax.io.compressed`. The file may be overwritten afterwards. Ascii is very slow.

    Args:
        path: A .ply, .compressed.ply, .spz, .sog, .splat, .ksplat or .glb, or a SOG folder.
        max_bytes: Memory that may be allocated; see `memory_limit` for the default.

    Returns:
        The scene; `dropped` counts the Gaussians that cannot be rendered.

    Raises:
        InputError: If the file is missing, not a PLY or damaged, lacks properties, holds no
            Gaussian that can be rendered, or takes more memory.
    """
    path = sog_folder(path) or existing_file(path, expected="a scene (.ply)")
    is_ply = path.is_file() and path.suffix.lower() not in compressed.SUFFIXES
    ply = _parse(path, max_bytes) if is_ply else None
    if ply is None or compressed.is_compressed_ply(ply, path):
        ply = encode(compressed.read_compressed(path, max_bytes))
    return _scene(ply, path)


def load_ply(path: str | Path, *, max_bytes: int | None = None) -> Gaussians:
    """Read the Gaussians of a scene and warn in one line if rows were left out.

    Args:
        path: A .ply, .compressed.ply, .spz, .sog, .splat, .ksplat or .glb, or a SOG folder.
        max_bytes: Memory that may be allocated; see `memory_limit` for the default.

    Returns:
        The Gaussians that can be rendered, NumPy float32; InputError as for `read_ply`.
    """
    scene = read_ply(path, max_bytes=max_bytes)
    if scene.dropped:
        warnings.warn(f"{path}: {scene.dropped_summary}", UserWarning, stacklevel=2)
    return scene.gaussians


def save_ply(path: str | Path, gaussians: Gaussians, *, tamper: Array | None = None) -> None:
    """Write the plain INRIA layout: binary little endian float32, normals zero.

    Args:
        path: The file to write or to replace.
        gaussians: N Gaussians.
        tamper: Score per Gaussian, shape (N,), written as the last property `tamper`.

    Raises:
        InputError: If the file cannot be written, or could not be read again: there is no Gaussian
            that can be rendered, the degree is not 0 to 3, or there are not N finite scores.
    """
    host = jax.tree.map(np.asarray, gaussians)
    scores = None if tamper is None else checked_scores(path, tamper, len(host))
    save_parts(path, host, lambda rows: host.take(rows), scores)


def save_tampered(path: str | Path, scene: PlyScene, tamper: Array) -> None:
    """Write the scene as it was read, plus a last float32 property `tamper`.

    Every row, property, element and comment is kept, in order and type; an existing property
    `tamper` is replaced. The output is binary little endian and may replace the file that was read.
    Scores have shape (N,); excluded rows get 0.
    """
    scores = scene.expand(checked_scores(path, tamper, len(scene.rows)))
    vertex = scene.ply["vertex"]
    _write(path, scene.ply, lambda rows: _with_tamper(vertex, scores, rows), len(vertex))


def save_parts(
    path: str | Path,
    gaussians: Gaussians,
    part: Callable[[slice], Gaussians],
    scores: np.ndarray | None = None,
) -> None:
    """Write the Gaussians that `part` gives for rows of a scene, if they could be read again."""
    if Path(path).suffix.lower() in compressed.SUFFIXES:
        raise InputError(f"{path}: not written: this is another format than .ply; rename it")
    if 3 * np.shape(gaussians.sh)[1] - 3 not in REST_COUNTS or not usable_rows(gaussians).any():
        raise InputError(
            f"{path}: not written: expected Gaussians that can be rendered, of degree 0 to 3, "
            f"found {len(gaussians)} with colours of shape {np.shape(gaussians.sh)}"
        )

    def vertices(rows: slice) -> PlyElement:
        vertex = encode(part(rows))["vertex"]
        return vertex if scores is None else _with_tamper(vertex, scores[rows])

    _write(path, PlyData([vertices(slice(0, 1))], byte_order="<"), vertices, len(gaussians))


def _parse(path: Path, max_bytes: int | None) -> PlyData:
    expected = "; expected the .ply of a 3D Gaussian splatting scene (a .splat needs that suffix)"
    with reported(f"{path}: not a PLY file that can be read", expected):
        header = _checked_header(path, max_bytes)
        try:
            # Text values beyond float32 become infinite; `invalid_rows` judges their rows.
            with np.errstate(over="ignore"):
                ply = _read(path, header)
        except PlyElementParseError as error:
            promised = f"; its header promises {error.element.count}" if error.element else ""
            found = f"damaged or cut short ({brief(error)}{promised})"
            raise InputError(f"{path}: {found}; copy or export the file again") from error
    for element in ply.elements:
        # plyfile maps the file into memory; a copy stays valid when the file changes.
        element.data = np.array(element.data)
    return ply


def _checked_header(path: Path, max_bytes: int | None) -> bytes:
    """Refuse headers that promise more rows than the file can hold, or more memory than allowed."""
    size = path.stat().st_size
    with path.open("rb") as file:
        header, *end = re.split(rb"(?<=[\r\n])end_header", file.read(MAX_HEADER_BYTES), maxsplit=1)
    if tool := next((tool for magic, tool in PACKED.items() if header.startswith(magic)), None):
        raise InputError(f"{path}: is packed; unpack it first: {tool} {shown(path.name)} > new.ply")
    if not header.startswith(b"ply") or not end:
        if header.startswith(b"version https://git-lfs"):
            raise InputError(f"{path}: is a pointer of git-lfs; get the file with git lfs pull")
        raise ValueError(f"no header from ply to end_header in its first {MAX_HEADER_BYTES} bytes")
    needed, rows = BYTES_PER_BYTE * size, 0
    number = BYTES_PER_NUMBER if header.split()[1:3] == [b"format", b"ascii"] else 0
    for words in map(bytes.split, header.splitlines()):
        if words[:1] == [b"element"]:
            rows = int(words[-1])
            if not 0 <= rows <= size:  # a row takes a byte or more
                raise ValueError(f"cut short? its header promises {rows} rows in {size} bytes")
        elif words[:1] == [b"property"]:
            needed += rows * (BYTES_PER_LIST if b"list" in words[1:2] else number)
    check_allocation(path, needed, max_bytes)
    return header


def _read(path: Path, header: bytes) -> PlyData:
    """Read a PLY file; if its header is not ASCII, plyfile gets a copy with escapes in it."""
    if header.isascii():
        return PlyData.read(path)
    text = header.decode("utf-8", "backslashreplace")
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        copied = Path(folder) / "ascii.ply"  # in a file, because plyfile maps those
        with path.open("rb") as file, copied.open("wb") as out:
            out.write(text.encode("ascii", "backslashreplace"))
            file.seek(len(header))
            shutil.copyfileobj(file, out)
        return PlyData.read(copied)


def _scene(ply: PlyData, path: Path) -> PlyScene:
    if "vertex" not in ply or not len(ply["vertex"]):
        raise InputError(f"{path}: holds no Gaussians (no vertices); export the scene again")
    stored = decode(ply["vertex"], path)
    keep, dropped = np.ones(len(stored), bool), {}
    for reason, invalid in invalid_rows(stored).items():
        if count := int(np.count_nonzero(keep & invalid)):
            dropped[reason] = count
        keep &= ~invalid
    rows = np.flatnonzero(keep)
    gaussians = stored if keep.all() else stored.take(rows)
    scene = PlyScene(gaussians=gaussians, rows=rows, ply=ply, dropped=dropped)
    if not len(rows):
        found = f"no Gaussian can be rendered: {scene.dropped_summary}"
        raise InputError(f"{path}: {found}; export the scene again")
    return scene


def _with_tamper(vertex: PlyElement, scores: np.ndarray, rows: slice = np.s_[:]) -> PlyElement:
    """Copy of rows of vertices with their scores as the last property `tamper`."""
    scored = copy.copy(vertex)  # keeps comments and the types of list properties
    kept = [prop for prop in vertex.properties if prop.name != "tamper"]
    dtype = [(prop.name, vertex.data.dtype[prop.name]) for prop in kept]
    data = np.empty(len(scores[rows]), [*dtype, ("tamper", "<f4")])
    for prop in kept:
        data[prop.name] = vertex.data[prop.name][rows]
    data["tamper"] = scores[rows]
    scored.data, scored.properties = data, (*kept, PlyProperty("tamper", "f4"))
    return scored


def _write(
    path: str | Path, ply: PlyData, vertices: Callable[[slice], PlyElement], count: int
) -> None:
    """Write a PLY whose `count` vertices are computed in blocks, which bounds the memory.

    It is binary little endian, and not in the byte order of the input: plyfile 1.1 ignores that for
    scalars next to a list. plyfile itself cannot write rows with a colon in a property name.
    """
    first, whole = vertices(slice(0, 1)), copy.copy(ply)
    whole.elements = [first if element.name == "vertex" else element for element in ply.elements]
    whole.text, whole.byte_order = False, "<"
    with atomic(path) as temporary, temporary.open("wb") as file:
        header = whole.header.replace("\nelement vertex 1\n", f"\nelement vertex {count}\n")
        file.write(f"{header}\n".encode("ascii"))
        for element in ply.elements:
            parts = map(vertices, blocks(count)) if element.name == "vertex" else [element]
            for part in parts:
                data = part.data.astype(part.dtype("<"), copy=False)
                file.write(_with_lists(part) if data.dtype.hasobject else data.view(np.uint8))


def _with_lists(element: PlyElement) -> memoryview:
    """Rows that hold lists, in little endian."""
    alone, stream = PlyData([element], byte_order="<"), io.BytesIO()
    alone.write(stream)
    return stream.getbuffer()[len(alone.header) + 1 :]
