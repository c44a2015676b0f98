"""The losses: cases worked by hand, the definition of eq. 7 and 8, empty groups, gradients."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from strategies import random_scene, with_row

from gsc_jax.evidence.lifting import Evidence
from gsc_jax.losses import (
    Partition,
    direction,
    loss_2d,
    loss_2d_from_evidence,
    loss_3d,
    official_attributes,
    paper_attributes,
    partition,
    sim,
    sim_difference,
    standardised_attributes,
)


def groups(high, middle, low) -> Partition:
    high, middle, low = (jnp.asarray(np.isin(np.arange(6), rows)) for rows in (high, middle, low))
    return Partition(high=high, middle=middle, low=low)


def test_the_2d_loss_weights_the_inside_by_lambda1_and_the_outside_by_lambda2():
    rendered = jnp.array([[1.0, 2.0], [3.0, 4.0]])
    mask = np.array([[True, False], [False, True]])
    assert loss_2d(rendered, mask) == -(1 + 4) + 10 * (2 + 3)
    assert loss_2d(rendered, mask, lambda1=2.0, lambda2=0.5) == -2 * (1 + 4) + 0.5 * (2 + 3)


def test_the_2d_loss_from_evidence_is_linear_in_the_attribute():
    evidence = Evidence(total=jnp.array([4.0, 2.0]), tampered=jnp.array([3.0, 0.5]))
    r = jnp.array([1.0, -2.0])
    expected = 1 * (10 * 1 - 3) + -2 * (10 * 1.5 - 0.5)
    assert loss_2d_from_evidence(r, evidence) == pytest.approx(expected)
    gradient = jax.grad(loss_2d_from_evidence)(r, evidence)
    np.testing.assert_allclose(gradient, [7, 14.5], rtol=1e-6)


def test_the_groups_have_the_thresholds_of_the_released_code():
    r = jnp.array([10.0, 9.0, 8.9, 1.0, 0.5, 0.0, -8.0, -9.0, -10.0])
    found = partition(r)
    assert np.flatnonzero(found.high).tolist() == [0, 1]
    assert np.flatnonzero(found.middle).tolist() == [3, 4]
    assert np.flatnonzero(found.low).tolist() == [7, 8]


def test_the_groups_do_not_depend_on_the_unit_of_the_attribute():
    r = np.array([10.0, 9.5, 5.0, 0.5, -5.0, -9.5, -10.0], np.float32)
    for unit in (1e-3, 1e3):
        found = partition(r * np.float32(unit))
        assert np.flatnonzero(found.high).tolist() == [0, 1]
        assert np.flatnonzero(found.middle).tolist() == [3]
        assert np.flatnonzero(found.low).tolist() == [5, 6]


def test_an_attribute_of_0_is_low_where_none_is_negative_and_in_no_other_group():
    assert partition(np.array([2.0, 1.0, 0.0], np.float32)).low.tolist() == [False, False, True]
    zeros = partition(np.zeros(3, np.float32))
    assert not zeros.high.any()
    assert not zeros.middle.any()
    assert zeros.low.all()


@given(hnp.arrays(np.float32, 8, elements=st.floats(-50, 50, width=32)))
def test_no_gaussian_is_in_two_groups(r):
    found = partition(jnp.asarray(r))
    assert not jnp.any(found.high & found.middle)
    assert not jnp.any((found.high | found.middle) & found.low)


def test_the_direction_points_to_the_nearer_mean():
    attributes = jnp.array([[1.0, 0], [1, 0], [0.9, 0], [0.1, 0], [0, 0], [0, 0]]).T
    split = groups([0, 1], [2, 3], [4, 5])
    assert direction(attributes, split).tolist() == [0, 0, 1, -1, 0, 0]
    # One attribute is nearer to G_h, the other to G_l: per Gaussian the larger difference decides,
    # per attribute the signs cancel.
    mixed = jnp.array([[1.0, 0], [1, 0], [0.9, -3], [0.1, 3], [0, 0], [0, 0.5]]).T
    assert direction(mixed, split, per_feature=True).tolist() == [0, 0, 1, -1, 0, 0]
    torn = mixed.at[:, 2].set(jnp.array([0.9, 5.0]))
    assert direction(torn, split, per_feature=True)[2] == 0
    assert direction(torn, split)[2] == -1
    two_to_one = jnp.concatenate([torn, attributes[:1]])
    assert direction(two_to_one, split, per_feature=True)[2] == pytest.approx(1 / 3)


def test_the_3d_loss_is_minus_the_mean_of_u_r_over_the_middle():
    attributes = jnp.array([[1.0, 1.0, 0.9, 0.1, 0.0, 0.0]])
    split = groups([0, 1], [2, 3], [4, 5])
    r = jnp.array([9.0, 9.0, 0.5, 0.25, -9.0, -9.0])
    assert loss_3d(r, attributes, split) == pytest.approx(-(0.5 - 0.25) / 2)
    gradient = jax.grad(loss_3d)(r, attributes, split)
    np.testing.assert_allclose(gradient, [0, 0, -0.5, 0.5, 0, 0])


def test_the_factored_difference_is_that_of_the_two_sims():
    """Eq. 8 is computed without the squares of eq. 7."""
    rng = np.random.default_rng(0)
    attributes = (rng.normal(size=(5, 60)) * [[1], [10], [0.1], [3], [1]]).astype(np.float32)
    mean_h, mean_l = rng.normal(size=(2, 5)).astype(np.float32)
    difference = np.sum(sim_difference(attributes, mean_h, mean_l), axis=0)
    sims = sim(attributes, mean_l) - sim(attributes, mean_h)
    np.testing.assert_allclose(difference, sims, rtol=1e-4, atol=1e-4)
    assert sim(attributes, attributes[:, 7])[7] == 0


@pytest.mark.usefixtures("nan_is_an_error")
@pytest.mark.parametrize("per_feature", [False, True])
@pytest.mark.parametrize(
    "split", [([], [2, 3], [4, 5]), ([0, 1], [], [4, 5]), ([0, 1], [2, 3], []), ([], [], [])]
)
def test_an_empty_group_makes_the_3d_loss_zero_with_zero_gradient(split, per_feature):
    attributes, r = jnp.ones((3, 6)), jnp.arange(6.0)
    loss_and_gradient = jax.value_and_grad(loss_3d)
    value, gradient = loss_and_gradient(r, attributes, groups(*split), per_feature=per_feature)
    assert value == 0
    assert not gradient.any()


def test_the_attributes_have_the_sizes_and_units_of_paper_and_released_code():
    scene = random_scene(5, degree=2)
    assert paper_attributes(scene).shape == (11 + 3 * 9, 5)
    official = official_attributes(scene)
    assert official.shape == (14, 5)
    np.testing.assert_allclose(jnp.linalg.norm(official[10:], axis=0), 1, rtol=1e-5)
    np.testing.assert_allclose(official[7:10], np.exp(scene.log_scales).T, rtol=1e-5)


@pytest.mark.usefixtures("nan_is_an_error")
def test_standardised_attributes_ignore_units_and_the_sign_of_a_quaternion():
    scene = random_scene(50)
    larger = dataclasses.replace(
        scene,
        means=scene.means * 100,
        log_scales=scene.log_scales + np.log(np.float32(100)),
        quats=-scene.quats,
    )
    standardised, of_larger = standardised_attributes(scene), standardised_attributes(larger)
    np.testing.assert_allclose(standardised, of_larger, rtol=2e-3, atol=2e-3)
    infinite = with_row(scene, "logit_opacities", np.inf)
    constant = dataclasses.replace(infinite, means=np.ones_like(scene.means))
    assert jnp.isfinite(standardised_attributes(constant)).all()


def test_standardised_attributes_have_median_0_and_mad_1_and_are_0_where_not_usable():
    scene = with_row(random_scene(51), "means", np.nan)
    scene = dataclasses.replace(scene, sh=np.ones_like(scene.sh))
    of_scene = standardised_attributes(scene)
    assert of_scene[:3, 0].tolist() == [0, 0, 0]
    assert not of_scene[3:6].any(), "a colour that does not vary"
    varying = of_scene[[0, 1, 2, *range(6, 14)], 1:]
    np.testing.assert_allclose(np.median(varying, axis=1), 0, atol=1e-5)
    np.testing.assert_allclose(np.median(np.abs(varying), axis=1) * 1.4826, 1, rtol=1e-4)
    for row, of_row in ((6, scene.logit_opacities), (7, scene.log_scales[:, 0])):
        assert np.array_equal(np.argsort(of_scene[row, 1:]), np.argsort(of_row[1:]))


def test_an_attribute_near_zero_is_compared_in_its_own_unit():
    r = jnp.array([1.0, 0.05, 0.0, -0.5, -1.0])
    found = partition(r)
    assert np.flatnonzero(found.middle).tolist() == [1]
    assert np.flatnonzero(found.low).tolist() == [4]


def test_a_group_of_one_has_its_own_attributes_as_its_mean():
    attributes = jnp.array([[4.0, 4.0, 1.9, 0.0, 0.0, 0.0]])
    split = groups([0], [2], [5])
    assert direction(attributes, split)[2] == -1, "1.9 is nearer to 0 than to 4"
    assert loss_3d(jnp.arange(6.0), attributes, split) == 2


def test_the_3d_loss_takes_one_sign_per_gaussian_by_default():
    attributes = jnp.array([[1.0, 0], [1, 0], [0.9, 5.0], [0.1, 0], [0, 0], [0, 0.5]]).T
    split, r = groups([0, 1], [2], [4, 5]), jnp.ones(6)
    assert loss_3d(r, attributes, split) == 1
    assert loss_3d(r, attributes, split, per_feature=True) == 0


def test_the_released_attributes_hold_the_first_colour_and_0_where_not_finite():
    scene = with_row(random_scene(5, degree=2), "means", np.nan)
    for attributes in (official_attributes(scene), paper_attributes(scene)):
        assert attributes[:3, 0].tolist() == [0, 0, 0]
        np.testing.assert_array_equal(attributes[:3, 1:], scene.means[1:].T)
        np.testing.assert_array_equal(attributes[3:6], scene.sh[:, 0].T)


def test_standardised_attributes_clip_what_float32_cannot_tell_apart():
    """Logits beyond 20, and scales below exp(-20)."""
    scene = random_scene(50)
    for field, one, same, other in (
        ("logit_opacities", 20, np.inf, 19.5),
        ("logit_opacities", 20, 20.5, 19.5),
        ("logit_opacities", -20, -np.inf, -19.5),
        ("log_scales", -20, -np.inf, -19.5),
        ("log_scales", -20, -20.5, -19.5),
    ):
        expected, clipped, within = (
            standardised_attributes(with_row(scene, field, value)) for value in (one, same, other)
        )
        np.testing.assert_array_equal(clipped, expected)
        assert not np.array_equal(within, expected)
    assert np.array_equal(
        np.argsort(standardised_attributes(scene)[3:6]), np.argsort(scene.sh[:, 0].T)
    )
    w = np.abs(np.asarray(scene.rotations)[:, 0])
    assert np.array_equal(np.argsort(standardised_attributes(scene)[10]), np.argsort(w))
