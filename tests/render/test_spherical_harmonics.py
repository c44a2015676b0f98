"""Colours against a reference with associated Legendre functions, and the laws of rotation."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
import reference
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import floats, motions, random_scene

from gsc_jax.render import spherical_harmonics as sh

CENTER = np.array([0.3, -0.2, 0.1], np.float32)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
def test_colors_are_those_of_the_reference(degree):
    gaussians = random_scene(300, degree=degree)
    gaussians = dataclasses.replace(gaussians, sh=3 * gaussians.sh)
    colors = sh.colors(gaussians.sh, gaussians.means, CENTER)
    expected = reference.colors(gaussians, CENTER)
    assert colors.dtype == jnp.float32
    np.testing.assert_allclose(colors, expected, atol=4e-6)
    assert (expected == 0).any(), "no colour reaches the clamp at 0"


def test_a_uniform_color_is_stored_over_the_constant_harmonic():
    color = np.array([[0.1, 0.5, 1.2]], np.float32)
    stored = (color[:, None] - 0.5) / np.float32(sh.Y0)
    np.testing.assert_allclose(sh.colors(stored, CENTER[None] + 1, CENTER), color, atol=1e-6)


@given(floats((5, 3), -1, 1))
def test_harmonics_have_the_parity_of_their_band(directions):
    directions = jnp.asarray(directions)
    bands = np.repeat([0, 1, 2, 3], [1, 3, 5, 7])
    there, back = sh.basis(directions, 3), sh.basis(-directions, 3)
    # Bands 0 and 2 are even, 1 and 3 odd; exact, because only signs change.
    np.testing.assert_array_equal(back, there * (-1.0) ** bands[None].astype(np.float32))


@pytest.mark.usefixtures("nan_is_an_error")
@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, 3e38, -3e38])
def test_colors_are_finite_for_any_stored_value(value):
    gaussians = random_scene(4, degree=3)
    coefficients = np.array(gaussians.sh)
    coefficients[1] = value
    colors = np.asarray(sh.colors(coefficients, gaussians.means, CENTER))
    assert np.isfinite(colors).all()
    expected = reference.colors(gaussians, CENTER)
    np.testing.assert_allclose(np.delete(colors, 1, 0), np.delete(expected, 1, 0), atol=2e-6)


@pytest.mark.usefixtures("nan_is_an_error")
def test_a_gaussian_at_the_camera_has_its_constant_color():
    gaussians = random_scene(4, degree=3)
    color = sh.colors(gaussians.sh, gaussians.means, gaussians.means[2])[2]
    np.testing.assert_allclose(color, 0.5 + sh.Y0 * gaussians.sh[2, 0], atol=1e-6)


@pytest.mark.parametrize("degree", [-1, 4])
def test_degrees_outside_0_to_3_are_refused(degree):
    with pytest.raises(ValueError, match=f"0 to 3, got {degree}"):
        sh.basis(jnp.ones((1, 3)), degree)


@given(motions(), st.integers(0, 3))
def test_rotated_harmonics_move_the_color_to_the_rotated_direction(motion, degree):
    R = Rotation.from_quat(motion[0], scalar_first=True).as_matrix()
    scene = random_scene(6, degree=degree)
    directions = np.random.default_rng(0).normal(size=(6, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origin = np.zeros(3, np.float32)
    before = sh.colors(scene.sh, directions.astype(np.float32), origin)
    turned = sh.rotate(scene.sh, R)
    assert turned.dtype == jnp.float32
    after = sh.colors(turned, (directions @ R.T).astype(np.float32), origin)
    np.testing.assert_allclose(after, before, atol=5e-6)


@pytest.mark.parametrize("count", [3, 5, 12])
def test_another_number_of_coefficients_is_an_error(count):
    with pytest.raises(ValueError, match=f"1, 4, 9 or 16 coefficients, got {count}"):
        sh.colors(
            np.zeros((2, count, 3), np.float32),
            np.zeros((2, 3), np.float32),
            np.zeros(3, np.float32),
        )
