"""What `gsc-jax locate` left in a folder, read back for those who look at it or grade it.

All of it has to fit together, or the folder is refused: nothing is read from elsewhere, where it
may have changed since.
"""

import dataclasses
import json
from pathlib import Path
from typing import Any

import numpy as np

from gsc_jax.io.cameras import load_cameras
from gsc_jax.io.masks import image_path
from gsc_jax.io.ply import read_ply
from gsc_jax.scene import Camera, Gaussians, InputError


@dataclasses.dataclass(frozen=True, kw_only=True)
class Results:
    """A folder of results.

    Attributes:
        folder: Where they are.
        report: What result.json says.
        gaussians: The N Gaussians that can be rendered, NumPy float32.
        rows: Row of each of them in the scene that was given, ascending, shape (N,) int64.
        total: Number of rows of that scene, with those left out.
        tamper: Scores in [0, 1], shape (N,) float32.
        labels: Tampered Gaussians, shape (N,) bool.
        cameras: Those that were looked from, at the size of their masks.
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
        """The score above which a Gaussian was called tampered."""
        return float(self.report["config"]["threshold"])

    def mask_path(self, name: str) -> Path:
        """Where the final mask of a camera is."""
        return image_path(self.folder / "masks", name)


def read_results(folder: str | Path) -> Results:
    """Reads what `gsc-jax locate` wrote.

    Args:
        folder: Its --out.

    Returns:
        The results.

    Raises:
        InputError: if the folder holds no results, or files of it are missing, damaged, of another
            version or of another scene.
    """
    folder = Path(folder)
    report = _report(folder)
    scene = read_ply(folder / "tamper.ply")
    tamper = _by_row(folder / "tamper.npy", scene.total, np.floating)
    labels = _by_row(folder / "labels.npy", scene.total, np.bool_)
    said, found = report["counts"]["tampered"], int(np.count_nonzero(labels[scene.rows]))
    if said != found:
        raise InputError(
            f"{folder / 'labels.npy'}: {found:,} Gaussians are tampered, but result.json tells of "
            f"{said:,}; they are of different runs: run gsc-jax locate again"
        )
    return Results(
        folder=folder,
        report=report,
        gaussians=scene.gaussians,
        rows=scene.rows,
        total=scene.total,
        tamper=tamper[scene.rows].astype(np.float32),
        labels=labels[scene.rows],
        cameras=_cameras(folder / "views.json", report["per_view"]),
    )


def _report(folder: Path) -> dict[str, Any]:
    """result.json, once it is known to hold what is used of it."""
    path = folder / "result.json"
    if not path.is_file():
        found = "holds no results of gsc-jax locate" if folder.is_dir() else "no such folder"
        raise InputError(f"{folder}: {found} (result.json); give the --out of a run")
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
        _used(report)
    except (OSError, ValueError) as error:
        raise InputError(f"{path}: damaged ({error}); run gsc-jax locate again") from error
    except (LookupError, TypeError) as error:
        raise InputError(
            f"{path}: not of a version of gsc-jax locate that can be read ({error} is missing or "
            "different); run gsc-jax locate again"
        ) from error
    return report


def _used(report: dict[str, Any]) -> list[Any]:
    """All that is used of a report, of its type; raises where it is not there."""
    config, counts, views = report["config"], report["counts"], report["per_view"]
    return [
        *(float(config[key]) for key in ("threshold", "near")),
        *(int(counts[key]) for key in ("gaussians", "tampered")),
        *((str(view["name"]), int(view["width"]), int(view["height"])) for view in views),
        float(report["tampered_share_of_views"]),
    ]


def _by_row(path: Path, total: int, kind: type) -> np.ndarray:
    """An array with a value per row of the scene."""
    try:
        values = np.load(path, allow_pickle=False)
    except FileNotFoundError as error:
        raise InputError(f"{path}: no such file; run gsc-jax locate again") from error
    except (OSError, ValueError, EOFError) as error:
        raise InputError(f"{path}: damaged ({error}); run gsc-jax locate again") from error
    if values.shape != (total,) or not np.issubdtype(values.dtype, kind):
        raise InputError(
            f"{path}: holds {values.dtype} values of shape {values.shape}, but tamper.ply has "
            f"{total:,} rows; they are of different runs: run gsc-jax locate again"
        )
    return values


def _cameras(path: Path, views: list[dict[str, Any]]) -> list[Camera]:
    """The cameras looked from, in the order of the report."""
    if not path.is_file():
        raise InputError(f"{path}: no such file; run gsc-jax locate again")
    cameras = load_cameras(path)
    stored = [(camera.name, camera.width, camera.height) for camera in cameras]
    if stored != [(view["name"], view["width"], view["height"]) for view in views]:
        raise InputError(
            f"{path}: has not the {len(views)} cameras that result.json tells of; they are of "
            "different runs: run gsc-jax locate again"
        )
    return cameras
