"""Neighbours: whom they persuade, whom they do not, and who is not asked."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from gsc_jax.estimators.robust.mean_field import smoothed, softmax
from gsc_jax.scene.neighbours import nearest_neighbours

LINE = np.stack([np.arange(20.0), np.zeros(20), np.zeros(20)], axis=1)
EVERYBODY = np.ones(20, bool)
KINDS = np.array([False, True])


def logits(doubts: float, odd: int = 10) -> np.ndarray:
    """Twenty Gaussians that are of class 0, one of which leans to class 1."""
    values = np.zeros((20, 2))
    values[:, 0] = 2.0
    values[odd] = [0, doubts]
    return values


def test_neighbours_persuade_the_doubtful_and_not_the_certain():
    doubtful = smoothed(logits(1.0), KINDS, LINE, EVERYBODY, strength=5, neighbours=4)
    assert doubtful[10, 0] > 0.9
    certain = smoothed(logits(9.0), KINDS, LINE, EVERYBODY, strength=5, neighbours=4)
    assert certain[10, 1] > 0.9


def test_without_strength_nobody_is_asked():
    values = logits(1.0)
    assert np.array_equal(
        smoothed(values, KINDS, LINE, EVERYBODY, strength=0, neighbours=4), softmax(values)
    )


def test_the_unseen_have_no_opinion():
    seen = EVERYBODY.copy()
    seen[[8, 9, 11, 12]] = False
    values = logits(1.0)
    values[[8, 9, 11, 12]] = [0, 50]
    assert smoothed(values, KINDS, LINE, seen, strength=5, neighbours=4)[10, 0] > 0.9


@given(st.integers(0, 1000), st.sampled_from([1e-6, 1.0, 1e6]))
def test_neighbours_are_the_nearest_others(seed, scale):
    points = np.random.default_rng(seed).normal(size=(30, 3)) * scale
    found = nearest_neighbours(points, np.arange(30), 5)
    distance = np.linalg.norm(points[:, None] - points, axis=-1)
    np.fill_diagonal(distance, np.inf)
    expected = np.sort(distance, axis=1)[:, :5]
    np.testing.assert_allclose(np.take_along_axis(distance, found, 1), expected)


def test_gaussians_in_one_place_have_each_other():
    found = nearest_neighbours(np.zeros((12, 3)), np.arange(12), 4)
    assert found.shape == (12, 4)
    assert all(k not in row and len(set(row)) == 4 for k, row in enumerate(found))
