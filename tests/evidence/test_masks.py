"""Masks of labels: the absolute threshold, and the rule of the released code."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from strategies import blobs, camera, floats

from gsc_jax.evidence.masks import MIN_COVERAGE, Labelled, normalise, rendered_share, view_mask

CAMERA = camera(33, 17)
LEFT, RIGHT = [-0.5, 0, 2], [0.5, 0, 2]


def mask_of(scene, labels, rule, *, attribute=None, view=CAMERA) -> np.ndarray:
    labels = np.array(labels, bool)
    attribute = np.array(labels if attribute is None else attribute, np.float32)
    return view_mask(scene, view, Labelled(attribute, labels), rule=rule)


@given(floats(8, -20, 20))
def test_scores_lie_in_the_unit_interval_and_keep_the_order(attribute):
    scores = np.asarray(normalise(attribute))
    assert scores.min() >= 0
    assert scores.max() == pytest.approx(float(attribute.max() > 0))
    assert np.all(np.diff(scores[np.argsort(attribute)]) >= 0)


@pytest.mark.usefixtures("nan_is_an_error")
@pytest.mark.parametrize("attribute", [np.zeros(3), -np.ones(3), np.array([-2.0, -1, 0])])
def test_scores_without_a_positive_attribute_are_0(attribute):
    assert normalise(attribute.astype(np.float32)).tolist() == [0, 0, 0]


@pytest.mark.parametrize("rule", ["share", "attribute", "per-view"])
def test_the_mask_shows_the_tampered_gaussian_and_not_the_other(rule):
    scene = blobs([LEFT, RIGHT], opacity=0.9)
    mask = mask_of(scene, [True, False], rule)
    assert mask[8, :16].any(), "the tampered Gaussian is invisible"
    assert not mask[8, 20:].any(), "the authentic Gaussian is in the mask"


def test_only_the_released_rule_ignores_occlusion():
    scene = blobs([[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 3]], opacity=0.99, scale=0.5)
    assert mask_of(scene, [0, 0, 0, 1], "per-view").any()
    assert not mask_of(scene, [0, 0, 0, 1], "share").any()
    large, hidden = blobs([[0, 0, 3]], opacity=0.9, scale=0.5), blobs([LEFT, [0, 0, 3]], scale=0.5)
    hidden.log_scales[0] -= 1
    hidden.logit_opacities[:] = [5, large.logit_opacities[0]]
    alone = mask_of(large, [True], "per-view")
    assert alone.sum() > 50
    assert np.array_equal(mask_of(hidden, [False, True], "per-view"), alone)


def test_only_the_released_rule_lifts_noise_to_1_in_views_without_the_object():
    scene = blobs([RIGHT, LEFT], opacity=0.9)
    right_is_outside = dataclasses.replace(CAMERA, width=16)
    options = {"attribute": [1.0, 0.005], "view": right_is_outside}
    assert mask_of(scene, [True, True], "per-view", **options).any()
    assert not mask_of(scene, [True, True], "attribute", **options).any()


@pytest.mark.usefixtures("nan_is_an_error")
@pytest.mark.parametrize("rule", ["share", "attribute", "per-view"])
def test_without_labels_the_mask_is_empty(rule):
    mask = mask_of(blobs([LEFT]), [False], rule)
    assert mask.shape == (17, 33)
    assert mask.dtype == bool
    assert not mask.any()


@pytest.mark.usefixtures("nan_is_an_error")
def test_the_share_is_relative_to_alpha_and_0_on_empty_pixels():
    scene = blobs([LEFT, LEFT], opacity=0.5)
    share = rendered_share(scene, CAMERA, np.array([1.0, 0.0]))
    assert share[8, 11] == pytest.approx(1 / (1 + 0.5), rel=0.05)
    assert share[0, 32] == 0
    assert jnp.all(share <= 1 + 1e-6)


def test_a_pixel_exactly_at_the_threshold_is_not_in_the_mask():
    scene = blobs([LEFT, RIGHT], opacity=0.9)
    scores = Labelled(np.array([0.8, 0.3], np.float32), np.array([True, True]))
    share = rendered_share(scene, CAMERA, scores.tamper)
    threshold = float(share[8, 11])
    assert threshold > 0
    mask = view_mask(scene, CAMERA, scores, threshold=threshold)
    assert np.array_equal(mask, share > threshold)
    assert not mask[8, 11]


def test_a_pixel_with_little_alpha_has_no_share():
    alpha = float(np.float32(MIN_COVERAGE))
    for opacity, shown in ((0.5 * alpha, False), (1.5 * alpha, True)):
        share = rendered_share(blobs([LEFT], opacity=opacity), CAMERA, np.ones(1))
        assert share.max() == pytest.approx(float(shown), rel=1e-5)


def test_a_feature_may_be_negative():
    share = rendered_share(blobs([LEFT], opacity=0.9), CAMERA, np.full(1, -2))
    assert share.min() == pytest.approx(-2, rel=1e-5)
