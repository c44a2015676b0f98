"""One camera, in every convention, is read as the same camera; what is no pinhole is refused."""

import json
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gsc_jax.io.cameras import camera_files, load_cameras, save_cameras
from gsc_jax.scene import Camera, InputError

SCENES = Path(__file__).parents[2] / "../shared/data/scenes"
needs_scenes = pytest.mark.skipif(not SCENES.is_dir(), reason="needs the scenes of ../shared/data")


def rotation_of(quat: np.ndarray) -> np.ndarray:
    w, x, y, z = quat / np.linalg.norm(quat)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def random_camera(seed: int = 0, *, name: str = "a/b.c.png", centered: bool = False) -> Camera:
    rng = np.random.default_rng(seed)
    viewmat = np.eye(4, dtype=np.float32)
    viewmat[:3, :3] = rotation_of(rng.standard_normal(4))
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


def inria_entry(camera: Camera) -> dict:
    pose, K = camera_to_world(camera), np.asarray(camera.K, np.float64)
    return {
        "id": 0,
        "img_name": camera.name,
        "width": camera.width,
        "height": camera.height,
        "position": pose[:3, 3].tolist(),
        "rotation": pose[:3, :3].tolist(),
        "fx": K[0, 0],
        "fy": K[1, 1],
    }


def opengl_frame(camera: Camera) -> dict:
    """By axes instead of by signs: right stays, up is minus down, backward is minus forward."""
    right, down, forward, position = camera_to_world(camera)[:3].T
    matrix = np.eye(4)
    matrix[:3] = np.column_stack([right, -down, -forward, position])
    return {"file_path": f"./{camera.name}", "transform_matrix": matrix.tolist()}


def intrinsics(camera: Camera) -> dict:
    K = np.asarray(camera.K, np.float64)
    names = {"fl_x": K[0, 0], "fl_y": K[1, 1], "cx": K[0, 2], "cy": K[1, 2]}
    return names | {"w": camera.width, "h": camera.height}


def write(path: Path, data: object) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(data))
    return path


def write_colmap(
    folder: Path, cameras: list[Camera], *, model: str = "PINHOLE", text=False
) -> Path:
    pycolmap = pytest.importorskip("pycolmap")
    reconstruction = pycolmap.Reconstruction()
    for index, camera in enumerate(cameras, start=1):
        K = np.asarray(camera.K, np.float64)
        params = {
            "PINHOLE": [K[0, 0], K[1, 1], K[0, 2], K[1, 2]],
            "SIMPLE_PINHOLE": [K[0, 0], K[0, 2], K[1, 2]],
            "OPENCV": [K[0, 0], K[1, 1], K[0, 2], K[1, 2], 0.1, 0, 0, 0],
        }
        reconstruction.add_camera_with_trivial_rig(
            pycolmap.Camera(
                model=model, width=640, height=400, params=params[model], camera_id=index
            )
        )
        reconstruction.add_image_with_trivial_frame(
            pycolmap.Image(name=camera.name, camera_id=index, image_id=index),
            pycolmap.Rigid3d(np.asarray(camera.viewmat, np.float64)[:3]),
        )
    folder.mkdir(parents=True)
    (reconstruction.write_text if text else reconstruction.write_binary)(folder)
    return folder


@settings(deadline=None, max_examples=20)
@given(seed=st.integers(0, 10_000), centered=st.booleans())
def test_saving_and_loading_is_the_identity(tmp_path_factory, seed, centered):
    path = tmp_path_factory.mktemp("save") / "cameras.json"
    expected = [random_camera(seed + i, name=f"{i}.x", centered=centered) for i in range(3)]
    save_cameras(path, expected)
    assert ("cx" in json.loads(path.read_text())[0]) is not centered
    for actual, camera in zip(load_cameras(path), expected, strict=True):
        assert_same(actual, camera)


def test_inria_cameras_are_camera_to_world_with_a_centred_principal_point(tmp_path):
    expected = random_camera(centered=True)
    path = write(tmp_path / "cameras.json", [inria_entry(expected)])
    assert_same(load_cameras(path)[0], expected)
    point = np.asarray(expected.center) + 2 * camera_to_world(expected)[:3, 2]
    seen = np.asarray(expected.K) @ (np.asarray(expected.viewmat) @ [*point, 1])[:3]
    np.testing.assert_allclose(seen, [640, 400, 2], rtol=1e-4)  # 2 ahead: the middle of the image


@pytest.mark.parametrize("per_frame", [False, True])
def test_transforms_have_opengl_axes(tmp_path, per_frame):
    expected = random_camera()
    frame, shared = opengl_frame(expected), intrinsics(expected)
    wrong = {"fl_x": 1.0, "w": 3, "k1": 0.0}
    data = {**wrong, "frames": [frame | shared]} if per_frame else {**shared, "frames": [frame]}
    assert_same(load_cameras(write(tmp_path / "transforms.json", data))[0], expected)


def test_transforms_of_blender_scenes_ask_the_image_for_its_size(tmp_path):
    import imageio.v3 as iio

    expected = random_camera(name="train/r_0", centered=True)
    (tmp_path / "train").mkdir()
    iio.imwrite(tmp_path / "train/r_0.png", np.zeros((400, 640, 3), np.uint8))
    angle = 2 * np.arctan(320 / 500)
    data = {"camera_angle_x": angle, "frames": [opengl_frame(expected)]}
    camera = load_cameras(write(tmp_path / "transforms_train.json", data).parent)[0]
    np.testing.assert_allclose(camera.K, [[500, 0, 320], [0, 500, 200], [0, 0, 1]], rtol=1e-6)
    assert (camera.width, camera.height, camera.name) == (640, 400, "train/r_0")


def test_transforms_may_give_one_angle_per_axis_and_three_rows(tmp_path):
    expected = random_camera(centered=True)
    frame = opengl_frame(expected)
    frame["transform_matrix"] = frame["transform_matrix"][:3]
    K = np.asarray(expected.K, np.float64)
    data = {
        "camera_angle_x": 2 * np.arctan(320 / K[0, 0]),
        "camera_angle_y": 2 * np.arctan(200 / K[1, 1]),
        "w": 640.0,
        "h": 400.0,
        "camera_model": "OPENCV",
        "frames": [frame],
    }
    assert_same(load_cameras(write(tmp_path / "transforms.json", data))[0], expected)


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("place", ["sparse/0", "0", "sparse", "."])
def test_colmap_models_are_found_and_sorted_by_name(tmp_path, place, text):
    expected = [random_camera(seed, name=f"rig_{seed}/img.{9 - seed}.jpg") for seed in (2, 1, 3)]
    folder = write_colmap(tmp_path / "scene" / place, expected, text=text)
    for path in (tmp_path / "scene", folder, folder / f"cameras.{'txt' if text else 'bin'}"):
        cameras = load_cameras(path)
        assert [camera.name for camera in cameras] == sorted(c.name for c in expected)
        for actual, camera in zip(cameras, sorted(expected, key=lambda c: c.name), strict=True):
            assert_same(actual, camera)


def test_colmap_simple_pinhole_has_one_focal_length(tmp_path):
    camera = random_camera()
    actual = load_cameras(write_colmap(tmp_path / "m", [camera], model="SIMPLE_PINHOLE"))[0]
    K = np.asarray(camera.K)
    np.testing.assert_allclose(np.diag(actual.K), [K[0, 0], K[0, 0], 1])
    np.testing.assert_allclose(np.asarray(actual.K)[:2, 2], K[:2, 2])


def test_distorted_colmap_cameras_are_refused(tmp_path):
    folder = write_colmap(tmp_path / "m", [random_camera()], model="OPENCV")
    with pytest.raises(InputError, match=r"'a/b\.c\.png' has a OPENCV camera.*undistort"):
        load_cameras(folder)


def test_incomplete_colmap_models_and_a_missing_pycolmap(tmp_path, monkeypatch):
    folder = write_colmap(tmp_path / "m", [random_camera()])
    (folder / "points3D.bin").unlink()
    with pytest.raises(InputError, match="expected cameras, images and points3D") as error:
        load_cameras(folder)
    assert "\n" not in str(error.value)
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    with pytest.raises(InputError, match=r"pip install 'gsc_jax\[colmap\]'"):
        load_cameras(folder)


def test_the_files_that_cameras_are_read_from(tmp_path):
    model = tmp_path / "sparse" / "0"
    model.mkdir(parents=True)
    for name in ("cameras.bin", "images.bin", "points3D.bin"):
        (model / name).touch()
    assert camera_files(tmp_path) == [model / "cameras.bin", model / "images.bin"]
    save_cameras(tmp_path / "cameras.json", [random_camera()])
    for path in (tmp_path, tmp_path / "cameras.json"):
        assert camera_files(path) == [tmp_path / "cameras.json"]
    with pytest.raises(InputError, match="no such file or folder"):
        camera_files(tmp_path / "missing")


def test_in_a_folder_cameras_json_is_preferred_and_others_must_be_alone(tmp_path):
    camera = random_camera()
    write(tmp_path / "transforms.json", intrinsics(camera) | {"frames": [opengl_frame(camera)]})
    assert len(load_cameras(tmp_path)) == 1
    write_colmap(tmp_path / "sparse/0", [camera, random_camera(1, name="b")])
    with pytest.raises(InputError, match=r"several sets of cameras \(.*transforms\.json, .*0\)"):
        load_cameras(tmp_path)
    save_cameras(tmp_path / "cameras.json", [random_camera(i, name=str(i)) for i in range(3)])
    assert len(load_cameras(tmp_path)) == 3


POSE = camera_to_world(random_camera())[:3, :3]


@pytest.mark.parametrize(
    ("rotation", "message"),
    [
        (2 * POSE, "contains a scale of 2,"),
        (POSE * [1, 1, -1], "contains a reflection,"),
        (POSE * [1, 1, 1.5], "is skewed or scaled unevenly,"),
        (0 * POSE, "contains a scale of 0,"),
    ],
)
def test_poses_that_are_not_rigid_are_refused(tmp_path, rotation, message):
    camera = random_camera()
    entry = inria_entry(camera) | {"rotation": rotation.tolist()}
    frame = opengl_frame(camera)
    matrix = np.array(frame["transform_matrix"])
    matrix[:3, :3] = rotation * [1, -1, -1]
    frame["transform_matrix"] = matrix.tolist()
    transforms = intrinsics(camera) | {"frames": [frame]}
    for name, data in {"cameras.json": [entry], "transforms.json": transforms}.items():
        with pytest.raises(InputError, match=message) as error:
            load_cameras(write(tmp_path / name, data))
        assert "a/b.c.png" in str(error.value)


def test_rounded_rotations_are_accepted(tmp_path):
    entry = inria_entry(random_camera()) | {"rotation": np.round(POSE, 3).tolist()}
    assert len(load_cameras(write(tmp_path / "cameras.json", [entry]))) == 1


ENTRY, FRAME, SHARED = (make(random_camera()) for make in (inria_entry, opengl_frame, intrinsics))


def lacking(entry: dict, key: str) -> dict:
    return {name: value for name, value in entry.items() if name != key}


@pytest.mark.parametrize(
    ("data", "message"),
    [
        ([], "holds no cameras"),
        ({"a": 1}, "neither a cameras.json"),
        (3, "neither a cameras.json"),
        ([3], "camera 0: lacks 'img_name'"),
        ([lacking(ENTRY, "img_name")], "camera 0: lacks 'img_name'"),
        ([lacking(ENTRY, "position")], "lacks 'position'"),
        ([ENTRY | {"rotation": [1, 2]}], r"'rotation' is not finite numbers of shape \(3, 3\)"),
        ([ENTRY | {"position": [1, "x", 2]}], "'position' is not finite numbers"),
        ([ENTRY | {"position": [1, float("nan"), 2]}], "'position' is not finite numbers"),
        ([ENTRY | {"fx": None}], "'fx' is not a finite number"),
        ([ENTRY | {"fx": -1}], "positive focal lengths"),
        ([ENTRY | {"width": 0}], "image size"),
        ([ENTRY | {"height": 99.5}], "image size"),
        ([ENTRY, ENTRY], r"cameras 0 and 1 are both called 'a/b\.c\.png'"),
        (SHARED | {"frames": 1}, "no list of frames"),
        (SHARED | {"frames": []}, "holds no cameras"),
        (SHARED | {"frames": [3]}, "frame 0: lacks 'file_path'"),
        (SHARED | {"frames": [lacking(FRAME, "transform_matrix")]}, "lacks 'transform_matrix'"),
        (SHARED | {"frames": [FRAME | {"transform_matrix": [[1]]}]}, r"shape \(4, 4\)"),
        (SHARED | {"frames": [FRAME], "k1": 0.1}, r"distorted \(k1\).*undistort"),
        (SHARED | {"frames": [FRAME | {"p2": 1e-3}]}, r"distorted \(p2\)"),
        (SHARED | {"frames": [FRAME], "camera_model": "OPENCV_FISHEYE"}, "OPENCV_FISHEYE"),
        (SHARED | {"frames": [FRAME], "is_fisheye": True}, "fisheye"),
        (lacking(SHARED, "w") | {"frames": [FRAME]}, "lacks 'w' and 'h', and .* is no image"),
        (lacking(SHARED, "cx") | {"frames": [FRAME]}, "lacks 'cx'"),
        ({"w": 2, "h": 2, "frames": [FRAME]}, "lacks 'fl_x' and 'camera_angle_x'"),
        ({"w": 2, "h": 2, "camera_angle_x": 60, "frames": [FRAME]}, "expected radians"),
    ],
)
def test_damaged_files_are_named(tmp_path, data, message):
    path = write(tmp_path / "cameras.json", data)
    with pytest.raises(InputError, match=message) as error:
        load_cameras(path)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)


def test_what_is_no_camera_file(tmp_path):
    (tmp_path / "broken.json").write_text("[{")
    (tmp_path / "scene.ply").write_text("ply")
    cases = {
        "none.json": "no such file or folder",
        "broken.json": "not valid JSON",
        "scene.ply": r"expected a cameras\.json",
        ".": "holds no cameras.json, transforms.json or COLMAP model",
    }
    for name, message in cases.items():
        with pytest.raises(InputError, match=message):
            load_cameras(tmp_path / name)


@needs_scenes
@pytest.mark.parametrize("name", ["kitchen", "playbot", "flowers"])
def test_real_cameras_come_back(tmp_path, name):
    cameras = load_cameras(SCENES / f"{name}.cameras.json")
    assert len(cameras) == 24
    save_cameras(tmp_path / "cameras.json", cameras)
    for actual, expected in zip(load_cameras(tmp_path), cameras, strict=True):
        np.testing.assert_allclose(actual.viewmat, expected.viewmat, atol=1e-5)
        np.testing.assert_array_equal(actual.K, expected.K)
        assert (actual.width, actual.height, actual.name) == (480, 360, expected.name)
