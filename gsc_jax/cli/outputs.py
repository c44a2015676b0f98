"""What `locate` leaves in its folder: scenes, masks, pictures for people, numbers for programs.

The pictures for people are JPEG, of every view: a report that lacks the one view that somebody asks
about is of no use. Rendering them at the size of thumbnails would cost as much, since most of the
time goes into sorting the Gaussians. What is measured later is PNG.
"""

import dataclasses
import importlib.metadata
import json
import math
import os
import platform
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import jax
import numpy as np

from gsc_jax.cli.located import Located
from gsc_jax.cli.pictures import contact_sheet, jpeg_path, overlay, write_jpeg
from gsc_jax.cli.report.page import report_page
from gsc_jax.cli.staging import files_below
from gsc_jax.evidence.monitor import Progress, silent
from gsc_jax.io.cameras import save_cameras
from gsc_jax.io.files import atomic
from gsc_jax.io.masks import image_path, write_mask, write_probability
from gsc_jax.io.ply import PlyScene, save_highlight, save_tampered
from gsc_jax.locate import Result
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.parallel import WORKERS, ahead
from gsc_jax.splat import render

PACKAGES = ("gsc_jax", "numpy", "jax", "jaxlib", "optax")
MOST_PICTURES, MOST_ROWS = 8, 4
"""Of the overview: views that are held for it, and those shown."""


def write_results(
    folder: Path,
    scene: PlyScene,
    cameras: Sequence[Camera],
    result: Result,
    *,
    progress: Progress,
) -> None:
    """Writes all of the results but the reports, report.html and result.json.

    Args:
        folder: Where to.
        scene: The scene as it was read.
        cameras: The cameras that have a mask in the result.
        result: What was found.
        progress: Called with (stage, done, total).
    """
    kept = {camera.name for camera in evenly(cameras, MOST_PICTURES)}
    progress("write", 0, len(cameras))
    save_cameras(folder / "views.json", cameras)
    _write_scenes(folder, scene, result)
    progress("write", 0, len(cameras))  # what comes is in proportion to the views
    gaussians = jax.device_put(scene.gaussians)
    renders: dict[str, np.ndarray] = {}

    def written(camera: Camera) -> np.ndarray:
        _write_masks(folder, camera, result)
        return _write_pictures(folder, gaussians, camera, result)

    with ThreadPoolExecutor(WORKERS) as pool:
        images = zip(cameras, ahead(pool, written, cameras), strict=True)
        for done, (camera, image) in enumerate(images, start=1):
            if camera.name in kept:
                renders[camera.name] = image
            progress("write", done, len(cameras))
    _write_overview(folder / "overview.png", renders, result)


def write_report(
    folder: Path, command: dict[str, Any], located: Located, *, progress: Progress = silent
) -> None:
    """Writes report.html for people, and result.json, the same in numbers.

    Args:
        folder: Where to; what lies in it is listed.
        command: The arguments of the command line.
        located: The run.
        progress: Called with (stage, done, total).
    """
    outputs = sorted([*files_below(folder), "report.html", "result.json"])
    report = plain({**_numbers(command, located), "outputs": outputs})
    page = report_page(folder, report, located, progress=progress)
    with atomic(folder / "report.html") as temporary:
        temporary.write_text(page, encoding="utf-8")
    with atomic(folder / "result.json") as temporary:
        text = json.dumps(report, indent=2, allow_nan=False, ensure_ascii=False)
        temporary.write_text(text + "\n", encoding="utf-8")


def _numbers(command: dict[str, Any], located: Located) -> dict[str, Any]:
    """How the run was configured and what it found."""
    result, scene = located.result, located.scene
    seen = int(result.seen.sum())
    return {
        "command": command,
        "method": result.method,
        "config": dataclasses.asdict(result.config),
        "seed": result.config.seed,
        "verdict": result.verdict,
        "native": result.native
        and {
            "verdict": result.native.verdict,
            "traces": {t.name: t.explanation for t in result.native.traces if t.found},
        },
        "counts": {
            "rows": scene.total,
            "dropped": scene.dropped,
            "gaussians": len(scene.rows),
            "seen": seen,
            "unseen": len(scene.rows) - seen,
            "tampered": int(result.labels.sum()),
        },
        "views": len(result.masks),
        "judged_views": len(result.detections),
        "effort": result.effort
        and {**dataclasses.asdict(result.effort), "reason": result.effort.reason},
        "tampered_share_of_views": located.visible_share,
        "per_view": [_view(camera, result) for camera in located.cameras],
        "seconds": located.seconds,
        "stages": located.stages,
        "warnings": located.warnings,
        "versions": versions(),
        "date": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _write_scenes(folder: Path, scene: PlyScene, result: Result) -> None:
    """What was found, by Gaussian."""
    save_tampered(folder / "tamper.ply", scene, result.tamper)
    save_highlight(folder / "highlight.ply", scene.gaussians, result.labels)
    _save_array(folder / "labels.npy", scene.expand(result.labels))
    _save_array(folder / "tamper.npy", scene.expand(result.tamper))


def _write_masks(folder: Path, camera: Camera, result: Result) -> None:
    """The final mask of a view, and what the detector said."""
    name = camera.name
    write_mask(image_path(folder / "masks", name), result.masks[name])
    if name in result.detections:
        write_probability(image_path(folder / "detector", name), result.detections[name])


def _write_pictures(
    folder: Path, gaussians: Gaussians, camera: Camera, result: Result
) -> np.ndarray:
    """Writes a view as it is and with what was found marked, and gives its render."""
    image = np.asarray(render(gaussians, camera, near=result.config.near)[0])
    write_jpeg(jpeg_path(folder / "render", camera.name), image)
    marked = overlay(image, result.masks[camera.name])
    write_jpeg(jpeg_path(folder / "overlay", camera.name), marked)
    return image


def evenly(cameras: Sequence[Camera], count: int) -> list[Camera]:
    """At most `count` cameras, evenly spread over their order.

    The last is not next to the first, as these are neighbours when somebody walked around.
    """
    count = min(count, len(cameras))
    return [cameras[i * len(cameras) // count] for i in range(count)]


def _write_overview(path: Path, renders: dict[str, np.ndarray], result: Result) -> None:
    """The first views that a 2D detector judged, if it judged any of those rendered."""
    judged = [name for name in renders if name in result.detections] or list(renders)
    step = -(-len(judged) // MOST_ROWS)
    names = judged[::step]
    rows = []
    for name in names:
        image = renders[name]
        blank = np.zeros(image.shape[:2], np.float16)
        said = [result.detections.get(name, blank)] if result.detections else []
        rows.append([image, *said, overlay(image, result.masks[name])])
    detector = ["2D detector"] if result.detections else []
    contact_sheet(path, rows, titles=("render", *detector, "found"), labels=names)


def _view(camera: Camera, result: Result) -> dict[str, Any]:
    said = result.detections.get(camera.name)
    return {
        "name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "tampered_share": float(result.masks[camera.name].mean()),
        "detector_share": None if said is None else float((said > 0.5).mean()),
        "reliability": result.reliability.get(camera.name),
    }


def versions() -> dict[str, str]:
    """What this ran on: packages, Python, platform and device."""
    versions = {name: importlib.metadata.version(name) for name in PACKAGES}
    device = jax.devices()[0]
    return {
        "python": platform.python_version(),
        **versions,
        "platform": platform.platform(),
        "device": f"{device.platform}: {device.device_kind}",
    }


def plain(value: Any) -> Any:
    """The same for JSON, which knows neither paths nor numbers that are not finite.

    What of a path is not UTF-8 becomes an escape such as `xff`, also inside of a warning.
    """
    if isinstance(value, dict):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, list | tuple):
        return [plain(entry) for entry in value]
    if isinstance(value, np.generic):
        value = value.item()
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, str | Path):
        return os.fsencode(value).decode("utf-8", "backslashreplace")
    return value


def _save_array(path: Path, values: np.ndarray) -> None:
    with atomic(path) as temporary:
        np.save(temporary, values)
