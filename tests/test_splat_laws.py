"""Laws of compositing and its adjoint: adjointness, weights, permutations, rigid motions."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import reference
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from strategies import COUNT, camera, floats, motions, scenes
from tolerances import ADJOINT, ROUNDING

import gsc_jax
from gsc_jax.render.tiles import make_view
from gsc_jax.render.walk import CHUNK, blend_pixel
from gsc_jax.splat import accumulate, composite

VIEW = camera(17, 15)


@given(scenes(), floats((COUNT, 2), -1, 1), floats((15, 17, 2), -1, 1))
def test_accumulate_is_the_adjoint_of_composite(gaussians, features, maps):
    view = make_view(gaussians, VIEW)
    image = np.asarray(composite(view, jnp.asarray(features)), np.float64)
    sums = np.asarray(accumulate(view, jnp.asarray(maps)), np.float64)
    size = np.vdot(composite(view, jnp.abs(features)), np.abs(maps))
    assert abs(np.vdot(image, maps) - np.vdot(features, sums)) <= ADJOINT * size + 1e-30


def weights_of(gaussians, view=VIEW, **options) -> np.ndarray:
    """The matrix W, (H, W, N)."""
    identity = jnp.eye(len(gaussians))
    return np.asarray(composite(make_view(gaussians, view, **options), identity))


@given(scenes())
def test_weights_are_nonnegative_and_sum_to_alpha_below_1(gaussians):
    weights = weights_of(gaussians)
    alpha = weights.sum(axis=-1)
    np.testing.assert_allclose(alpha, gsc_jax.render(gaussians, VIEW)[1], atol=1e-5)
    assert weights.min() >= 0
    assert weights.max() <= 0.99 * (1 + 1e-6)
    assert alpha.max() <= 1 - 1e-4 + ROUNDING


def test_weights_are_exactly_zero_for_zero_opacity_and_never_negative():
    rng = np.random.default_rng(0)
    alphas = rng.uniform(1 / 255, 0.99, (512, 64, CHUNK)).astype(np.float32) ** 2
    alphas[rng.random(alphas.shape) < 0.5] = 0
    light = rng.random((512, 64)).astype(np.float32)
    blended, behind = jax.jit(jax.vmap(jax.vmap(blend_pixel)))(light, alphas)
    weights = np.stack(blended, axis=-1)
    assert (weights >= 0).all()
    assert (weights == 0)[alphas == 0].all()
    products = light[..., None] * np.cumprod(1.0 - alphas.astype(np.float64), axis=-1)
    expected = np.where(products >= 1e-4, products / (1 - alphas) * alphas, 0)
    clear = np.abs(products / 1e-4 - 1) > 1e-5
    np.testing.assert_allclose(weights[clear], expected[clear], rtol=0, atol=2e-7)
    np.testing.assert_allclose(behind, products[..., -1], rtol=1e-5)


@given(scenes())
def test_splats_that_do_not_cover_a_pixel_have_weight_zero_there(gaussians):
    blend = reference.blending(gaussians, VIEW)
    expected = blend.composite(np.eye(len(gaussians)))
    uncovered = blend.clear[..., None] & (expected == 0)
    assert (weights_of(gaussians)[uncovered] == 0).all()


@given(scenes(), st.permutations(range(COUNT)))
def test_permuting_gaussians_permutes_the_columns_of_w(gaussians, order):
    permuted = gaussians.take(np.array(order))
    # Exact, because splats are blended in depth order in both cases.
    np.testing.assert_array_equal(weights_of(permuted), weights_of(gaussians)[..., order])


@given(scenes(), motions())
def test_moving_scene_and_camera_together_changes_nothing_at_degree_0(gaussians, motion):
    rotation, shift = Rotation.from_quat(motion[0], scalar_first=True), motion[1]
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = rotation.inv().as_matrix(), -rotation.inv().apply(shift)
    turned = rotation * Rotation.from_quat(gaussians.quats, scalar_first=True)
    moved = dataclasses.replace(
        gaussians,
        means=(rotation.apply(gaussians.means) + shift).astype(np.float32),
        quats=turned.as_quat(scalar_first=True).astype(np.float32),
    )
    image, _ = gsc_jax.render(moved, camera(17, 15, viewmat=viewmat))
    expected, _ = gsc_jax.render(gaussians, VIEW)
    jump = reference.blending(gaussians, VIEW).jump
    np.testing.assert_array_less(np.abs(image - expected).max(axis=-1), jump + 1e-4)
