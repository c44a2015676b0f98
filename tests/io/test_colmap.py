"""COLMAP models, binary or text, are read with their full intrinsics."""

import sys

import pytest
from camera_files import assert_same, random_camera, write_colmap

from gsc_jax.io.cameras import load_cameras
from gsc_jax.scene import InputError


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("place", ["sparse/0", "0", "sparse", "."])
def test_models_are_found_and_sorted_by_name(tmp_path, place, text):
    expected = [random_camera(seed, name=f"rig_{seed}/img.{9 - seed}.jpg") for seed in (2, 1, 3)]
    folder = write_colmap(tmp_path / "scene" / place, expected, text=text)
    expected.sort(key=lambda camera: camera.name)
    for path in (tmp_path / "scene", folder, folder / f"cameras.{'txt' if text else 'bin'}"):
        for actual, camera in zip(load_cameras(path), expected, strict=True):
            assert_same(actual, camera)


def test_distorted_cameras_are_refused(tmp_path):
    folder = write_colmap(tmp_path / "m", [random_camera()], model="OPENCV")
    with pytest.raises(InputError, match=r"'a/b\.c\.png' has a OPENCV camera.*undistort"):
        load_cameras(folder)


def test_incomplete_models_and_a_missing_pycolmap(tmp_path, monkeypatch):
    folder = write_colmap(tmp_path / "m", [random_camera()])
    (folder / "points3D.bin").unlink()
    with pytest.raises(InputError, match="expected cameras, images and points3D") as error:
        load_cameras(folder)
    assert "\n" not in str(error.value)
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(InputError, match=r"pip install 'gsc_jax\[colmap\]'"):
        load_cameras(folder)
