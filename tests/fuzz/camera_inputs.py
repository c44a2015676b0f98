"""Camera files with damage, and the checks of cameras that can be read all the same."""

import shutil
import struct
from pathlib import Path
from random import Random
from typing import Any

import numpy as np
from camera_files import inria_item, opengl_frame, opengl_intrinsics, random_camera
from fuzz.damage import damaged_utf8
from fuzz.harness import READER_BYTES
from fuzz.mutate import damaged_bytes

from gsc_jax.cli.scene_input import check_names
from gsc_jax.io.cameras import load_cameras, save_cameras
from gsc_jax.io.masks import image_path
from gsc_jax.io.validation import naming
from gsc_jax.scene import Camera


def cameras_tree() -> Any:
    return [inria_item(random_camera(i, name=f"left/{i}.png")) | {"cx": 300.5} for i in range(2)]


def transforms_tree() -> Any:
    first, second = (random_camera(i, name=f"{i}.png") for i in range(2))
    return opengl_intrinsics(first) | {"frames": [opengl_frame(first), opengl_frame(second)]}


def make_colmap(rng: Random | None, folder: Path, *, text: bool) -> Path:
    files = _colmap_text() if text else _colmap_binary()
    if rng is not None:
        name = rng.choice(list(files))
        damage = damaged_utf8 if text and rng.random() < 0.8 else damaged_bytes
        files = files | {name: damage(rng, files[name])}
    for name, data in files.items():
        (folder / name).write_bytes(data)
    return folder


def _colmap_binary() -> dict[str, bytes]:
    cameras, images = struct.pack("<Q", 2), struct.pack("<Q", 2)
    for i in (1, 2):
        cameras += struct.pack("<iiQQ4d", i, 1, 640, 400, 500, 500, 320, 200)
        images += struct.pack("<i7di", i, 0.5, 0.5, -0.5, 0.5, 1, 2, 3, i)
        images += f"left/{i}.png\0".encode() + struct.pack("<Q2dq", 1, 3.0, 4.0, -1)
    return {"cameras.bin": cameras, "images.bin": images}


def _colmap_text() -> dict[str, bytes]:
    cameras = "# comment\n1 PINHOLE 640 400 500 500 320 200\n2 SIMPLE_PINHOLE 640 400 500 320 200\n"
    images = (
        "# comment\n1 .5 .5 -.5 .5 1 2 3 1 left/1.png\n3.0 4.0 -1\n2 1 0 0 0 1 2 3 2 b c.png\n\n"
    )
    return {"cameras.txt": cameras.encode(), "images.txt": images.encode()}


def check_cameras(path: Path) -> None:
    """Read cameras, and require that writing and reading them again changes nothing.

    Their names must be possible names of mask files.
    """
    cameras = load_cameras(path, max_bytes=READER_BYTES)
    check_camera_numbers(cameras)
    with naming(path):
        check_names(cameras)
    for camera in cameras:
        place = image_path(path.parent / "masks", camera.name)
        place.parent.mkdir(parents=True, exist_ok=True)
        for suffix in (".png", ".jpg"):
            place.with_suffix(suffix).touch()
    shutil.rmtree(path.parent / "masks")
    save_cameras(path.parent / "written.json", cameras)
    again = load_cameras(path.parent / "written.json")
    assert [camera.name for camera in again] == [camera.name for camera in cameras]
    for one, other in zip(again, cameras, strict=True):
        np.testing.assert_allclose(one.K, other.K, rtol=1e-6)


def check_camera_numbers(cameras: list[Camera]) -> None:
    assert len({camera.name for camera in cameras}) == len(cameras) > 0
    for camera in cameras:
        viewmat, K = np.asarray(camera.viewmat), np.asarray(camera.K)
        assert viewmat.dtype == K.dtype == np.float32
        assert np.isfinite(viewmat).all()
        assert np.isfinite(K).all()
        assert min(K[0, 0], K[1, 1], camera.width, camera.height) > 0
        np.testing.assert_allclose(viewmat[:3, :3] @ viewmat[:3, :3].T, np.eye(3), atol=0.02)
