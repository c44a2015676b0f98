"""A small folder of results in the format of `locate`, written without running it."""

import dataclasses
import json
from pathlib import Path

import numpy as np

from gsc_jax.io.cameras import save_cameras
from gsc_jax.io.ply import read_ply, save_ply, save_tampered
from gsc_jax.render.orbit import orbit_cameras
from gsc_jax.scene import Camera, Gaussians

COUNT, OBJECT = 2000, 4
"""Gaussians in the file; every fourth belongs to the object."""
BROKEN = (7, 12)
"""Rows that cannot be rendered; the second belongs to the object."""
THRESHOLD = 0.5
RED, BLUE = (1.5, -1.2, -1.2), (-1.2, -1.2, 1.5)


def ball_over_floor(count: int, every: int) -> tuple[Gaussians, np.ndarray]:
    """A blue floor under a red ball, to which one Gaussian in `every` belongs (N,)."""
    rng = np.random.default_rng(0)
    ball = np.arange(count) % every == 0
    floor_means = rng.uniform(-1, 1, (count, 3)) * [1, 0.02, 1] + [0, 0.4, 0]
    ball_means = rng.normal(size=(count, 3))
    ball_means *= 0.3 / np.linalg.norm(ball_means, axis=1, keepdims=True)
    gaussians = Gaussians(
        means=np.where(ball[:, None], ball_means, floor_means).astype(np.float32),
        log_scales=np.full((count, 3), -2.6, np.float32),
        quats=rng.normal(size=(count, 4)).astype(np.float32),
        logit_opacities=np.full(count, 3, np.float32),
        sh=np.where(ball[:, None], RED, BLUE)[:, None].astype(np.float32),
    )
    return gaussians, ball


def write_results(folder: Path, *, views: int = 3, count: int = COUNT) -> list[Camera]:
    """Write the folder; return its cameras, at the size of their masks."""
    gaussians, ball = ball_over_floor(count, OBJECT)
    gaussians.means[list(BROKEN)] = np.nan
    rng = np.random.default_rng(1)
    scores = np.where(ball, rng.uniform(0.6, 1, count), rng.uniform(0, 0.4, count))
    scores[list(BROKEN)] = 0
    scores = scores.astype(np.float32)
    folder.mkdir(parents=True, exist_ok=True)
    save_ply(folder / "scene.ply", gaussians)
    scene = read_ply(folder / "scene.ply")
    save_tampered(folder / "tamper.ply", scene, scores[scene.rows])
    np.save(folder / "tamper.npy", scores)
    np.save(folder / "labels.npy", scores > THRESHOLD)
    around = orbit_cameras(scene.gaussians, views + 1, size=(80, 60))[:-1]
    cameras = [
        dataclasses.replace(camera, name=f"view/{index}.JPG") for index, camera in enumerate(around)
    ]
    save_cameras(folder / "views.json", cameras)
    report = {
        "config": {"threshold": THRESHOLD, "near": 0.2},
        "verdict": 0.97,
        "tampered_share_of_views": 0.125,
        "counts": {"gaussians": len(scene.rows), "tampered": int((scores > THRESHOLD).sum())},
        "per_view": [
            {"name": camera.name, "width": camera.width, "height": camera.height}
            for camera in cameras
        ],
        "versions": {"gsc_jax": "0.1.0"},
    }
    (folder / "result.json").write_text(json.dumps(report), encoding="utf-8")
    return cameras


def rewrite_report(folder: Path, **changes: object) -> None:
    """Replace entries of result.json, or remove those that are None."""
    path = folder / "result.json"
    report = json.loads(path.read_text(encoding="utf-8")) | changes
    kept = {key: value for key, value in report.items() if value is not None}
    path.write_text(json.dumps(kept), encoding="utf-8")
