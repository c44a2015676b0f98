"""Masks of labels: the absolute threshold, and the rule of the released code."""

import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from strategies import blobs, camera, floats

from gsc_jax.evidence.masks import Labelled, normalise, rendered_share, view_mask

CAMERA = camera(33, 17)
LEFT, RIGHT = [-0.5, 0, 2], [0.5, 0, 2]


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
    mask = view_mask(
        scene, CAMERA, Labelled(np.array([1.0, 0.0]), np.array([True, False])), rule=rule
    )
    assert mask[8, :16].any(), "the tampered Gaussian is invisible"
    assert not mask[8, 20:].any(), "the authentic Gaussian is in the mask"


def test_only_the_released_rule_ignores_occlusion():
    scene = blobs([[0, 0, 1], [0, 0, 1], [0, 0, 1], [0, 0, 3]], opacity=0.99, scale=0.5)
    labels = np.array([False, False, False, True])
    attribute = labels.astype(np.float32)
    assert view_mask(scene, CAMERA, Labelled(attribute, labels), rule="per-view").any()
    assert not view_mask(scene, CAMERA, Labelled(attribute, labels), rule="share").any()


def test_only_the_released_rule_lifts_noise_to_1_in_views_without_the_object():
    scene = blobs([RIGHT, LEFT], opacity=0.9)
    labels, attribute = np.array([True, True]), np.array([1.0, 0.005])
    right_is_outside = camera(16, 17, focal=20.0)
    K = np.array(right_is_outside.K)
    K[0, 2] = 16.5
    view = type(right_is_outside)(viewmat=right_is_outside.viewmat, K=K, width=16, height=17)
    assert view_mask(scene, view, Labelled(attribute, labels), rule="per-view").any()
    assert not view_mask(scene, view, Labelled(attribute, labels), rule="attribute").any()


@pytest.mark.usefixtures("nan_is_an_error")
@pytest.mark.parametrize("rule", ["share", "attribute", "per-view"])
def test_without_labels_the_mask_is_empty(rule):
    scene = blobs([LEFT])
    mask = view_mask(scene, CAMERA, Labelled(np.zeros(1), np.zeros(1, bool)), rule=rule)
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
