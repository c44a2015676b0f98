"""The cameras of a path are unambiguous, and saved cameras are read back unchanged."""

import dataclasses
import json

import numpy as np
import pytest
from camera_files import assert_same, inria_item, random_camera, write_colmap, write_json
from data import DATA, SCENES, needs_data
from hypothesis import given, settings
from hypothesis import strategies as st

from gsc_jax.io.cameras import camera_files, load_cameras, save_cameras
from gsc_jax.scene import InputError
from gsc_jax.scene.camera import check_camera


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 10_000), centered=st.booleans())
def test_saving_and_loading_is_the_identity(tmp_path_factory, seed, centered):
    path = tmp_path_factory.mktemp("save") / "cameras.json"
    expected = [random_camera(seed + i, name=f"{i}.x", centered=centered) for i in range(3)]
    save_cameras(path, expected)
    assert ("cx" in json.loads(path.read_text())[0]) is not centered
    for actual, camera in zip(load_cameras(path), expected, strict=True):
        assert_same(actual, camera)


@needs_data
@pytest.mark.parametrize("name", SCENES)
def test_real_cameras_survive_saving(tmp_path, name):
    cameras = load_cameras(DATA / "scenes" / f"{name}.cameras.json")
    assert len(cameras) == 24
    save_cameras(tmp_path / "cameras.json", cameras)
    for actual, expected in zip(load_cameras(tmp_path), cameras, strict=True):
        np.testing.assert_allclose(actual.viewmat, expected.viewmat, atol=1e-5)
        np.testing.assert_array_equal(actual.K, expected.K)
        assert (actual.width, actual.height, actual.name) == (480, 360, expected.name)


def test_camera_files_lists_the_files_that_are_read(tmp_path):
    model = tmp_path / "sparse" / "0"
    model.mkdir(parents=True)
    for name in ("cameras.bin", "images.bin", "points3D.bin"):
        (model / name).touch()
    assert camera_files(tmp_path) == [model / "cameras.bin", model / "images.bin"]
    save_cameras(tmp_path / "cameras.json", [random_camera()])
    assert camera_files(tmp_path) == [tmp_path / "cameras.json"]


def test_cameras_json_takes_precedence_and_other_sets_exclude_each_other(tmp_path):
    write_json(tmp_path / "transforms.json", {"frames": []})
    write_colmap(tmp_path / "sparse/0", [random_camera()])
    with pytest.raises(InputError, match=r"several sets of cameras \(.*transforms\.json, .*0\)"):
        load_cameras(tmp_path)
    save_cameras(tmp_path / "cameras.json", [random_camera(i, name=str(i)) for i in range(3)])
    assert len(load_cameras(tmp_path)) == 3


def test_the_views_of_a_result_are_cameras(tmp_path):
    save_cameras(tmp_path / "views.json", [random_camera(i, name=str(i)) for i in range(2)])
    assert camera_files(tmp_path) == [tmp_path / "views.json"]
    assert len(load_cameras(tmp_path)) == 2


def test_duplicate_names_are_refused(tmp_path):
    write_json(tmp_path / "cameras.json", [inria_item(random_camera(i)) for i in range(2)])
    with pytest.raises(InputError, match=r"cameras\.json: cameras 0 and 1 .*'a/b\.c\.png'"):
        load_cameras(tmp_path)


@pytest.mark.parametrize(
    ("name", "content", "problem"),
    [
        ("none.json", None, "no such file or folder"),
        ("broken.json", "[{", "not valid JSON"),
        ("empty.json", "[]", "holds no cameras"),
        ("object.json", '{"a": 1}', "expected a cameras.json"),
        ("scene.ply", "ply", "expected a cameras.json"),
        (".", None, "no cameras.json, transforms.json or COLMAP model"),
    ],
)
def test_other_files_are_refused(tmp_path, name, content, problem):
    path = tmp_path / name
    if content:
        path.write_text(content)
    with pytest.raises(InputError, match=problem) as error:
        load_cameras(path)
    assert str(error.value).startswith(f"{path}: ")


def test_cameras_are_written_to_a_json_only(tmp_path):
    with pytest.raises(InputError, match=r"cameras\.txt: not written: .* from a \.json"):
        save_cameras(tmp_path / "cameras.txt", [random_camera()])
    assert not list(tmp_path.iterdir())


def changed(**changes) -> list:
    return [dataclasses.replace(random_camera(), **changes)]


@pytest.mark.parametrize(
    ("cameras", "problem"),
    [
        ([], "holds no cameras"),
        ([random_camera(0), random_camera(1)], "cameras 0 and 1"),
        (changed(viewmat=2 * np.eye(4, dtype=np.float32)), "contains a scale"),
        (changed(viewmat=np.zeros((4, 4), np.float32)), "Singular"),
        (changed(K=np.full((3, 3), np.nan, np.float32)), "fx: expected a finite number"),
        (changed(K=np.zeros((3, 3), np.float32)), "fx: "),
    ],
)
def test_cameras_that_could_not_be_read_again_are_not_written(tmp_path, cameras, problem):
    with pytest.raises(InputError, match=problem) as error:
        save_cameras(tmp_path / "cameras.json", cameras)
    assert str(error.value).startswith(f"{tmp_path / 'cameras.json'}: not written: ")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "change",
    [
        {"fx": 1e300},
        {"fx": 1e-300},
        {"cx": -1e200},
        {"position": [0, 1e39, 0]},
        {"rotation": [[1e200, 0, 0], [0, 1, 0], [0, 0, 1]]},
        {"width": 10**7},
        {"width": 10**400},
        {"width": float("inf")},
        {"width": True},
        {"fx": True},
        {"position": [0, True, 0]},
        {"img_name": "a\ud800"},
    ],
)
def test_numbers_beyond_float32_are_refused(tmp_path, change):
    path = write_json(tmp_path / "cameras.json", [inria_item(random_camera()) | change])
    with pytest.raises(InputError) as error:
        load_cameras(path)
    assert str(error.value).startswith(f"{path}: ")
    assert len(str(error.value)) < 400


def test_a_file_that_expands_beyond_the_memory_is_refused(tmp_path):
    items = [inria_item(random_camera(i, name=str(i))) for i in range(5)]
    path = write_json(tmp_path / "cameras.json", items)
    with pytest.raises(InputError, match="of memory"):
        load_cameras(path, max_bytes=10_000)


@pytest.mark.parametrize("focal", [0.01, 1e7])
def test_any_focal_length_and_the_skew_of_rounding_are_those_of_a_camera(focal):
    camera = random_camera()
    K = np.array([[focal, 5e-5 * focal, 960], [0, focal, 540], [0, 0, 1]], np.float32)
    check_camera(dataclasses.replace(camera, K=K))


def test_a_pose_that_cannot_be_inverted_is_refused():
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[1, :3] = 0
    with pytest.raises(InputError, match="invertible"):
        check_camera(dataclasses.replace(random_camera(), viewmat=viewmat))


@pytest.mark.parametrize(
    ("field", "at", "value", "message"),
    [
        ("viewmat", (3, 0), 1.0, "not transposed"),
        ("viewmat", (3, 3), 2.0, "not transposed"),
        ("viewmat", (slice(3), slice(3)), 0.0, "Singular"),
        ("K", (0, 1), 20.0, "without skew"),
        ("K", (2, 2), 2.0, "not transposed"),
        ("K", (0, 0), -30.0, "fx"),
    ],
)
def test_a_camera_that_would_be_another_one_is_not_written(tmp_path, field, at, value, message):
    camera = random_camera()
    matrix = np.array(getattr(camera, field))
    matrix[at] = value
    changed = dataclasses.replace(camera, **{field: matrix})
    with pytest.raises(InputError, match=message):
        save_cameras(tmp_path / "cameras.json", [changed])
    assert not (tmp_path / "cameras.json").exists()
