"""A random camera, and the same camera in each file format."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gsc_jax.scene import Camera


def random_camera(seed: int = 0, *, name: str = "a/b.c.png", centered: bool = False) -> Camera:
    rng = np.random.default_rng(seed)
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[:3, :3] = Rotation.from_quat(rng.standard_normal(4)).as_matrix()
    viewmat[:3, 3] = rng.standard_normal(3)
    fx, fy, cx, cy = rng.uniform([400, 400, 250, 150], [600, 600, 350, 250])
    cx, cy = (320, 200) if centered else (cx, cy)
    K = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]], np.float32)
    return Camera(viewmat=viewmat, K=K, width=640, height=400, name=name)


def assert_same(actual: Camera, expected: Camera) -> None:
    np.testing.assert_allclose(actual.viewmat, expected.viewmat, atol=2e-6)
    np.testing.assert_allclose(actual.K, expected.K, rtol=1e-6)
    assert np.asarray(actual.viewmat).dtype == np.asarray(actual.K).dtype == np.float32
    assert (actual.width, actual.height, actual.name) == (640, 400, expected.name)


def camera_to_world(camera: Camera) -> np.ndarray:
    return np.linalg.inv(np.asarray(camera.viewmat, np.float64))


def inria_item(camera: Camera) -> dict:
    pose, K = camera_to_world(camera), np.asarray(camera.K, np.float64)
    pose = {"position": pose[:3, 3].tolist(), "rotation": pose[:3, :3].tolist()}
    size = {"width": camera.width, "height": camera.height}
    return {"id": 0, "img_name": camera.name, "fx": K[0, 0], "fy": K[1, 1]} | size | pose


def opengl_frame(camera: Camera) -> dict:
    """Frame of a transforms.json, by axes: up is minus down, backward is minus forward."""
    right, down, forward, position = camera_to_world(camera)[:3].T
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([right, -down, -forward, position])
    return {"file_path": f"./{camera.name}", "transform_matrix": matrix.tolist()}


def opengl_intrinsics(camera: Camera) -> dict:
    K = np.asarray(camera.K, np.float64)
    names = {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
    return names | {"w": camera.width, "h": camera.height}


def write_json(path: Path, data: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(data))
    return path


def write_colmap(folder: Path, cameras: list[Camera], *, model="PINHOLE", text=False) -> Path:
    pycolmap = pytest.importorskip("pycolmap")
    reconstruction = pycolmap.Reconstruction()
    for index, camera in enumerate(cameras, start=1):
        K = np.asarray(camera.K, np.float64)
        params = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
        params += [0.1, 0, 0, 0] if model == "OPENCV" else []
        reconstruction.add_camera_with_trivial_rig(
            pycolmap.Camera(
                model=model,
                width=camera.width,
                height=camera.height,
                params=params,
                camera_id=index,
            )
        )
        reconstruction.add_image_with_trivial_frame(
            pycolmap.Image(name=camera.name, camera_id=index, image_id=index),
            pycolmap.Rigid3d(np.asarray(camera.viewmat, np.float64)[:3]),
        )
    folder.mkdir(parents=True)
    (reconstruction.write_text if text else reconstruction.write_binary)(folder)
    return folder
