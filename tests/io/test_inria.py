"""Items of a cameras.json are rigid camera-to-world poses with OpenCV axes."""

import numpy as np
import pytest
from camera_files import assert_same, camera_to_world, inria_item, random_camera, write_json

from gsc_jax.io.cameras import load_cameras
from gsc_jax.scene import InputError

ITEM = inria_item(random_camera())
ROTATION = np.array(ITEM["rotation"])


def test_poses_are_camera_to_world_and_the_principal_point_is_the_centre(tmp_path):
    expected = random_camera(centered=True)
    path = write_json(tmp_path / "cameras.json", [inria_item(expected)])
    assert_same(load_cameras(path)[0], expected)
    ahead = np.asarray(expected.center) + 2 * camera_to_world(expected)[:3, 2]
    image = np.asarray(expected.K) @ (np.asarray(expected.viewmat) @ [*ahead, 1])[:3]
    np.testing.assert_allclose(image, [640, 400, 2], rtol=1e-4)  # depth 2, centre of the image


@pytest.mark.parametrize(
    ("item", "field"),
    [
        (3, "found 3"),
        ({"width": 640}, "img_name"),
        ({"img_name": "a"}, "width"),
        (ITEM | {"rotation": [1, 2]}, "rotation"),
        (ITEM | {"rotation": ITEM["rotation"][:2]}, "rotation"),
        (ITEM | {"position": [1, "x", 2]}, r"position\[1\]"),
        (ITEM | {"position": [1, float("nan"), 2]}, r"position\[1\]"),
        (ITEM | {"fx": None}, "fx"),
        (ITEM | {"fx": -1}, "fx"),
        (ITEM | {"width": 0}, "width"),
        (ITEM | {"height": 99.5}, "height"),
    ],
)
def test_invalid_items_are_named(tmp_path, item, field):
    path = write_json(tmp_path / "cameras.json", [ITEM | {"img_name": "first"}, item])
    with pytest.raises(InputError, match=field) as error:
        load_cameras(path)
    assert str(error.value).startswith(f"{path}: camera 1")
    assert "\n" not in str(error.value)


@pytest.mark.parametrize(
    ("rotation", "problem"),
    [
        (2 * ROTATION, "contains a scale of 2,"),
        (ROTATION * [1, 1, -1], "contains a reflection,"),
        (ROTATION * [1, 1, 1.5], "is skewed or scaled unevenly,"),
        (0 * ROTATION, "contains a scale of 0,"),
    ],
)
def test_poses_that_are_not_rigid_are_refused(tmp_path, rotation, problem):
    path = write_json(tmp_path / "cameras.json", [ITEM | {"rotation": rotation.tolist()}])
    with pytest.raises(InputError, match=rf"'a/b\.c\.png'.*{problem}"):
        load_cameras(path)


def test_rounded_rotations_are_accepted(tmp_path):
    item = ITEM | {"rotation": np.round(ROTATION, 3).tolist()}
    assert len(load_cameras(write_json(tmp_path / "cameras.json", [item]))) == 1
