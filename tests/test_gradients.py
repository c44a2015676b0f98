"""Derivatives of an image by everything that it depends on, against the float64 reference."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import reference
from scipy.spatial.transform import Rotation
from strategies import blobs, camera, random_scene, with_row

import gsc_jax
from gsc_jax.render.derivatives import derivatives
from gsc_jax.render.reprojection import reprojected
from gsc_jax.render.tiles import make_view
from gsc_jax.render.walk import MAX_ALPHA
from gsc_jax.splat import accumulate, composite, render_view

VIEW = camera(33, 25)
MAPS = np.random.default_rng(0).normal(size=(25, 33, 4)).astype(np.float32)
STEP = 1e-6
PARAMETERS = ("means", "log_scales", "quats", "logit_opacities", "sh")


def loss(gaussians, view, maps):
    """A linear function of colours and alpha."""
    rgb, alpha = gsc_jax.render(gaussians, view)
    return jnp.sum(maps[..., :3] * rgb) + jnp.sum(maps[..., 3] * alpha)


def slope(change, maps) -> float:
    """Derivative of `loss` by t at 0 of the scene and camera change(t), by the reference."""

    def value(t):
        rgb, alpha, _ = reference.render(*change(t))
        return np.sum(maps[..., :3] * rgb) + np.sum(maps[..., 3] * alpha)

    return float((value(STEP) - value(-STEP)) / (2 * STEP))


def clear_maps(gaussians, view) -> np.ndarray:
    """The maps without the pixels where rounding may decide whether a Gaussian counts."""
    return MAPS * reference.blending(gaussians, view).clear[..., None]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("name", PARAMETERS)
def test_the_derivative_by_the_gaussians_is_that_of_the_reference(name, seed):
    gaussians = random_scene(60, seed=seed, degree=3)
    maps, values = clear_maps(gaussians, VIEW), np.asarray(getattr(gaussians, name), np.float64)
    direction = np.random.default_rng(seed).normal(size=values.shape)

    def change(t):
        return dataclasses.replace(gaussians, **{name: values + t * direction}), VIEW

    gradient = getattr(jax.grad(loss)(gaussians, VIEW, maps), name)
    size = np.sum(np.abs(gradient * direction))
    assert size > 1
    assert abs(np.vdot(gradient, direction) - slope(change, maps)) < 2e-4 * size


@pytest.mark.parametrize("seed", range(3))
def test_the_derivative_by_the_pose_is_that_of_the_reference(seed):
    gaussians = random_scene(60, seed=seed, degree=3)
    maps, viewmat = clear_maps(gaussians, VIEW), np.asarray(VIEW.viewmat, np.float64)
    turn, shift = np.random.default_rng(seed).normal(size=(2, 3))
    generator = np.zeros((4, 4))
    generator[:3, :3] = np.cross(np.eye(3), turn)
    generator[:3, 3] = shift

    def change(t):
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = Rotation.from_rotvec(t * turn).as_matrix(), t * shift
        return gaussians, dataclasses.replace(VIEW, viewmat=motion @ viewmat)

    def by_pose(viewmat):
        return loss(gaussians, dataclasses.replace(VIEW, viewmat=viewmat), maps)

    products = jax.grad(by_pose)(jnp.asarray(VIEW.viewmat)) * (generator @ viewmat)
    assert abs(products.sum() - slope(change, maps)) < 2e-4 * np.abs(products).sum()


@pytest.mark.parametrize("seed", range(3))
def test_the_derivative_by_the_intrinsics_is_that_of_the_reference(seed):
    gaussians = random_scene(60, seed=seed, degree=3)
    maps, K = clear_maps(gaussians, VIEW), np.asarray(VIEW.K, np.float64)
    direction = np.random.default_rng(seed).normal(size=(3, 3)) * [[1, 0, 1], [0, 1, 1], [0, 0, 0]]

    def change(t):
        return gaussians, dataclasses.replace(VIEW, K=K + t * direction)

    def by_intrinsics(K):
        return loss(gaussians, dataclasses.replace(VIEW, K=K), maps)

    products = jax.grad(by_intrinsics)(jnp.asarray(VIEW.K)) * direction
    assert abs(products.sum() - slope(change, maps)) < 2e-4 * np.abs(products).sum()


def test_the_derivative_by_the_features_is_accumulate():
    gaussians = random_scene(200)
    view = make_view(gaussians, VIEW)
    features = jnp.asarray(np.random.default_rng(1).random((200, 4)), jnp.float32)
    image = composite(view, features)
    np.testing.assert_array_equal(
        derivatives(view, features, image, MAPS)[1], accumulate(view, MAPS)
    )


def test_a_clamped_alpha_has_no_derivative():
    gaussians = blobs([[0, 0, 2]], opacity=1 - 1e-6, scale=3.0)
    view = camera(1, 1)
    assert float(gsc_jax.render(gaussians, view)[1][0, 0]) == np.float32(MAX_ALPHA)
    gradient = jax.grad(lambda g: gsc_jax.render(g, view)[1].sum())(gaussians)
    assert not np.any(jax.tree.leaves(jax.tree.map(np.any, gradient)))


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("means", np.nan),
        ("log_scales", np.nan),
        ("log_scales", 89.0),
        ("quats", np.nan),
        ("quats", np.inf),
        ("logit_opacities", np.nan),
        ("sh", np.nan),
        ("logit_opacities", np.inf),
        ("logit_opacities", -np.inf),
        ("log_scales", -np.inf),
        ("log_scales", 40.0),
        ("means", 3e30),
        ("means", 0.0),
        ("quats", 0.0),
    ],
)
@pytest.mark.usefixtures("nan_is_an_error")
def test_extreme_rows_have_finite_derivatives(field, value):
    gaussians = with_row(random_scene(20), field, value)
    gradient = jax.grad(loss, (0, 1))(gaussians, VIEW, MAPS)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))


def test_a_view_of_other_gaussians_or_another_size_is_an_error():
    gaussians = random_scene(5)
    view = make_view(random_scene(12), VIEW)
    for function in (reprojected, render_view):
        with pytest.raises(ValueError, match="expected a view of 5 Gaussians with 33 x 25"):
            function(view, gaussians, VIEW)
        with pytest.raises(ValueError, match="with 17 x 15 pixels, got one of 12 with 33 x 25"):
            function(view, random_scene(12), camera(17, 15))


def test_a_step_under_jit_has_the_derivatives_of_render():
    gaussians = random_scene(60)
    view = make_view(gaussians, VIEW)

    @jax.jit
    def gradient(gaussians, view):
        def of_view(gaussians):
            rgb, alpha = render_view(reprojected(view, gaussians, VIEW), gaussians, VIEW)
            return jnp.sum(MAPS[..., :3] * rgb) + jnp.sum(MAPS[..., 3] * alpha)

        return jax.grad(of_view)(gaussians)

    found, expected = gradient(gaussians, view), jax.grad(loss)(gaussians, VIEW, MAPS)
    for name in PARAMETERS:
        one, other = getattr(found, name), getattr(expected, name)
        np.testing.assert_allclose(one, other, rtol=1e-4, atol=1e-4 * np.abs(other).max())


def test_a_view_cannot_be_built_under_jit():
    with pytest.raises(TypeError, match=r"build the view outside .* reprojected"):
        jax.jit(lambda g: gsc_jax.render(g, VIEW))(random_scene(5))
