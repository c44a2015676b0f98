"""Files that `locate` writes into its folder.

Pictures have full size: most of the time of a small render would also go into sorting.
"""

import dataclasses
import hashlib
import importlib.metadata
import json
import math
import os
import platform
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import jax
import numpy as np

from gsc_jax.cli.pictures import CANDIDATE, SHEET_ROWS, TINT, contact_sheet, layer_path, overlay
from gsc_jax.cli.report.page import report_page
from gsc_jax.cli.report.wording import are_candidates
from gsc_jax.cli.scene_input import evenly_spaced
from gsc_jax.cli.staging import BY_CAMERA, FILES, files_below
from gsc_jax.evidence.masks import RENDER, SCORE
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.evidence.storage import ArrayStore
from gsc_jax.io.cameras import save_cameras
from gsc_jax.io.files import atomic
from gsc_jax.io.highlight import save_highlight
from gsc_jax.io.masks import write_image, write_mask, write_probability
from gsc_jax.io.ply import PlyScene, save_tampered
from gsc_jax.locate import Result
from gsc_jax.scene import Camera
from gsc_jax.scene.parallel import map_views

PACKAGES = ("gsc_jax", "numpy", "jax", "jaxlib", "optax")


@dataclasses.dataclass(frozen=True)
class Located:
    """A finished run of `locate`, whose masks are files in the folder of the results.

    Times and warnings of the result include those of reading and writing. `inputs` has size and
    SHA-256 of each input, by path; `report` is the content of result.json once it is written.
    """

    scene: PlyScene
    cameras: list[Camera]
    result: Result
    inputs: dict[str, dict[str, Any]] = dataclasses.field(default_factory=dict)
    contrasts: dict[str, float] = dataclasses.field(default_factory=dict)
    report: dict[str, Any] = dataclasses.field(default_factory=dict)


def write_results(folder: Path, located: Located, store: ArrayStore, *, monitor: Monitor) -> None:
    """Write all but report.html and result.json; the store has the `pictures` of all views."""
    scene, cameras, result = located.scene, located.cameras, located.result
    monitor.progress("write", 0, len(cameras))
    save_cameras(folder / "views.json", cameras)
    save_tampered(folder / "tamper.ply", scene, result.tamper)
    candidates = are_candidates(result.verdict)
    tint = CANDIDATE if candidates else TINT
    save_highlight(folder / "highlight.ply", scene.gaussians, result.labels, candidates=candidates)
    save_array(folder / "labels.npy", scene.expand(result.labels))
    save_array(folder / "tamper.npy", scene.expand(result.tamper))

    def write_view(camera: Camera) -> None:
        name, mask = camera.name, result.masks[camera.name]
        image = store.get(RENDER, name) / np.float32(255)
        write_mask(layer_path(folder, "masks", name), mask)
        write_probability(layer_path(folder, "scores", name), store.get(SCORE, name))
        if name in result.probabilities:
            write_probability(layer_path(folder, "detector", name), result.probabilities[name])
        write_image(layer_path(folder, "render", name), image)
        write_image(layer_path(folder, "overlay", name), overlay(image, mask, tint))

    list(monitor.track("write", map_views(write_view, cameras), len(cameras)))
    _write_overview(folder / "overview.png", cameras, result, store)


def planned_outputs(
    cameras: Sequence[Camera], files: Sequence[str] = FILES, folders: Sequence[str] = BY_CAMERA
) -> list[str]:
    """Every file that is written for these cameras, relative to the folder of results."""
    paths = [layer_path("", folder, camera.name) for camera in cameras for folder in folders]
    return [*files, *(path.as_posix() for path in paths)]


def write_report(
    folder: Path, command: dict, located: Located, *, monitor: Monitor
) -> dict[str, Any]:
    """Write report.html and result.json; return the content of the latter."""
    outputs = sorted([*files_below(folder), "report.html", "result.json"])
    report = jsonable({**numbers(command, located), "outputs": outputs})
    page = report_page(folder, report, located.result, monitor=monitor)
    with atomic(folder / "report.html") as temporary:
        temporary.write_text(page, encoding="utf-8")
    write_json(folder / "result.json", report)
    return report


def numbers(command: dict[str, Any], located: Located) -> dict[str, Any]:
    """Configuration and results of a run."""
    result = located.result
    config = dataclasses.asdict(result.estimator)  # pyright: ignore[reportArgumentType]
    scene, seen = located.scene, int(result.seen.sum())
    stopping, prior = result.early_stopping, result.prior
    views = [_view(camera, result) for camera in located.cameras]
    traces = {t.name: t.explanation for t in getattr(prior, "traces", ()) if t.found}
    return {
        "command": command,
        "method": result.method,
        "config": config,
        "seed": result.estimator.seed,
        "verdict": result.verdict,
        "outcome": result.outcome,
        "attributes": prior and {"verdict": prior.verdict, "traces": traces, "rank": result.rank},
        "counts": {
            "rows": scene.total,
            "dropped": scene.dropped,
            "gaussians": len(scene.rows),
            "seen": seen,
            "unseen": len(scene.rows) - seen,
            "tampered": int(result.labels.sum()),
        },
        "contrasts": located.contrasts,
        "views": len(result.masks),
        "judged_views": len(result.probabilities),
        "early_stopping": stopping and {**dataclasses.asdict(stopping), "reason": stopping.reason},
        "tampered_share_of_views": float(np.mean([view["tampered_share"] for view in views])),
        "per_view": views,
        "seconds": result.seconds,
        "stages": result.stages,
        "warnings": result.warnings,
        "inputs": located.inputs,
        "configuration": hashlib.sha256(json.dumps(jsonable(config)).encode()).hexdigest(),
        "versions": versions(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _view(camera: Camera, result: Result) -> dict[str, Any]:
    probability = result.probabilities.get(camera.name)
    return {
        "name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "tampered_share": float(result.masks[camera.name].mean()),
        "detector_share": None if probability is None else float((probability > 0.5).mean()),
        "reliability": result.reliability.get(camera.name),
    }


def _write_overview(path: Path, cameras: list[Camera], result: Result, store: ArrayStore) -> None:
    """Write a picture with the views of the largest masks, preferably views that a detector saw."""
    judged = [camera for camera in cameras if camera.name in result.probabilities] or cameras
    shares = {camera.name: result.masks[camera.name].mean() for camera in judged}
    shown = evenly_spaced(judged, SHEET_ROWS)
    if any(shares.values()):
        shown = sorted(judged, key=lambda camera: -shares[camera.name])[:SHEET_ROWS]
    tint, found = (CANDIDATE, "candidates") if are_candidates(result.verdict) else (TINT, "found")
    rows = {}
    for name in (camera.name for camera in shown):
        image = store.get(RENDER, name) / np.float32(255)
        detector = [result.probabilities[name]] if result.probabilities else []
        rows[name] = [image, *detector, overlay(image, result.masks[name], tint)]
    titles = ["render", *(["2D detector"] if result.probabilities else []), found]
    contact_sheet(path, rows, titles=titles)


def versions() -> dict[str, str]:
    """Versions of the packages and of Python, the platform and the device."""
    device = jax.devices()[0]
    return {
        "python": platform.python_version(),
        **{name: importlib.metadata.version(name) for name in PACKAGES},
        "platform": platform.platform(),
        "device": f"{device.platform}: {device.device_kind}",
    }


def jsonable(value: Any) -> Any:
    """A value for JSON: paths as text, bytes that are not UTF-8 as escapes, NaN as null."""
    if isinstance(value, dict):
        return {jsonable(str(key)): jsonable(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [jsonable(entry) for entry in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, str | Path):
        return os.fsencode(value).decode("utf-8", "backslashreplace")
    return value


def write_json(path: Path, value: Any) -> None:
    """Write a JSON file atomically, with what `jsonable` makes of the value."""
    text = json.dumps(jsonable(value), indent=2, allow_nan=False, ensure_ascii=False)
    with atomic(path) as temporary:
        temporary.write_text(text + "\n", encoding="utf-8")


def save_array(path: Path, values: np.ndarray) -> None:
    """Write a .npy file atomically."""
    with atomic(path) as temporary:
        np.save(temporary, values)
