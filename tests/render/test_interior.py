"""Cameras of an orbit that look at a wall from behind move into the room."""

import numpy as np
import pytest
from strategies import ball

from gsc_jax.benchmark.scenes import concatenate, make_object, make_room
from gsc_jax.render.interior import moved_indoors, surface_finder
from gsc_jax.render.orbit import DEFAULT_UP, orbit_cameras
from gsc_jax.scene import Gaussians
from gsc_jax.splat import render

ROOM = make_room(count=20_000)


def wall(distance: float, opacity: float) -> Gaussians:
    """A Gaussian that is wide in x and y and thin in z."""
    return Gaussians(
        means=np.array([[0, 0, distance]], np.float32),
        log_scales=np.log(np.array([[5, 5, 0.01]], np.float32)),
        quats=np.array([[1, 0, 0, 0]], np.float32),
        logit_opacities=np.log(np.array([opacity / (1 - opacity)], np.float32)),
        sh=np.zeros((1, 1, 3), np.float32),
    )


def test_a_surface_is_where_half_of_the_light_is_absorbed():
    origin, ahead = np.zeros(3), np.array([0, 0, 2.0])
    assert surface_finder(wall(3, 0.9))(origin, ahead) == pytest.approx(3, abs=1e-3)
    assert surface_finder(wall(3, 0.9))(origin, -ahead) == np.inf
    assert surface_finder(wall(3, 0.9))(np.array([40.0, 0, 0]), ahead) == np.inf, "beside the wall"
    assert surface_finder(wall(3, 0.4))(origin, ahead) == np.inf, "most of the light passes"
    two = concatenate([wall(5, 0.4), wall(4, 0.4)])
    assert surface_finder(two)(origin, ahead) == pytest.approx(5, abs=1e-3)


def test_cameras_move_into_a_room_and_see_it():
    orbit = orbit_cameras(ROOM, 12, size=(64, 48))
    moved = moved_indoors(ROOM, orbit, DEFAULT_UP)
    assert moved is not None
    assert [camera.name for camera in moved] == [camera.name for camera in orbit]
    low, high = np.percentile(np.asarray(ROOM.means), [1, 99], axis=0)
    inside = [bool(((low < c.center) & (c.center < high)).all()) for c in moved]
    assert 6 <= sum(inside) < 12, "those from above stay"
    for camera, before, within in zip(moved, orbit, inside, strict=True):
        if not within:
            assert camera is before
            continue
        rotation = np.asarray(camera.viewmat)[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-5)
        assert -rotation[1] @ DEFAULT_UP > 0.9, "the image is not level"
        _, alpha = render(ROOM, camera)
        assert alpha.mean() > 0.7, "it looks out of the room"


def test_what_is_open_is_looked_at_from_outside():
    shell = ball(2_000)
    shell.means[:] /= np.linalg.norm(shell.means, axis=1, keepdims=True)
    low = ROOM.take(np.asarray(ROOM.means)[:, 1] > -0.2)  # without walls
    for scene in (ball(), low, make_object(), shell):
        assert moved_indoors(scene, orbit_cameras(scene, 12), DEFAULT_UP) is None
