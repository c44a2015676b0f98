"""Scenes as .ply files, read by property name so that every exporter's layout is understood.

plyfile does the parsing: any order of properties, ascii or binary of either byte order, values and
extra properties of any type. What is not ours is kept, so that a result is the scene that was given
plus one property. Rows that cannot be rendered are left out of the Gaussians, counted by reason,
and stay in the file. Which property means what is told in `gsc_jax.io.layout`.
"""

import dataclasses
import warnings
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from gsc_jax.io import formats
from gsc_jax.io.files import atomic, existing_file
from gsc_jax.io.layout import decode, encode
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Array, Gaussians, InputError, invalid_rows

if TYPE_CHECKING:
    from plyfile import PlyData, PlyElement

TAMPERED_COLOR = np.array([1.0, 0.1, 0.1])
LUMA = np.array([0.299, 0.587, 0.114])


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlyScene:
    """A scene and the file that it came from.

    Attributes:
        gaussians: The N Gaussians that can be rendered, NumPy float32.
        rows: Row of each of them in the file, ascending, shape (N,) int64.
        ply: All of the file, in memory; for a compressed scene its INRIA layout.
        dropped: Number of rows left out, by reason; a row counts under its first reason.
    """

    gaussians: Gaussians
    rows: np.ndarray
    ply: "PlyData"
    dropped: dict[str, int]

    @property
    def total(self) -> int:
        """Number of rows in the file, with those left out."""
        return len(self.ply["vertex"])

    @property
    def dropped_summary(self) -> str:
        """One line on the rows left out; empty when there are none."""
        reasons = ", ".join(f"{reason}: {count}" for reason, count in self.dropped.items())
        count = sum(self.dropped.values())
        return f"left out {count} of {self.total} Gaussians ({reasons})" if count else ""

    def expand(self, values: Array, *, fill: float = 0) -> np.ndarray:
        """Spreads values per Gaussian over the rows of the file.

        Args:
            values: One entry per Gaussian, shape (N, ...).
            fill: What the rows left out get.

        Returns:
            One entry per row, shape (total, ...), of the same dtype.

        Raises:
            ValueError: if there are not N values.
        """
        values = np.asarray(values)
        if values.shape[:1] != self.rows.shape:
            raise ValueError(f"expected {len(self.rows)} values, got shape {values.shape}")
        spread = np.full((self.total, *values.shape[1:]), fill, values.dtype)
        spread[self.rows] = values
        return spread


def read_ply(path: str | Path) -> PlyScene:
    """Reads a scene with all that its file holds.

    Understood are the INRIA, gsplat, SuperSplat, GS-Checker and 2DGS layouts of degree 0 to 3, and
    compressed scenes through `gsc_jax.io.formats`. The file may be overwritten afterwards. Ascii
    is slow: a minute for a million Gaussians and more.

    Args:
        path: A .ply, .compressed.ply, .spz or .sog file.

    Returns:
        The scene; Gaussians that cannot be rendered are counted in `dropped`.

    Raises:
        InputError: if the file is missing, no PLY or damaged, lacks properties, or holds no
            Gaussian that can be rendered.
    """
    path = existing_file(path, expected="a scene (.ply)")
    if path.suffix.lower() in formats.SUFFIXES:
        ply = encode(formats.read_compressed(path))
    else:
        ply = _parse(path)
    if formats.is_compressed_ply(ply):
        formats.check_compressed_ply(ply, path)
        ply = encode(formats.read_compressed(path))
    return _scene(ply, path)


def load_ply(path: str | Path) -> Gaussians:
    """Reads the Gaussians of a scene; warns in one line when rows were left out.

    Args:
        path: A .ply, .compressed.ply, .spz or .sog file.

    Returns:
        The Gaussians that can be rendered, NumPy float32.

    Raises:
        InputError: as `read_ply`.
    """
    scene = read_ply(path)
    if scene.dropped:
        warnings.warn(f"{path}: {scene.dropped_summary}", UserWarning, stacklevel=2)
    return scene.gaussians


def save_ply(path: str | Path, gaussians: Gaussians, *, tamper: Array | None = None) -> None:
    """Writes the plain INRIA layout: binary little endian float32, normals zero.

    Args:
        path: The file to write or to replace.
        gaussians: N Gaussians.
        tamper: Score per Gaussian, shape (N,), written as the last property `tamper`.

    Raises:
        InputError: if the file cannot be written.
        ValueError: if there are not N scores.
    """
    _write(path, encode(gaussians, tamper=tamper))


def save_tampered(path: str | Path, scene: PlyScene, tamper: Array) -> None:
    """Writes the scene as it was read plus a last float32 property `tamper`.

    Every row, property, element and comment is kept, in order and type; a `tamper` that the file
    had is replaced. The result is binary little endian whatever the file was.

    Args:
        path: The file to write; may be the one that was read.
        scene: What `read_ply` returned.
        tamper: Score per Gaussian, shape (N,); rows left out get 0.

    Raises:
        InputError: if the file cannot be written.
        ValueError: if there are not N scores.
    """
    from plyfile import PlyData

    scores = scene.expand(np.asarray(tamper, np.float32))
    if scores.ndim != 1:
        raise ValueError(f"expected scores of shape (N,), got {np.shape(tamper)}")
    vertex = _with_tamper(scene.ply["vertex"], scores)
    ply = PlyData(
        [vertex if element.name == "vertex" else element for element in scene.ply.elements],
        # Not the order of the file: plyfile 1.1 ignores it for scalars next to a list property.
        byte_order="<",
        comments=scene.ply.comments,
        obj_info=scene.ply.obj_info,
    )
    _write(path, ply)


def save_highlight(path: str | Path, gaussians: Gaussians, labels: Array) -> None:
    """Writes a copy in which any viewer shows the tampered Gaussians red and the others grey.

    Args:
        path: The file to write or to replace.
        gaussians: N Gaussians.
        labels: Which of them are tampered, shape (N,) bool.

    Raises:
        InputError: if the file cannot be written.
    """
    sh = np.asarray(gaussians.sh, np.float32)
    luma = np.clip(0.5 + Y0 * sh[:, 0], 0, 1) @ LUMA
    red = TAMPERED_COLOR * (0.5 + 0.5 * luma[:, None])
    grey = np.repeat(0.2 + 0.5 * luma[:, None], 3, axis=1)
    recolored = np.zeros_like(sh)
    recolored[:, 0] = (np.where(np.asarray(labels, bool)[:, None], red, grey) - 0.5) / Y0
    save_ply(path, dataclasses.replace(gaussians, sh=recolored))


def _parse(path: Path) -> "PlyData":
    from plyfile import PlyData, PlyElementParseError, PlyParseError

    try:
        # A text value beyond float32 becomes infinite, which the validity of its row decides on.
        with np.errstate(over="ignore"):
            ply = PlyData.read(path)
    except PlyElementParseError as error:
        promised = f"; its header promises {error.element.count}" if error.element else ""
        raise InputError(
            f"{path}: damaged or cut short ({error}{promised}); copy or export the file again"
        ) from error
    except (PlyParseError, ValueError, ArithmeticError, LookupError) as error:
        raise InputError(
            f"{path}: not a PLY file that can be read ({error}); expected the .ply of a "
            "3D Gaussian splatting model"
        ) from error
    for element in ply.elements:
        # plyfile maps the file into memory: a copy, so that the file may change meanwhile.
        element.data = np.array(element.data)
    return ply


def _scene(ply: "PlyData", path: Path) -> PlyScene:
    if "vertex" not in ply or not len(ply["vertex"]):
        raise InputError(f"{path}: holds no Gaussians (no vertices); export the scene again")
    stored = decode(ply["vertex"], path)
    keep = np.ones(len(stored), bool)
    dropped = {}
    for reason, invalid in invalid_rows(stored).items():
        if count := int(np.count_nonzero(keep & invalid)):
            dropped[reason] = count
        keep &= ~invalid
    rows = np.flatnonzero(keep)
    gaussians = stored if keep.all() else stored.take(rows)
    scene = PlyScene(gaussians=gaussians, rows=rows, ply=ply, dropped=dropped)
    if not len(rows):
        raise InputError(
            f"{path}: no Gaussian can be rendered: {scene.dropped_summary}; export the scene again"
        )
    return scene


def _with_tamper(vertex: "PlyElement", scores: np.ndarray) -> "PlyElement":
    from plyfile import PlyElement, PlyListProperty

    kept = [prop for prop in vertex.properties if prop.name != "tamper"]
    lists = [prop for prop in kept if isinstance(prop, PlyListProperty)]
    dtype = [(prop.name, vertex.data.dtype[prop.name]) for prop in kept]
    data = np.empty(len(vertex), [*dtype, ("tamper", "<f4")])
    for prop in kept:
        data[prop.name] = vertex.data[prop.name]
    data["tamper"] = scores
    return PlyElement.describe(
        data,
        "vertex",
        len_types={prop.name: prop.len_dtype for prop in lists},
        val_types={prop.name: prop.val_dtype for prop in lists},
        comments=vertex.comments,
    )


def _write(path: str | Path, ply: "PlyData") -> None:
    with atomic(path) as temporary:
        ply.write(str(temporary))
