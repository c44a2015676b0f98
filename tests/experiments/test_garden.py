import dataclasses

import garden
import jax
import numpy as np
import pytest

from gsc_jax.benchmark import scenes
from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.scene import invalid_rows
from gsc_jax.splat import render

CAMERAS = garden.garden_cameras(16, width=96, height=72, seed=5)


@pytest.fixture(scope="module")
def made():
    return garden.make_garden(count=12_000)


def test_garden_is_float32_degree_1_and_renderable(made):
    leaves = jax.tree.leaves(made)
    assert all(isinstance(leaf, np.ndarray) and leaf.dtype == np.float32 for leaf in leaves)
    assert made.sh.shape == (12_000, 4, 3)
    assert not any(rows.any() for rows in invalid_rows(made).values())


def test_garden_has_the_statistics_of_a_trained_outdoor_scene(made):
    distance = np.linalg.norm(made.means, axis=1)
    size = np.asarray(made.scales).max(axis=1)
    opacities = np.asarray(made.opacities)
    assert np.median(opacities) > 0.8
    assert 0.02 < np.mean(opacities < 0.2) < 0.2, "no tail of faint Gaussians"
    assert 0.02 < np.mean(distance > 8) < 0.2, "no background, or most of it"
    assert np.median(size[distance > 8]) > 5 * np.median(size[distance < 4])
    assert np.linalg.norm(made.quats, axis=1).std() > 0.1, "quaternions are normalised"


def test_the_path_is_uneven_and_not_steep(made):
    radius = np.hypot(made.means[:, 0], made.means[:, 2])
    path = made.means[(radius > garden.LAWN) & (radius < garden.PATH) & (made.means[:, 1] > -0.3)]
    assert path[:, 1].std() > 0.03
    turn = np.linspace(0, 2 * np.pi, 721)
    heights = garden.ground(3 * np.cos(turn), 3 * np.sin(turn))
    assert np.abs(np.diff(heights)).max() / (3 * np.diff(turn)[0]) < 0.35
    assert np.ptp(heights) > 0.15


def test_the_seed_determines_garden_and_cameras():
    one, same, other = (garden.make_garden(seed=s, count=800) for s in (3, 3, 4))
    jax.tree.map(np.testing.assert_array_equal, one, same)
    assert not np.allclose(one.means, other.means)
    one, same, other = (garden.garden_cameras(3, seed=s) for s in (3, 3, 4))
    np.testing.assert_array_equal(one[1].viewmat, same[1].viewmat)
    assert not np.allclose(one[1].viewmat, other[1].viewmat)


@pytest.mark.parametrize("count", [3, 31, 777, 5001])
def test_count_is_met_exactly(count):
    assert len(garden.make_garden(count=count)) == count


def test_cameras_are_level_rigid_and_on_the_path_at_different_heights():
    assert [camera.name for camera in CAMERAS[:2]] == ["garden_000", "garden_001"]
    for camera in CAMERAS:
        rotation = np.asarray(camera.viewmat)[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-5)
        assert np.linalg.det(rotation) > 0
        assert abs(rotation[0, 1]) < 1e-6, "the horizon is tilted"
        assert rotation[1, 1] > 0, "the camera is upside down"
        assert garden.LAWN < np.hypot(camera.center[0], camera.center[2]) < garden.PATH
        assert -2.31 < camera.center[1] < -0.89
    assert np.ptp([camera.center[1] for camera in CAMERAS]) > 0.8
    turns = np.unwrap([np.arctan2(camera.center[2], camera.center[0]) for camera in CAMERAS])
    assert (np.diff(turns) > 0).all()
    assert turns[-1] - turns[0] > 1.7 * np.pi
    assert garden.garden_cameras(0) == []


def test_cameras_are_not_inside_obstacles(made):
    opaque = np.asarray(made.opacities) > 0.5
    for camera in CAMERAS:
        distance = np.linalg.norm(made.means[opaque] - camera.center, axis=1)
        assert distance.min() > 0.3, f"{camera.name} is inside an obstacle"


def test_renders_have_no_holes_and_show_sky_and_plants(made):
    blue = []
    for camera in CAMERAS[:8]:
        rgb, alpha = map(np.asarray, render(made, camera))
        assert alpha.mean() > 0.95
        assert np.mean(alpha < 0.5) < 0.005, f"{camera.name} has holes"
        assert rgb.std(axis=(0, 1)).min() > 0.05, f"{camera.name} is blank"
        green = (rgb[..., 1] > 1.1 * rgb[..., 0]) & (rgb[..., 1] > 1.1 * rgb[..., 2])
        assert 0.1 < green.mean() < 0.9, f"{camera.name} is all plants, or none"
        blue.append((rgb[..., 2] - rgb[..., 1]).mean(axis=1))
    above, below = np.mean(blue, axis=0)[[0, -1]]
    assert above > 0 > below, "the sky is not above, or the lawn not below"


def test_the_sun_lights_one_side_of_the_finial():
    finial = garden.make_garden(count=30_000)
    place = finial.means + np.array([0, 1.42, 0], np.float32)
    near = (np.hypot(place[:, 0], place[:, 2]) < 0.15) & (np.abs(place[:, 1]) < 0.15)
    near &= np.asarray(finial.opacities) > 0.5
    bright = finial.sh[near, 0].mean(axis=1)
    assert np.corrcoef(bright, place[near] @ garden.SUN)[0, 1] > 0.5


def test_an_object_on_the_plinth_is_visible(made):
    room_object = scenes.make_object(count=1200)
    means = room_object.means + garden.PLINTH.astype(np.float32)
    beneath = made.means[np.linalg.norm((made.means - garden.PLINTH)[:, [0, 2]], axis=1) < 0.18]
    on_top = np.abs(beneath[:, 1] - garden.PLINTH[1]) < 0.03
    assert on_top.sum() > 5, "there is no plinth"
    opaque = np.asarray(made.opacities) > 0.5
    above = made.means[opaque] - garden.PLINTH - [0, -0.35, 0]
    assert np.linalg.norm(above, axis=1).min() > 0.2, "the plinth is not empty"
    scene = scenes.concatenate([made, dataclasses.replace(room_object, means=means)])
    labels = np.arange(len(scene)) >= len(made)
    shown = [truth_mask(scene, camera, labels).mean() for camera in CAMERAS]
    assert np.mean(np.array(shown) > 0.005) > 0.6, "the object is seldom visible"
