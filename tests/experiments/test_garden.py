import garden
import jax
import numpy as np
import pytest

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


def test_the_seed_determines_garden_and_cameras():
    one, same, other = (garden.make_garden(seed=s, count=800) for s in (3, 3, 4))
    jax.tree.map(np.testing.assert_array_equal, one, same)
    assert not np.allclose(one.means, other.means)
    one, same, other = (garden.garden_cameras(3, seed=s) for s in (3, 3, 4))
    np.testing.assert_array_equal(one[1].viewmat, same[1].viewmat)
    assert not np.allclose(one[1].viewmat, other[1].viewmat)


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
