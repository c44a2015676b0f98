"""COLMAP models, binary or text, are read with their full intrinsics."""

import struct
import time

import numpy as np
import pytest
from camera_files import assert_same, random_camera, write_colmap

from gsc_jax.io.cameras import load_cameras
from gsc_jax.io.colmap import MODEL_FILES
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


def test_points_are_not_needed_but_cameras_and_images_are(tmp_path):
    for text in (False, True):
        folder = write_colmap(tmp_path / f"m{text}", [random_camera()], text=text)
        suffix = "txt" if text else "bin"
        (folder / f"points3D.{suffix}").unlink()
        assert_same(load_cameras(folder)[0], random_camera())
        (folder / f"images.{suffix}").unlink()
        with pytest.raises(InputError, match="expected cameras and images") as error:
            load_cameras(folder)
        assert str(error.value).startswith(str(folder))
        assert "\n" not in str(error.value)


COUNT = {"cameras.bin": 0, "images.bin": 0, "points": 8 + 4 + 56 + 4 + len(b"a/b.c.png\0")}
"""Where the numbers of cameras, images, and points of the first image are."""


@pytest.mark.parametrize("count", [2, 10**9, 2**63, 2**64 - 1])
@pytest.mark.parametrize("place", COUNT)
def test_a_wrong_count_is_refused_at_once(tmp_path, place, count):
    """COLMAP's own library took 25 s for a model of 600 bytes."""
    folder = write_colmap(tmp_path / "m", [random_camera()])
    file = folder / (place if place in MODEL_FILES else "images.bin")
    content = bytearray(file.read_bytes())
    struct.pack_into("<Q", content, COUNT[place], count)
    file.write_bytes(content)
    began = time.perf_counter()
    with pytest.raises(InputError, match="missing or damaged"):
        load_cameras(folder)
    assert time.perf_counter() - began < 1


@pytest.mark.parametrize(
    ("cameras", "images", "problem"),
    [
        ("1 PINHOLE 64 40 50 50 32 20", "1 1 0 0 0 0 0 0 2 a.png\n", "has no camera"),
        ("1 PINHOLE 64 40 50 50 32", "1 1 0 0 0 0 0 0 1 a.png\n", "with 3 parameters"),
        ("1 PINHOLE 64 40 1e300 50 32 20", "1 1 0 0 0 0 0 0 1 a.png\n", "not finite"),
        ("1 PINHOLE 0 40 50 50 32 20", "1 1 0 0 0 0 0 0 1 a.png\n", "0 x 40 pixels"),
        ("1 PINHOLE 64 40 50 50 32 20", "1 0 0 0 0 0 0 0 1 a.png\n", "quaternion of its pose is 0"),
        ("1 PINHOLE 64 40 50 50 32 20", "1 1 0 0 0 nan 0 0 1 a.png\n", "not finite"),
        ("1 PINHOLE 64 40 50 50 32 20", "1 1 0 0 0 0\n", "numbers of a pose"),
    ],
)
def test_damaged_texts_are_refused(tmp_path, cameras, images, problem):
    (tmp_path / "cameras.txt").write_text(cameras)
    (tmp_path / "images.txt").write_text(images)
    with pytest.raises(InputError, match=problem) as error:
        load_cameras(tmp_path)
    assert str(error.value).startswith(str(tmp_path))


def test_a_line_of_points_may_be_empty_and_a_name_may_hold_spaces(tmp_path):
    (tmp_path / "cameras.txt").write_text("# x\n3 SIMPLE_PINHOLE 64 40 50 32 20\n")
    pose = "2 0 0 0 1 2 3 3"
    (tmp_path / "images.txt").write_text(f"# x\n1 {pose} b c.png\n\n2 {pose} a.png\n1 2 -1\n")
    first, second = load_cameras(tmp_path)
    assert (first.name, second.name) == ("a.png", "b c.png")
    np.testing.assert_allclose(first.viewmat[:3], np.eye(3, 4) + [[0, 0, 0, i] for i in (1, 2, 3)])
    np.testing.assert_array_equal(first.K, [[50, 0, 32], [0, 50, 20], [0, 0, 1]])


@pytest.mark.parametrize("points", ["", "\n", "1.5 2 -1 3 4 17\n", "\n\n"])
@pytest.mark.parametrize("suffix", ["", ".png", " with two spaces.png", " and one.png"])
def test_lines_of_points_may_be_left_out(tmp_path, points, suffix):
    (tmp_path / "cameras.txt").write_text("3 SIMPLE_PINHOLE 64 40 50 32 20\n", "utf-8-sig")
    names = [f"{letter}{suffix}" for letter in "abc"]
    lines = [f"{k} 1 0 0 0 1 2 3 3 {name}\n" for k, name in enumerate(names)]
    (tmp_path / "images.txt").write_text(points.join([*lines, ""]), "utf-8-sig")
    assert [camera.name for camera in load_cameras(tmp_path)] == names


@pytest.mark.parametrize(
    ("model", "focal", "coefficients"),
    [("SIMPLE_RADIAL", "50", 1), ("RADIAL", "50", 2), ("OPENCV", "50 60", 4)],
)
def test_a_model_without_distortion_is_a_pinhole(tmp_path, model, focal, coefficients):
    (tmp_path / "images.txt").write_text("1 1 0 0 0 1 2 3 3 a.png\n")
    distortion = np.zeros(coefficients)

    def cameras():
        values = " ".join(map(str, distortion))
        (tmp_path / "cameras.txt").write_text(f"3 {model} 64 40 {focal} 32 20 {values}\n")
        return load_cameras(tmp_path)

    (camera,) = cameras()
    lengths = [float(length) for length in focal.split()]
    np.testing.assert_array_equal(np.diag(camera.K), [lengths[0], lengths[-1], 1])
    np.testing.assert_array_equal(camera.K[:2, 2], [32, 20])
    for place in range(coefficients):
        for value in (0.1, np.nan):
            distortion[:] = 0
            distortion[place] = value
            with pytest.raises(
                InputError, match=f"has a {model} camera with distortion.*undistort"
            ):
                cameras()


def test_other_models_are_refused_also_without_distortion(tmp_path):
    (tmp_path / "images.txt").write_text("1 1 0 0 0 1 2 3 3 a.png\n")
    (tmp_path / "cameras.txt").write_text("3 OPENCV_FISHEYE 64 40 50 50 32 20 0 0 0 0\n")
    with pytest.raises(InputError, match=r"has a OPENCV_FISHEYE camera, expected.*undistort"):
        load_cameras(tmp_path)


def test_models_beyond_the_memory_are_refused(tmp_path):
    folder = write_colmap(tmp_path / "m", [random_camera()])
    with pytest.raises(InputError, match="of memory"):
        load_cameras(folder, max_bytes=100)
