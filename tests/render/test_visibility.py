"""Cameras that do not belong to a scene are detected, with advice."""

import dataclasses

import numpy as np
import pytest
from data import SCENES, load_scene, needs_data
from strategies import ball, camera, random_scene

from gsc_jax.render.orbit import orbit_cameras
from gsc_jax.render.visibility import check_views, storage_warnings
from gsc_jax.scene import Camera, Gaussians, InputError

FLIP = np.diag([1.0, -1.0, -1.0, 1.0])


def converted(cameras: list[Camera], convert) -> list[Camera]:
    return [dataclasses.replace(camera, viewmat=convert(camera.viewmat)) for camera in cameras]


def last_message(scene: Gaussians, cameras: list[Camera]) -> str:
    """The error of the check, or its last warning."""
    try:
        return check_views(scene, cameras)[-1]
    except InputError as error:
        return str(error)


@pytest.mark.parametrize(
    ("convert", "convention"),
    [
        (lambda viewmat: FLIP @ viewmat, "with OpenGL axes (y up, z backward):"),
        (np.linalg.inv, "as world-to-camera:"),
        (lambda viewmat: np.linalg.inv(FLIP @ viewmat), "as world-to-camera with OpenGL axes:"),
    ],
)
def test_another_convention_is_recognised(convert, convention):
    scene = ball()
    message = last_message(scene, converted(orbit_cameras(scene, 8), convert))
    assert convention in message
    assert "\n" not in message


def test_a_normalised_scene_is_not_visible():
    cameras = orbit_cameras(ball(center=(200.0, 0.0, 0.0)), 5)
    with pytest.raises(InputError, match=r"0\.00%.*belong together"):
        check_views(ball(radius=0.1), cameras)


def test_the_near_plane_that_is_advised_for_a_small_scene_fits():
    scene = ball(radius=0.01)
    cameras = orbit_cameras(scene, 6)
    with pytest.raises(InputError, match=r"near plane.*100%") as error:
        check_views(scene, cameras)
    near = float(str(error.value).split("near=")[1].split()[0])
    assert check_views(scene, cameras, near=near) == []


def test_blind_cameras_a_low_share_and_a_far_near_plane_give_warnings():
    scene, cameras = ball(), orbit_cameras(ball(), 10)
    middle = float(np.linalg.norm(np.subtract(cameras[0].center, [1, -2, 5])))
    (warning,) = check_views(scene, cameras, near=middle + 0.5)
    assert "near plane" in warning
    K = cameras[0].K * np.array([[6, 1, 1], [1, 6, 1], [1, 1, 1]], np.float32)
    (warning,) = check_views(scene, [dataclasses.replace(cameras[0], K=K)])
    assert "see only" in warning
    cameras[3:5] = converted(cameras[3:5], lambda viewmat: FLIP @ viewmat)
    (warning,) = check_views(scene, cameras)
    assert warning.startswith("2 of 10")
    assert "orbit_003, orbit_004" in warning
    assert "belong together" not in warning


def test_many_blind_cameras_are_said_to_be_of_another_scene():
    """Some cameras stand in the small scene and see all of it, as with those of a larger one."""
    scene, cameras = ball(), orbit_cameras(ball(), 10)
    away = np.diag([1.0, 1, 1, 1])
    away[1, 3] = 1000.0
    cameras[:4] = converted(cameras[:4], lambda viewmat: away @ viewmat)
    (warning,) = check_views(scene, cameras)
    assert warning.startswith("4 of 10")
    assert "belong together" in warning


def test_many_cameras_of_which_each_sees_little_are_of_the_scene():
    """As those of a flight over a city."""
    places = np.stack(np.meshgrid(*[np.arange(20.0)] * 2), axis=-1).reshape(-1, 2)
    grid = np.random.default_rng(0).uniform(-0.5, 19.5, (20_000, 2))
    scene = dataclasses.replace(
        random_scene(len(grid)), means=np.column_stack([grid, 0 * grid[:, 0]]).astype(np.float32)
    )
    scene = dataclasses.replace(scene, logit_opacities=np.full(len(grid), 3.0, np.float32))
    template, cameras = camera(), []
    for x, y in places:
        viewmat = np.eye(4, dtype=np.float32)
        viewmat[:3, 3] = -x, -y, 1
        cameras.append(dataclasses.replace(template, viewmat=viewmat))
    assert not any("belong" in warning for warning in check_views(scene, cameras))


def test_cameras_at_another_scale_than_the_scene_give_a_warning():
    scene, cameras = ball(), orbit_cameras(ball(), 8)
    far = []
    for one in cameras:  # its centre at 100 times the distance from the ball
        viewmat = one.viewmat.copy()
        viewmat[2, 3] += 99 * np.linalg.norm(np.subtract(one.center, [1, -2, 5]))
        far.append(dataclasses.replace(one, viewmat=viewmat))
    (warning,) = check_views(scene, far)
    assert "is it at the cameras' scale?" in warning


@pytest.mark.parametrize("factor", [0.5, 2])
def test_intrinsics_of_another_image_size_give_a_warning(factor):
    scene, cameras = ball(), orbit_cameras(ball(), 8)
    other = [
        dataclasses.replace(c, width=round(factor * c.width), height=round(factor * c.height))
        for c in cameras
    ]
    (warning,) = check_views(scene, other)
    assert warning.startswith("100% of the principal points are far from the middle")
    assert not check_views(scene, [*other[:2], *cameras[2:]])  # some images may be cropped


def test_cameras_of_which_a_typical_one_sees_little_give_a_warning():
    """Unless some see nothing, as with poses that were misread."""
    scene, cameras = ball(), orbit_cameras(ball(), 10)
    close = cameras[0].K * np.array([[10, 1, 1], [1, 10, 1], [1, 1, 1]], np.float32)
    near = [dataclasses.replace(camera, K=close) for camera in cameras[:6]]
    (warning,) = check_views(scene, [*near, *cameras[6:]])
    assert "few masks can agree" in warning
    assert check_views(scene, [*near[:4], *cameras[4:]]) == []
    flipped = converted(cameras[:6], lambda viewmat: FLIP @ viewmat)
    assert not any("few masks" in text for text in check_views(scene, [*flipped, *cameras[6:]]))


def test_scales_that_are_not_logarithms_give_a_warning():
    scene = random_scene(400)
    cameras = orbit_cameras(scene, 4)
    assert not any("logarithm" in warning for warning in check_views(scene, cameras))
    linear = dataclasses.replace(scene, log_scales=np.exp(scene.log_scales))
    assert any("logarithm" in warning for warning in check_views(linear, cameras))


def test_positions_that_float32_rounds_give_a_warning():
    scene = random_scene(400)
    assert not storage_warnings(scene, np.asarray(scene.means))
    far = dataclasses.replace(scene, means=scene.means + np.float32(1e5))  # in steps of 1/128
    for size, rounded in ((0.034, False), (0.028, True), (0.0, False)):
        with np.errstate(divide="ignore"):
            sized = dataclasses.replace(far, log_scales=np.full((400, 3), np.log(np.float32(size))))
        warnings = storage_warnings(sized, np.asarray(sized.means))
        assert list(warnings) == ["rounded positions"] * rounded
        told = "positions 1e+05 from the origin are rounded to steps of 0.0078, while Gaussians"
        assert rounded == (told in str(warnings))


def test_no_cameras_and_no_gaussians_are_refused():
    with pytest.raises(InputError, match="no cameras"):
        check_views(ball(20), [])
    with pytest.raises(InputError, match="no Gaussians"):
        check_views(random_scene(0), [camera()])


@needs_data
@pytest.mark.parametrize("name", SCENES)
def test_real_cameras_and_orbits_see_real_scenes(name):
    scene, cameras = load_scene(name)
    assert check_views(scene, cameras) == []
    assert check_views(scene, orbit_cameras(scene, 12)) == []
    flipped = converted(cameras, lambda viewmat: FLIP @ viewmat)
    assert "OpenGL axes" in last_message(scene, flipped)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (
            {"logit_opacities": np.linspace(0, 1, 400, dtype=np.float32)},
            "are from 0 to 1:",
        ),
        ({"logit_opacities": np.arange(400, dtype=np.float32) % 256}, "are from 0 to 255:"),
        ({"logit_opacities": np.full(400, -20, np.float32)}, "no Gaussian can be seen"),
        ({"logit_opacities": np.full(400, -np.inf, np.float32)}, "no Gaussian can be seen"),
        ({"sh": np.full((400, 1, 3), 100, np.float32)}, "are they in 0 to 255?"),
    ],
)
def test_opacities_and_colours_in_other_units_give_a_warning(change, told):
    scene = random_scene(400)
    changed = dataclasses.replace(scene, **change)
    (warning,) = storage_warnings(changed, np.asarray(scene.means)).values()
    assert told in warning
    assert any(told in warning for warning in check_views(changed, orbit_cameras(scene, 4)))


@pytest.mark.parametrize("opaque", [40.0, np.inf, 5.54])
def test_a_scene_of_which_most_is_opaque_gives_no_warning(opaque):
    logits = np.where(np.arange(400) % 3, np.float32(opaque), np.linspace(0, 5, 400))
    scene = dataclasses.replace(random_scene(400), logit_opacities=logits.astype(np.float32))
    assert not storage_warnings(scene, np.asarray(scene.means))
