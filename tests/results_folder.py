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


def ball_over_floor() -> tuple[Gaussians, np.ndarray]:
    """A red ball over a blue floor, and scores that identify the ball, by row of the file."""
    rng = np.random.default_rng(0)
    ball = np.arange(COUNT) % OBJECT == 0
    floor_means = rng.uniform(-1, 1, (COUNT, 3)) * [1, 0.02, 1] + [0, 0.4, 0]
    ball_means = rng.normal(size=(COUNT, 3))
    ball_means *= 0.3 / np.linalg.norm(ball_means, axis=1, keepdims=True)
    means = np.where(ball[:, None], ball_means, floor_means).astype(np.float32)
    means[list(BROKEN)] = np.nan
    gaussians = Gaussians(
        means=means,
        log_scales=np.full((COUNT, 3), np.log(0.04), np.float32),
        quats=rng.normal(size=(COUNT, 4)).astype(np.float32),
        logit_opacities=np.full(COUNT, 3, np.float32),
        sh=np.where(ball[:, None], RED, BLUE)[:, None].astype(np.float32),
    )
    scores = np.where(ball, rng.uniform(0.6, 1, COUNT), rng.uniform(0, 0.4, COUNT))
    scores[list(BROKEN)] = 0
    return gaussians, scores.astype(np.float32)


def write_results(folder: Path, *, views: int = 3) -> list[Camera]:
    """Write the folder.

    Args:
        folder: The folder, created if missing.
        views: Number of cameras.

    Returns:
        The cameras, at the size of their masks.
    """
    gaussians, scores = ball_over_floor()
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
