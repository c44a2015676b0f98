"""Reading the folder of results of `gsc-jax locate`.

Files that do not fit together are refused. Nothing outside the folder is read, where it may have
changed since the run; links that lead there are refused.
"""

import dataclasses
import os
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, Field, ValidationError

from gsc_jax.io.cameras import load_cameras
from gsc_jax.io.files import existing_file
from gsc_jax.io.ply import PlyScene, read_ply
from gsc_jax.io.tables import read_table
from gsc_jax.io.validation import one_line, reported
from gsc_jax.scene import Camera, InputError

AGAIN = "run gsc-jax locate again"
Count = Annotated[int, Field(ge=0)]
Share = Annotated[float, Field(ge=0, le=1)]


class _View(BaseModel):
    name: str
    tampered_share: Share = 0
    width: Count
    height: Count


class _Config(BaseModel):  # the ranges are those of the estimators
    threshold: Annotated[float, Field(ge=0, lt=1)]
    near: Annotated[float, Field(ge=1e-9, le=1e9)]


class _Counts(BaseModel):
    gaussians: Count
    tampered: Count


class _Attributes(BaseModel):
    traces: dict[str, str] = {}


class _Report(BaseModel):  # the entries of result.json that are read again; it has others, too
    config: _Config
    counts: _Counts
    per_view: list[_View]
    tampered_share_of_views: Share
    verdict: Share | None = None
    attributes: _Attributes | None = None
    judged_views: Count = 0
    contrasts: dict[str, Share] = {}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Results:
    """A folder of results of `locate`; `report` is the content of its result.json.

    Of the N Gaussians that can be rendered, it has the scores `tamper` in [0, 1], (N,) float32, and
    the labels, (N,) bool. The cameras are those of the masks, at their size.
    """

    folder: Path
    report: dict[str, Any]
    scene: PlyScene
    tamper: np.ndarray
    labels: np.ndarray
    cameras: list[Camera]


def read_results(folder: str | Path, *, max_bytes: int | None = None) -> Results:
    """Read the results of `gsc-jax locate` from the --out of the run.

    `max_bytes` is the memory that may be allocated; see `memory_limit` for the default. InputError
    if files are missing, damaged, of another version or of another run, or take more memory.
    """
    folder = Path(folder)
    report = _read_report(folder)
    scene = read_ply(result_file(folder, "tamper.ply"), max_bytes=max_bytes)
    tamper = read_by_row(result_file(folder, "tamper.npy"), scene.total)[scene.rows]
    if not ((tamper >= 0) & (tamper <= 1)).all():
        raise InputError(f"{folder / 'tamper.npy'}: holds numbers outside [0, 1]; {AGAIN}")
    labels = read_by_row(result_file(folder, "labels.npy"), scene.total)[scene.rows]
    views_file = existing_file(result_file(folder, "views.json"), expected="the cameras of the run")
    if not isinstance(read_table(views_file, remedy=AGAIN, max_bytes=max_bytes), list):
        # A transforms.json names images anywhere, whose sizes would be read.
        raise InputError(f"{views_file}: expected a list of cameras; {AGAIN}")
    cameras = load_cameras(views_file, max_bytes=max_bytes)
    views = [(view["name"], view["width"], view["height"]) for view in report["per_view"]]
    rows = scene.ply["vertex"].data
    stored = rows["tamper"][scene.rows] if "tamper" in rows.dtype.names else np.zeros(0)
    for name, same in (
        ("tamper.ply", report["counts"]["gaussians"] == len(scene.rows)),
        ("tamper.ply", np.array_equal(stored, tamper.astype(np.float32))),
        ("labels.npy", report["counts"]["tampered"] == np.count_nonzero(labels)),
        ("views.json", views == [(c.name, c.width, c.height) for c in cameras]),
    ):
        if not same:
            raise InputError(f"{folder / name}: result.json is of a different run; {AGAIN}")
    by_row = {"tamper": tamper.astype(np.float32), "labels": labels.astype(bool)}
    return Results(folder=folder, report=report, scene=scene, cameras=cameras, **by_row)


def result_file(folder: Path, name: str | Path) -> Path:
    """Path of a file in a folder of results; InputError if a link leads out of the folder."""
    path = folder / name
    if not Path(os.path.realpath(path)).is_relative_to(os.path.realpath(folder)):
        raise InputError(f"{path}: a link leads out of {folder} and is refused; copy the file")
    return path


def read_by_row(path: Path, total: int) -> np.ndarray:
    """Read a .npy file of `total` numbers, one per row of a scene file, or raise InputError."""
    expected = f"a .npy of {total:,} numbers, one per row of the scene"
    existing_file(path, expected=expected)
    with reported(f"{path}: damaged", f", expected {expected}"):
        # Mapped, so that a shape in the header that the file does not have allocates nothing.
        found = np.lib.format.open_memmap(path, mode="r")
    if found.shape != (total,) or found.dtype.kind not in "biuf":
        raise InputError(f"{path}: holds {found.dtype} of shape {found.shape}, expected {expected}")
    return np.array(found)


def _read_report(folder: Path) -> dict[str, Any]:
    if not (path := result_file(folder, "result.json")).exists():
        found = "is a file, not a folder" if folder.is_file() else "no such folder"
        found = "holds no results of gsc-jax locate" if folder.is_dir() else found
        raise InputError(f"{folder}: {found} (result.json); give the --out of a run")
    report = read_table(path, remedy=AGAIN)
    try:
        _Report.model_validate(report, strict=True)  # the values are used as they are
    except ValidationError as error:
        raise InputError(f"{one_line(error, str(path), report)}; {AGAIN}") from error
    return report
