"""Mean-field smoothing: which Gaussians change and which do not."""

import numpy as np
import pytest
from scipy.special import softmax

from gsc_jax.estimators.robust.mean_field import smooth

LINE = np.stack([np.arange(20.0), np.zeros(20), np.zeros(20)], axis=1)
ALL = np.ones(20, bool)
TAMPERED = np.array([False, True])


def logits(logit: float, odd: int = 10) -> np.ndarray:
    """Logits of twenty Gaussians of class 0, one of which tends to class 1."""
    values = np.zeros((20, 2))
    values[:, 0] = 2.0
    values[odd] = [0, logit]
    return values


def test_neighbours_change_uncertain_gaussians_only():
    uncertain = smooth(logits(1.0), TAMPERED, LINE, ALL, strength=5, neighbours=4)
    assert uncertain[10, 0] > 0.9
    certain = smooth(logits(9.0), TAMPERED, LINE, ALL, strength=5, neighbours=4)
    assert certain[10, 1] > 0.9


@pytest.mark.parametrize(("logit", "changes"), [(7.9, True), (8.1, False)])
def test_gaussians_beyond_the_reach_of_their_neighbours_are_not_updated(logit, changes):
    values = logits(logit)
    smoothed = smooth(values, TAMPERED, LINE, ALL, strength=5, neighbours=4)
    assert np.array_equal(smoothed[10], softmax(values[10])) != changes


def test_strength_0_is_the_identity():
    unchanged = smooth(logits(1.0), TAMPERED, LINE, ALL, strength=0, neighbours=4)
    assert np.array_equal(unchanged, softmax(logits(1.0), axis=1))


def test_unseen_gaussians_send_no_message():
    seen = ALL.copy()
    seen[[8, 9, 11, 12]] = False
    values = logits(1.0)
    values[[8, 9, 11, 12]] = [0, 50]
    assert smooth(values, TAMPERED, LINE, seen, strength=5, neighbours=4)[10, 0] > 0.9


def test_the_neighbours_together_contribute_the_strength():
    values = np.tile([50.0, 0.0], (20, 1))
    values[10] = [0, 4]
    smoothed = smooth(values, TAMPERED, LINE, ALL, strength=5, neighbours=4)
    np.testing.assert_allclose(smoothed[10], softmax([5, 4]), rtol=1e-6)


@pytest.mark.parametrize("tampered", [[False, False], [True, True]])
def test_without_two_kinds_of_classes_or_enough_neighbours_nothing_changes(tampered):
    values = logits(1.0)
    expected = softmax(values, axis=1)
    of_one_kind = smooth(values, np.array(tampered), LINE, ALL, strength=5, neighbours=4)
    assert np.array_equal(of_one_kind, expected)
    alone = smooth(values, TAMPERED, LINE, ALL, strength=5, neighbours=20)
    assert np.array_equal(alone, expected)
