"""Frames of a transforms.json are camera-to-world poses with OpenGL axes."""

import numpy as np
import pytest
from camera_files import assert_same, opengl_frame, opengl_intrinsics, random_camera, write_json
from PIL import Image

from gsc_jax.io.cameras import load_cameras
from gsc_jax.io.masks import write_image
from gsc_jax.scene import InputError

TRANSPOSED = np.transpose(opengl_frame(random_camera())["transform_matrix"]).tolist()
SIZE, MIRROR = {"w": 2, "h": 2}, np.diag([-1, 1, 1, 1]).tolist()
FRAME, SHARED = opengl_frame(random_camera()), opengl_intrinsics(random_camera())


@pytest.mark.parametrize("per_frame", [False, True])
def test_intrinsics_are_shared_or_per_frame(tmp_path, per_frame):
    overruled = {"fl_x": 1.0, "w": 3, "k1": 0.0}
    shared = overruled if per_frame else SHARED
    data = {**shared, "frames": [FRAME | SHARED if per_frame else FRAME]}
    path = write_json(tmp_path / "transforms.json", data)
    assert_same(load_cameras(path)[0], random_camera())


def test_the_size_is_read_from_the_image_if_missing(tmp_path):
    expected = random_camera(name="train/r_0", centered=True)
    (tmp_path / "train").mkdir()
    Image.new("RGB", (640, 400)).save(tmp_path / "train/r_0.png")
    angle = 2 * np.arctan(320 / 500)
    data = {"camera_angle_x": angle, "frames": [opengl_frame(expected)]}
    camera = load_cameras(write_json(tmp_path / "transforms_train.json", data).parent)[0]
    np.testing.assert_allclose(camera.K, [[500, 0, 320], [0, 500, 200], [0, 0, 1]], rtol=1e-6)
    assert (camera.width, camera.height, camera.name) == (640, 400, "train/r_0")


def test_angles_per_axis_and_matrices_of_three_rows_are_accepted(tmp_path):
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
    assert_same(load_cameras(write_json(tmp_path / "transforms.json", data))[0], expected)


@pytest.mark.parametrize("own", ["fl_x", "camera_angle_x"])
def test_a_focal_length_or_angle_of_a_frame_excludes_those_of_all(tmp_path, own):
    focal, size = 300.0, {"w": 640, "h": 400}
    value = focal if own == "fl_x" else 2 * np.arctan(320 / focal)
    shared = {"fl_x": 500.0, "fl_y": 500.0, "camera_angle_x": 1.0, "camera_angle_y": 1.0}
    frames = [FRAME | {own: value}, FRAME | {"file_path": "other.png"}]
    path = write_json(tmp_path / "transforms.json", {**shared, **size, "frames": frames})
    for camera, expected in zip(load_cameras(path), (focal, 500.0), strict=True):
        np.testing.assert_allclose(np.diag(camera.K)[:2], expected, rtol=1e-6)


def test_a_focal_length_along_y_excludes_that_of_all_and_null_excludes_nothing(tmp_path):
    shared = {"w": 640, "h": 400, "fl_x": 500.0, "camera_angle_y": 1.0, "k1": 0.0}
    frame = FRAME | {"fl_y": 400.0, "camera_angle_x": None, "k1": None}
    path = write_json(tmp_path / "transforms.json", {**shared, "frames": [frame]})
    np.testing.assert_allclose(np.diag(load_cameras(path)[0].K), [500, 400, 1], rtol=1e-6)
    data = {**shared, "k1": 0.1, "frames": [frame]}
    with pytest.raises(InputError, match=r"distorted \(k1\)"):
        load_cameras(write_json(tmp_path / "distorted.json", data))


def test_a_last_row_may_be_rounded(tmp_path):
    matrix = np.array(FRAME["transform_matrix"], np.float64)
    matrix[3] += (1e-6, -1e-6, 0, 2e-5)
    data = SHARED | {"frames": [FRAME | {"transform_matrix": matrix.tolist()}]}
    assert_same(load_cameras(write_json(tmp_path / "transforms.json", data))[0], random_camera())


def test_coefficients_of_zero_are_no_distortion(tmp_path):
    plain = {"distortion_params": [0.0] * 6, "skew": 0, "p1": None, "camera_model": None}
    path = write_json(tmp_path / "transforms.json", SHARED | plain | {"frames": [FRAME]})
    assert_same(load_cameras(path)[0], random_camera())


@pytest.mark.parametrize(
    "name", ["./a/b.png", "../a/b.png", "../../a/b.png", "/a/b.png", r"C:\a/b.png", r".\a/b.png"]
)
def test_a_camera_is_named_by_its_path_without_leading_dots(tmp_path, name):
    data = SHARED | {"frames": [FRAME | {"file_path": name}]}
    (camera,) = load_cameras(write_json(tmp_path / "transforms.json", data))
    assert camera.name == "a/b.png"


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (SHARED | {"frames": 1}, "no list of frames"),
        (SHARED | {"frames": []}, "holds no cameras"),
        (SHARED | {"frames": [3]}, "frame 0: "),
        (SHARED | {"frames": [{}]}, "frame 0: .*file_path"),
        (SHARED | {"frames": [{"file_path": "a"}]}, r"frame 0 \('a'\): .*transform_matrix"),
        (SHARED | {"frames": [FRAME | {"transform_matrix": [[1]]}]}, "transform_matrix"),
        (SHARED | {"frames": [FRAME], "k1": 0.1}, r"distorted \(k1\).*undistort"),
        (SHARED | {"frames": [FRAME | {"p2": 1e-3}]}, r"distorted \(p2\)"),
        (SHARED | {"frames": [FRAME], "distortion_params": [0.0, 0.1]}, r"\(distortion_params\)"),
        (SHARED | {"frames": [FRAME | {"skew": 2.0}]}, r"distorted \(skew\)"),
        (SHARED | {"frames": [FRAME], "camera_model": "OPENCV_FISHEYE"}, "OPENCV_FISHEYE"),
        (SHARED | {"frames": [FRAME], "is_fisheye": True}, "fisheye"),
        ({"fl_x": 1, "frames": [FRAME]}, "lacks 'w' and 'h'"),
        (SIZE | {"frames": [FRAME]}, "lacks 'fl_x' and 'camera_angle_x'"),
        (SIZE | {"camera_angle_x": 60, "frames": [FRAME]}, "camera_angle_x: .* found 60"),
        (SHARED | {"frames": [FRAME | {"transform_matrix": MIRROR}]}, "contains a reflection"),
        (SHARED | {"frames": [FRAME | {"transform_matrix": TRANSPOSED}]}, "last row .* transposed"),
    ],
)
def test_invalid_frames_are_named(tmp_path, data, problem):
    path = write_json(tmp_path / "transforms.json", data)
    with pytest.raises(InputError, match=problem) as error:
        load_cameras(path)
    assert str(error.value).startswith(f"{path}: ")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("name", ["/", "..", "", "a\0b", "x" * 5000])
def test_paths_that_cannot_be_images_are_refused(tmp_path, name):
    frame = {"file_path": name, "transform_matrix": np.eye(4).tolist()}
    path = write_json(tmp_path / "transforms.json", {"fl_x": 100.0, "frames": [frame]})
    with pytest.raises(InputError, match="lacks 'w' and 'h'") as error:
        load_cameras(path)
    assert str(error.value).startswith(f"{path}: frame 0")


def test_images_outside_of_the_folder_are_not_opened(tmp_path):
    inside, outside = tmp_path / "cameras" / "images", tmp_path / "elsewhere"
    for folder in (inside, outside):
        write_image(folder / "a.png", np.zeros((6, 8, 3)))
    (inside / "link.png").symlink_to(outside / "a.png")
    names = {"images/a": True, "../elsewhere/a": False, str(outside / "a"): False}
    for name, opened in {**names, "images/link.png": False}.items():
        frame = {"file_path": name, "transform_matrix": np.eye(4).tolist()}
        path = write_json(inside.parent / "transforms.json", {"fl_x": 9.0, "frames": [frame]})
        if opened:
            assert (load_cameras(path)[0].width, load_cameras(path)[0].height) == (8, 6)
        else:
            with pytest.raises(InputError, match="not an image inside"):
                load_cameras(path)
