"""Reading the folder of results of `gsc-jax locate`.

Files that do not fit together are refused. Nothing outside the folder is read, where it may have
changed since the run.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np
import pydantic

from gsc_jax.io.cameras import load_cameras
from gsc_jax.io.ply import read_ply
from gsc_jax.io.validation import one_line
from gsc_jax.scene import Camera, Gaussians, InputError

AGAIN = "run gsc-jax locate again"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Results:
    """A folder of results.

    Attributes:
        folder: The folder.
        report: Content of result.json.
        gaussians: The N Gaussians that can be rendered, NumPy float32.
        rows: Row of each of them in the scene file, ascending, shape (N,) int64.
        total: Number of rows of the scene file.
        tamper: Scores in [0, 1], shape (N,) float32.
        labels: Tampered Gaussians, shape (N,) bool.
        cameras: The cameras of the masks, at the size of the masks.
    """

    folder: Path
    report: dict[str, Any]
    gaussians: Gaussians
    rows: np.ndarray
    total: int
    tamper: np.ndarray
    labels: np.ndarray
    cameras: list[Camera]

    @property
    def threshold(self) -> float:
        """Score above which a Gaussian was labelled as tampered."""
        return float(self.report["config"]["threshold"])


class _Config(pydantic.BaseModel):
    threshold: float
    near: float


class _Counts(pydantic.BaseModel):
    gaussians: int
    tampered: int


class _View(pydantic.BaseModel):
    name: str
    width: int
    height: int


class _Report(pydantic.BaseModel):
    """The keys of result.json that are read again."""

    config: _Config
    counts: _Counts
    per_view: list[_View]
    tampered_share_of_views: float


def read_results(folder: str | Path) -> Results:
    """Read the results of `gsc-jax locate`.

    Args:
        folder: The --out of the run.

    Raises:
        InputError: if the folder holds no results, or files of it are missing, damaged, of another
            version or of another run.
    """
    folder = Path(folder)
    report = _read_report(folder)
    scene = read_ply(folder / "tamper.ply")
    tamper = _read_by_row(folder / "tamper.npy", scene.total, np.floating)
    labels = _read_by_row(folder / "labels.npy", scene.total, np.bool_)
    expected, found = report["counts"]["tampered"], int(np.count_nonzero(labels[scene.rows]))
    if expected != found:
        raise InputError(
            f"{folder / 'labels.npy'}: {found:,} Gaussians are labelled, but {expected:,} in "
            f"result.json; they are of different runs: {AGAIN}"
        )
    return Results(
        folder=folder,
        report=report,
        gaussians=scene.gaussians,
        rows=scene.rows,
        total=scene.total,
        tamper=tamper[scene.rows].astype(np.float32),
        labels=labels[scene.rows],
        cameras=_read_cameras(folder / "views.json", report["per_view"]),
    )


def _read_report(folder: Path) -> dict[str, Any]:
    path = folder / "result.json"
    if not path.is_file():
        found = "holds no results of gsc-jax locate" if folder.is_dir() else "no such folder"
        raise InputError(f"{folder}: {found} (result.json); give the --out of a run")
    report = None
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        _Report.model_validate(report)
    except pydantic.ValidationError as error:
        raise InputError(
            f"{one_line(error, str(path), report)}; the version is another one: {AGAIN}"
        ) from error
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: damaged ({error}); {AGAIN}") from error
    return report


def _read_by_row(path: Path, total: int, kind: type) -> np.ndarray:
    """An array with a value per row of the scene file."""
    try:
        values = np.load(path, allow_pickle=False)
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; {AGAIN}") from error
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path}: damaged ({error}); {AGAIN}") from error
    if values.shape != (total,) or not np.issubdtype(values.dtype, kind):
        raise InputError(
            f"{path}: holds {values.dtype} values of shape {values.shape}, but tamper.ply has "
            f"{total:,} rows; they are of different runs: {AGAIN}"
        )
    return values


def _read_cameras(path: Path, views: list[dict[str, Any]]) -> list[Camera]:
    if not path.is_file():
        raise InputError(f"{path}: no such file; {AGAIN}")
    cameras = load_cameras(path)
    stored = [(camera.name, camera.width, camera.height) for camera in cameras]
    if stored != [(view["name"], view["width"], view["height"]) for view in views]:
        raise InputError(
            f"{path}: the cameras are not the {len(views)} of result.json; they are of different "
            f"runs: {AGAIN}"
        )
    return cameras
