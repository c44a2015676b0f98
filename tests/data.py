"""Real scenes that lie beside the repository; tests that need them carry `@needs_data`."""

import dataclasses
import functools
from pathlib import Path

import numpy as np
import pytest

from gsc_jax.io.cameras import load_cameras
from gsc_jax.io.ply import load_ply
from gsc_jax.scene import Camera, Gaussians

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
SCENES = ("kitchen", "playbot", "flowers")
TAMPERED = ("kitchen-incorporate", "playbot-remove")

needs_data = pytest.mark.skipif(
    not DATA.is_dir(), reason="the real scenes (../shared/data) are not beside the repository"
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class TamperedScene:
    """A tampered scene and its truth; `folder` holds detector/, truth/ and heldout_truth/."""

    folder: Path
    gaussians: Gaussians
    cameras: list[Camera]
    heldout_cameras: list[Camera]
    labels: np.ndarray


@functools.cache
def load_scene(name: str) -> tuple[Gaussians, list[Camera]]:
    """Load a scene of `SCENES` and its cameras."""
    folder = DATA / "scenes"
    return load_ply(folder / f"{name}.ply"), load_cameras(folder / f"{name}.cameras.json")


@functools.cache
def load_tampered(name: str) -> TamperedScene:
    """Load a scene of `TAMPERED`."""
    folder = DATA / "tampered" / name
    return TamperedScene(
        folder=folder,
        gaussians=load_ply(folder / "scene.ply"),
        cameras=load_cameras(folder / "cameras.json"),
        heldout_cameras=load_cameras(folder / "heldout_cameras.json"),
        labels=np.load(folder / "labels.npy"),
    )


def cropped(camera: Camera, left: int, top: int, width: int, height: int) -> Camera:
    """Camera of a window of the image: the principal point is shifted."""
    K = np.array(camera.K)
    K[:2, 2] -= [left, top]
    return dataclasses.replace(camera, K=K, width=width, height=height)
