import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.special import logit
from strategies import blobs, camera

from gsc_jax.benchmark import metrics

PREDICTION = np.array([[1, 1, 0], [1, 0, 0]], bool)
TRUTH = np.array([[1, 0, 0], [1, 1, 1]], bool)
MASKS = arrays(bool, (4, 5))


def test_worked_by_hand():
    # tp 2, fp 1, fn 2, tn 1: precision 2/3, recall 1/2.
    counts = metrics.confusion(PREDICTION, TRUTH)
    assert counts == (2, 1, 2, 1)
    assert counts.precision == pytest.approx(2 / 3, abs=1e-7)
    assert counts.recall == pytest.approx(1 / 2, abs=1e-7)
    assert metrics.confusion(PREDICTION, TRUTH).f1 == pytest.approx(4 / 7, abs=1e-7)
    assert counts.iou == pytest.approx(2 / 5, abs=1e-7)


def test_threshold_is_strict():
    assert metrics.confusion(np.array([0.5, 0.51]), np.array([1.0, 1.0])) == (1, 0, 1, 0)


@given(MASKS, MASKS)
@settings(max_examples=60, deadline=None)
def test_laws_of_f1_and_iou(prediction, truth):
    f1, iou = metrics.confusion(prediction, truth).f1, metrics.confusion(prediction, truth).iou
    assert 0 <= iou <= f1 + 1e-7
    assert f1 <= 1
    assert f1 == pytest.approx(2 * iou / (1 + iou), abs=1e-6)
    assert f1 == pytest.approx(metrics.confusion(truth, prediction).f1, abs=1e-7)
    counts = metrics.confusion(prediction, truth)
    assert sum(counts) == truth.size
    assert metrics.confusion(~prediction, ~truth) == counts[::-1]
    assert metrics.confusion(truth, truth).f1 == pytest.approx(float(truth.any()), abs=1e-6)


def test_authentic_views_do_not_enter_the_mean():
    nothing = np.zeros((3, 3), bool)
    predictions = [PREDICTION, ~nothing, TRUTH]
    scores = metrics.mean_over_tampered_views(predictions, [TRUTH, nothing, TRUTH])
    assert scores.views.tolist() == [0, 2]
    np.testing.assert_allclose(scores.per_view["f1"], [4 / 7, 1], atol=1e-6)
    assert scores.f1 == pytest.approx((4 / 7 + 1) / 2, abs=1e-6)
    assert scores.iou == pytest.approx((2 / 5 + 1) / 2, abs=1e-6)
    assert scores.precision == pytest.approx((2 / 3 + 1) / 2, abs=1e-6)
    assert scores.recall == pytest.approx((1 / 2 + 1) / 2, abs=1e-6)


def test_without_tampered_views_the_means_are_nan():
    scores = metrics.mean_over_tampered_views([PREDICTION], [np.zeros((2, 3), bool)])
    assert scores.views.size == 0
    assert np.isnan([scores.f1, scores.iou, scores.precision, scores.recall]).all()


@given(
    arrays(np.int64, 12, elements=st.integers(0, 3)),
    arrays(bool, 12).filter(lambda truth: 0 < truth.sum() < 12),
)
@settings(max_examples=60, deadline=None)
def test_auc_counts_the_pairs_in_order_and_half_the_ties(scores, truth):
    high, low = scores[truth][:, None], scores[~truth]
    expected = np.mean((high > low) + 0.5 * (high == low))
    assert metrics.auc(scores, truth) == pytest.approx(expected)
    assert metrics.auc(-scores, truth) == pytest.approx(1 - expected)
    assert metrics.auc(np.exp(scores), truth) == pytest.approx(expected)


def test_auc_of_constant_scores_and_of_one_kind():
    assert metrics.auc(np.zeros(4), np.array([1, 0, 0, 1])) == 0.5
    assert np.isnan(metrics.auc(np.arange(3), np.ones(3, bool)))
    with pytest.raises(ValueError, match="1 of 2 scores are NaN"):
        metrics.auc(np.array([np.nan, 1.0]), np.array([True, False]))


def test_shapes_that_differ_are_refused():
    with pytest.raises(ValueError, match=r"prediction has shape \(2, 3\), but truth \(3, 2\)"):
        metrics.confusion(PREDICTION, TRUTH.T)
    with pytest.raises(ValueError, match="6 scores, but 2 truths"):
        metrics.auc(PREDICTION, np.array([True, False]))


def balls(depths, opacities):
    scene = blobs([[0, 0, depth] for depth in depths], scale=0.2)
    logits = logit(np.array(opacities)).astype(np.float32)
    return dataclasses.replace(scene, logit_opacities=logits)


CAMERA = camera(32, 24, focal=32.0)


@pytest.mark.parametrize(
    ("opacities", "labels", "expected"),
    [
        ([0.9, 0.9], [True, False], True),  # in front of an authentic one
        ([0.9, 0.9], [False, True], False),  # hidden behind it
        ([0.2, 0.9], [False, True], True),  # seen through it
        ([0.05, 0.03], [True, True], False),  # alpha <= 0.1
    ],
)
def test_true_masks_follow_the_majority_of_the_blending_weight(opacities, labels, expected):
    mask = metrics.truth_mask(balls([2.0, 4.0], opacities), CAMERA, np.array(labels))
    assert mask.shape == (24, 32)
    assert mask.dtype == bool
    assert mask[12, 16] == expected
    assert not mask[0, 0]
