"""Orbits: every camera sees the whole scene from above, and the poses are reproducible."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import ball, with_row

from gsc_jax.render.orbit import DEFAULT_UP, mean_up, orbit_cameras
from gsc_jax.render.projection import project_centers
from gsc_jax.scene import InputError


@settings(max_examples=30)
@given(
    n=st.sampled_from([1, 2, 7]),
    seed=st.integers(0, 99),
    fov=st.sampled_from([20.0, 60.0, 100.0]),
    size=st.sampled_from([(640, 480), (100, 300)]),
    up=st.sampled_from([(0, -1, 0), (0, 0, 5), (1, 1, 0)]),
)
def test_orbits_look_at_the_centre_from_above(n, seed, fov, size, up):
    scene = ball()
    cameras = orbit_cameras(scene, n, size=size, fov_degrees=fov, up=up, seed=seed)
    assert [camera.name for camera in cameras] == [f"orbit_{i:03d}" for i in range(n)]
    opaque = np.asarray(scene.means)[np.asarray(scene.logit_opacities) > 0]
    middle = np.median(opaque, axis=0)
    for camera in cameras:
        rotation = np.asarray(camera.viewmat)[:3, :3]
        np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-6)
        assert np.linalg.det(rotation) > 0
        target = project_centers(middle[None].astype(np.float32), camera.viewmat, camera.K)[0]
        np.testing.assert_allclose(target[0], np.array(size) / 2, atol=0.01)
        assert (camera.center - middle) @ up > 0, "the camera looks from below"
        assert rotation[1] @ up < 0, "the image is upside down"
        pixels, depths = map(np.asarray, project_centers(opaque, camera.viewmat, camera.K))
        inside = ((pixels > 0) & (pixels < size)).all(axis=1) & (depths > 0)
        assert inside.mean() > 0.9, "the camera is too close"
        assert (np.ptp(pixels, axis=0) > 0.4 * np.array(size)).any(), "the camera is too far away"


def test_orbits_are_reproducible_and_evenly_spread():
    scene = ball()
    first, again, other = (orbit_cameras(scene, 6, seed=seed) for seed in (1, 1, 2))
    for a, b in zip(first, again, strict=True):
        np.testing.assert_array_equal(a.viewmat, b.viewmat)
    assert not np.allclose(first[0].viewmat, other[0].viewmat)
    heights = {round(-float(camera.center[1]), 3) for camera in first}
    assert len(heights) == 3, "three elevations"
    flat = np.array([camera.center[::2] for camera in first]) - [1, 5]
    azimuths = np.sort(np.arctan2(*flat.T))
    np.testing.assert_allclose(np.diff(azimuths), np.pi / 3, atol=0.05)


def test_the_mean_up_of_an_orbit_is_its_up():
    cameras = orbit_cameras(ball(), 12, up=(1, 2, -1))
    np.testing.assert_allclose(mean_up(cameras), np.array([1, 2, -1]) / np.sqrt(6), atol=1e-3)


def test_a_single_gaussian_has_an_orbit():
    scene = ball(2).take(np.array([1]))
    for camera in orbit_cameras(scene, 3):
        depths = project_centers(scene.means, camera.viewmat, camera.K)[1]
        assert 0 < float(depths[0]) < 1
    faint = dataclasses.replace(scene, logit_opacities=np.full(1, -5, np.float32))
    assert len(orbit_cameras(faint, 2)) == 2


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 1e30])
def test_rows_that_cannot_be_rendered_are_ignored(value):
    scene = ball(50)
    broken = with_row(scene, "means", value, row=7)
    rest = scene.take(np.delete(np.arange(50), 7))
    for found, expected in zip(orbit_cameras(broken, 3), orbit_cameras(rest, 3), strict=True):
        np.testing.assert_array_equal(found.viewmat, expected.viewmat)
    nothing = dataclasses.replace(scene, means=np.full_like(scene.means, value))
    with pytest.raises(InputError, match="no Gaussian that can be rendered"):
        orbit_cameras(nothing, 3)


@pytest.mark.parametrize("place", [0.0, 1e9])
def test_a_point_without_extent_has_an_orbit(place):
    scene = ball(2).take(np.array([1]))
    scene = dataclasses.replace(
        scene,
        means=np.full((1, 3), place, np.float32),
        log_scales=np.full((1, 3), -np.inf, np.float32),
    )
    assert all(np.isfinite(camera.viewmat).all() for camera in orbit_cameras(scene, 3))


def test_directions_that_cancel_have_a_defined_mean():
    camera = orbit_cameras(ball(20), 1)[0]
    upside_down = np.diag([-1.0, -1.0, 1.0, 1.0]).astype(np.float32) @ camera.viewmat
    cameras = [camera, dataclasses.replace(camera, viewmat=upside_down)]
    np.testing.assert_array_equal(mean_up(cameras), DEFAULT_UP)


@pytest.mark.parametrize(
    "options",
    [
        {"n": 0},
        {"n": 2.5},
        {"n": 2.0},
        {"n": True},
        {"n": "3"},
        {"n": 10**12},
        {"size": 480},
        {"size": (640, 480, 3)},
        {"fov_degrees": "60"},
        {"fov_degrees": 180.0},
        {"fov_degrees": np.nan},
        {"fov_degrees": 1e-300},
        {"up": (0, 0, 0)},
        {"up": (0, 1)},
        {"up": (0, np.nan, 0)},
        {"size": (0, 480)},
        {"size": (640, -1)},
        {"size": (1e300, 480)},
        {"size": (np.nan, 480)},
    ],
)
def test_invalid_orbits_are_refused(options):
    with pytest.raises(InputError, match="expected at least one camera"):
        orbit_cameras(ball(20), **{"n": 3} | options)
