"""Mean-field smoothing: which Gaussians change and which do not."""

import numpy as np
import pytest

from gsc_jax.estimators.robust.mean_field import smooth

LINE = np.stack([np.arange(20.0), np.zeros(20), np.zeros(20)], axis=1)
ALL = np.ones(20, bool)


def log_odds(odd: float) -> np.ndarray:
    """Log odds of twenty Gaussians that are authentic rather than not, but for the odd one."""
    values = np.full(20, -2.0)
    values[10] = odd
    return values


def test_neighbours_change_uncertain_gaussians_only():
    assert smooth(log_odds(1.0), LINE, ALL, strength=5, neighbours=4)[10] < -2
    assert smooth(log_odds(9.0), LINE, ALL, strength=5, neighbours=4)[10] > 2


@pytest.mark.parametrize("sign", [-1, 1])
@pytest.mark.parametrize(("odds", "changes"), [(7.9, True), (8.1, False)])
def test_gaussians_beyond_the_reach_of_their_neighbours_are_not_updated(odds, changes, sign):
    values = sign * log_odds(odds)
    smoothed = smooth(values, LINE, ALL, strength=5, neighbours=4)
    assert (smoothed[10] == np.float32(values[10])) != changes


def test_strength_0_is_the_identity():
    unchanged = smooth(log_odds(1.0), LINE, ALL, strength=0, neighbours=4)
    assert np.array_equal(unchanged, log_odds(1.0))


def test_unseen_gaussians_get_and_send_no_message():
    seen = ALL.copy()
    seen[[8, 9, 11, 12]] = False
    values = log_odds(1.0)
    values[[8, 9, 11, 12]] = 3.5
    smoothed = smooth(values, LINE, seen, strength=5, neighbours=4)
    assert smoothed[10] < -2
    assert (smoothed[[8, 9, 11, 12]] == 3.5).all()


@pytest.mark.parametrize("others", [-50.0, 50.0])
def test_the_neighbours_together_contribute_the_strength(others):
    values = np.full(20, others)
    values[10] = 4
    smoothed = smooth(values, LINE, ALL, strength=5, neighbours=4)
    np.testing.assert_allclose(smoothed[10], 4 + np.sign(others) * 5, rtol=1e-6)


@pytest.mark.parametrize(("tampered", "message"), [(1, -2.5), (2, 0.0), (3, 2.5)])
def test_neighbours_of_both_kinds_are_weighed(tampered, message):
    values = np.full(20, -50.0)
    values[[8, 9, 11][:tampered]] = 50
    values[10] = 1
    smoothed = smooth(values, LINE, ALL, strength=5, neighbours=4)
    np.testing.assert_allclose(smoothed[10], 1 + message, rtol=1e-6)


def test_an_uncertain_neighbour_counts_by_how_certain_it_is():
    values = np.full(4, 100.0)
    values[[1, 2]] = 0.5, 0.25
    means = np.array([[0.0, 0, 0], [10, 0, 0], [11, 0, 0], [100, 0, 0]])
    smoothed = smooth(values, means, np.ones(4, bool), strength=1.5, neighbours=1)
    expected = np.array([0.5, 0.25])
    for _ in range(5):
        expected = np.array([0.5, 0.25]) + 1.5 * np.tanh(expected[::-1] / 2)
    np.testing.assert_allclose(smoothed[[1, 2]], expected, rtol=1e-5)


def test_with_too_few_gaussians_nothing_changes_and_the_input_never_does():
    values = log_odds(1.0)
    assert np.array_equal(smooth(values, LINE, ALL, strength=5, neighbours=20), values)
    smooth(values, LINE, ALL, strength=5, neighbours=4)
    assert np.array_equal(values, log_odds(1.0))
