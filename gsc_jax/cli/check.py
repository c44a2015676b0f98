"""`gsc-jax check`: is a 3DGS file sound, and what will viewers make of it?"""

import dataclasses
import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple

import numpy as np
import tyro
from plyfile import PlyData, PlyListProperty

from gsc_jax.cli.options import Switch, arg
from gsc_jax.forensics.copy_move import row_hashes
from gsc_jax.io.compressed import SUFFIXES
from gsc_jax.io.files import memory_limit
from gsc_jax.io.layout import DC, NORMAL, POSITION, REST, ROTATION, SCALE
from gsc_jax.io.ply import MAX_HEADER_BYTES, PlyScene, read_ply
from gsc_jax.render.projection import MIN_ALPHA
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.render.visibility import MAX_COLOUR, storage_warnings
from gsc_jax.scene import Gaussians, InputError

INRIA = (*POSITION, *NORMAL, *DC, *REST, "opacity", *SCALE, *ROTATION)
HASH_FACTOR = np.uint64(0x9E3779B97F4A7C15)
"""Odd, so that a hash of several columns keeps all bits."""
FAR, FLAT, NEEDLE, UNIT_TOLERANCE = 100, 1e-7, 1e4, 1e-3
"""Extremes: distance and least size in spreads of the scene, ratio of axes, |length - 1|."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Check:
    """Check a 3DGS file: its layout, its numbers, and what viewers will make of them.

    for example:
      gsc-jax check scene.ply
      gsc-jax check scene.spz --json

    exit code:
      0 if the scene can be used, also with warnings; 2 if not

    Attributes:
        scene: A scene of any format that `locate` reads.
        json: Print JSON: file, usable, format, rows, gaussians, sh_degree, problems, error.
        memory: Memory in GiB that may be used; a file that expands to more is refused.
    """

    scene: Annotated[tyro.conf.Positional[Path], arg("FILE")]
    json: Switch = False
    memory: Annotated[float | None, arg("GIB", "half of the machine's")] = None


class Problem(NamedTuple):
    """Something unusual in `rows` rows, 0 where it concerns the whole file.

    A warning may change what is shown, or what a program can read; a note is harmless as a rule.
    """

    level: Literal["warning", "note"]
    name: str
    rows: int
    text: str


def run_check(options: Check, *, say: Callable[[str], None]) -> tuple[list[str], list[str]]:
    """Check a file: lines to print, and warnings; a file that cannot be used raises InputError.

    With --json, the error is printed as JSON, too, with `say`.
    """
    path, limit = options.scene, memory_limit(options.memory)
    facts: dict[str, Any] = {"file": str(path), "usable": False}
    facts |= dict.fromkeys(("format", "rows", "gaussians", "sh_degree", "error"))
    try:
        scene = read_ply(path, max_bytes=limit)
    except InputError as error:
        if options.json:
            report = {**facts, "problems": [], "error": str(error)}
            for line in json.dumps(report, indent=2).splitlines():
                say(line)
        raise
    problems = [*layout_problems(scene.ply), *row_problems(scene)]
    facts |= {"usable": True, "format": _format(path, scene.ply), "rows": scene.total}
    if facts["format"].startswith("binary") and (more := _bytes_after(path, scene.ply)):
        text = f"{_count(more, 'byte')} after the last row, which readers ignore; export it again"
        problems.append(Problem("warning", "bytes after the end", 0, text))
    facts |= {"gaussians": len(scene.rows), "sh_degree": scene.gaussians.sh_degree}
    if options.json:
        report = {**facts, "problems": [problem._asdict() for problem in problems]}
        return json.dumps(report, indent=2).splitlines(), []
    counts = [_count(sum(p.level == x for p in problems), x) for x in ("warning", "note")]
    return [
        f"{path}: can be used; {', '.join(counts)}",
        f"format   {facts['format']}, {scene.total:,} rows, degree {facts['sh_degree']}",
        *(
            f"{p.level:8} {_count(p.rows, 'row') + ': ' if p.rows else ''}{p.text}"
            for p in problems
        ),
    ], []


def _count(number: int, noun: str) -> str:
    return f"{number:,} {noun}{'' if number == 1 else 's'}"


def layout_problems(ply: PlyData) -> Iterator[Problem]:
    """What readers other than this package may not expect of the layout of a PLY file."""
    vertex = ply["vertex"]
    names = [prop.name for prop in vertex.properties]
    if ply.text or ply.byte_order == ">":
        kind = "text" if ply.text else "big endian"
        yield Problem("warning", "encoding", 0, f"is {kind}; most viewers read little endian only")
    types = {vertex.data.dtype[name].base.newbyteorder("<").str for name in names if name in INRIA}
    if types != {"<f4"}:
        text = f"numbers are {', '.join(sorted(types))}; many viewers read float32 (<f4) only"
        yield Problem("warning", "types", 0, text)
    known = [name for name in INRIA if name in names]
    if names[: len(known)] != known:
        text = "the order of the properties is not that of INRIA; readers by position misread it"
        yield Problem("warning", "order", 0, text)
    elif not set(NORMAL) <= set(names):
        text = "has no normals; INRIA's viewer, which reads by position, misreads every row"
        yield Problem("warning", "normals", 0, text)
    if SCALE[2] not in names:
        yield Problem("warning", "discs", 0, "is a 2DGS file; viewers of 3DGS miss scale_2")
    if other := [name for name in names if name not in INRIA]:
        text = f"has more properties ({', '.join(other)}), with which INRIA's viewer misreads rows"
        yield Problem("warning", "unknown", 0, text)
    if others := [element.name for element in ply.elements if element is not vertex]:
        yield Problem("note", "elements", 0, f"viewers ignore its elements {', '.join(others)}")


def row_problems(scene: PlyScene) -> Iterator[Problem]:
    """Gaussians that cannot be rendered, and extreme values among the others."""
    for reason, count in scene.dropped.items():
        text = f"{reason}; gsc-jax ignores such a row, a viewer may show nothing or crash"
        yield Problem("warning", reason, count, text)
    gaussians = scene.gaussians
    means = np.asarray(gaussians.means, np.float64)
    for name, text in storage_warnings(gaussians, means).items():
        yield Problem("warning", name, 0, text)
    for level, name, rows, text in _extremes(gaussians, means):
        if count := int(np.count_nonzero(rows)):
            yield Problem(level, name, count, text)


def _extremes(
    gaussians: Gaussians, means: np.ndarray
) -> Iterator[tuple[Literal["warning", "note"], str, np.ndarray, str]]:
    """Level, name, rows (N,) bool, and what they mean."""
    middle, ends = np.median(means, axis=0), np.percentile(means, [1, 99], axis=0)
    scales = np.sort(np.exp(np.asarray(gaussians.log_scales, np.float64)), axis=1)
    spread = max(*np.linalg.norm(np.diff(ends, axis=0), axis=1), 3 * np.median(scales[:, 2]), 1e-30)
    length = np.linalg.norm(np.asarray(gaussians.quats, np.float64), axis=1)
    ratio = scales[:, 2] / np.maximum(scales[:, 1], 1e-30)
    hashes = np.zeros(len(means), np.uint64)
    for values in vars(gaussians).values():
        hashes = HASH_FACTOR * hashes + row_hashes(np.asarray(values).reshape(len(means), -1))
    copies = np.ones(len(means), bool)
    copies[np.unique(hashes, return_index=True)[1]] = False
    far = np.linalg.norm(means - middle, axis=1) > FAR * spread
    yield "warning", "far", far, "far outside the scene; a viewer that frames all shows a dot"
    huge = scales[:, 2] > spread
    yield "warning", "huge", huge, "larger than the scene; haze, or a wall before the camera"
    yield "warning", "copies", copies, "exact copies of others, which are blended twice"
    wild = np.abs(Y0 * np.asarray(gaussians.sh)[:, 0]).max(axis=1) > MAX_COLOUR
    yield "warning", "colours", wild, "base colours far beyond 0 to 1"
    yield "note", "needles", ratio > NEEDLE, "needles; they flicker at low resolution"
    yield "note", "flat", scales[:, 2] < FLAT * spread, "too small to be seen"
    invisible = np.asarray(gaussians.opacities) < MIN_ALPHA
    yield "note", "invisible", invisible, "opacity below 1/255; most rasterisers skip them"
    text = "rotations are not unit quaternions; viewers normalise them, some converters do not"
    yield "note", "rotations", abs(length - 1) > UNIT_TOLERANCE, text


def _format(path: Path, ply: PlyData) -> str:
    if path.is_dir() or path.suffix.lower() in SUFFIXES:
        return "folder of a SOG" if path.is_dir() else path.suffix.lower()
    if b"\nproperty uint packed_position" in _header(path):
        return ".compressed.ply"
    orders = {"<": "little", ">": "big"}
    return "ascii .ply" if ply.text else f"binary {orders.get(ply.byte_order, '')} endian .ply"


def _bytes_after(path: Path, ply: PlyData) -> int:
    """Bytes after the last row of a binary PLY; 0 if it has lists: their sizes are unknown here."""
    properties = [prop for element in ply.elements for prop in element.properties]
    if any(isinstance(prop, PlyListProperty) for prop in properties):
        return 0
    header = _header(path)
    start = len(header) + len(b"\nend_header\n") + (b"\r\n" in header)
    rows = sum(element.data.nbytes for element in ply.elements)
    return max(path.stat().st_size - start - rows, 0)  # the lines of some headers end in CR


def _header(path: Path) -> bytes:
    with path.open("rb") as file:
        return file.read(MAX_HEADER_BYTES).partition(b"\nend_header")[0]
