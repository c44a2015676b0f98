"""`robust` on evidence whose log odds are worked by hand; and its random starts.

Every view sees all Gaussians well, so that each view whose mask differs from the pattern of a class
counts `class_log_odds`, 3, against it; less for a flag where masks have many false alarms.
"""

import dataclasses

import numpy as np
import pytest
from failing_masks import ESTIMATOR
from scipy.special import logit

from gsc_jax.evidence.lifting import Evidence

VIEWS = 12
FLAGGED = np.zeros((4, VIEWS), bool)
"""Whether each view flags a group of Gaussians: authentic ones, the edit, and two authentic regions
that are flagged in nearly the same views."""
FLAGGED[1] = FLAGGED[2, :7] = FLAGGED[3, [0, 1, 2, 3, 4, 5, 7]] = True
KINDS = np.repeat(np.arange(4), [1200, 40, 20, 20])
AUTHENTIC, EDIT = (np.flatnonzero(kind == KINDS) for kind in (0, 1))
FOUR_CLASSES = dataclasses.replace(ESTIMATOR, classes=(4,), restarts=32)
"""Finds these four classes; with more, a single odd Gaussian would be a class of its own."""
ODD = np.array([200.0, 0, 0])
"""Position of the odd Gaussian, far from all others."""


def log_odds_of_one(
    share: list[float],
    *,
    smoothing: float = 0.0,
    near: np.ndarray = KINDS[:0],
    false_alarms: float = 0.0,
) -> float:
    """Log odds that one Gaussian is edited, whose weight is in the masks to these shares by view.

    The Gaussians `near` it, at distances of 1, 2, ..., have a class; all others are far away. The
    masks have a share of `false_alarms` of each authentic Gaussian.
    """
    shares = np.vstack([FLAGGED[KINDS].astype(float), share])
    shares[AUTHENTIC] = false_alarms
    total = np.full(shares.T.shape, 1e6, np.float32)
    means = np.random.default_rng(0).normal(size=(len(shares), 3))
    means[-1] = ODD
    means[near] = ODD + np.outer(np.arange(1, len(near) + 1), [0, 1, 0])
    estimator = dataclasses.replace(FOUR_CLASSES, smoothing=smoothing)
    found = estimator.from_masks(
        Evidence(total=total, tampered=(total * shares.T).astype(np.float32)), means
    )
    assert found.roles is not None
    assert found.roles.tampered.tolist() == [False, True, False, False]
    return float(logit(found.probability[-1].astype(np.float64)))


@pytest.mark.parametrize(("last", "views"), [(0.0, -1), (0.25, -0.5), (0.75, 0.5), (1.0, 1)])
def test_log_odds_are_3_for_each_view_that_separates_two_classes(last, views):
    """Half of the masks between distractor and edit: the views 7 to 9, and a share of view 10."""
    share = [1.0] * 7 + [1, 1, 0, last, 0]
    distance_to_edit, distance_to_distractor = 3 - last, 2 + last
    assert views == distance_to_distractor - distance_to_edit
    assert log_odds_of_one(share) == pytest.approx(3 * views, abs=0.01)


def test_of_similar_distractors_only_the_better_one_counts_against_an_edit():
    """The edit differs by 2.45 views, each of both distractors by 2.55: together they would win."""
    share = [1.0] * 8 + [1, 0.55, 0, 0]
    assert log_odds_of_one(share) == pytest.approx(3 * 0.1, abs=0.01)


@pytest.mark.parametrize("of_the_edit", range(9))
def test_eight_neighbours_share_the_log_odds_of_smoothing(of_the_edit):
    """The odd Gaussian differs by 5.75 views from the edit, by 6.25 from what is authentic."""
    share = [1.0, 1, 0.25] + [0.0] * 5 + [1.0] * 4
    near = np.concatenate([EDIT[:of_the_edit], AUTHENTIC[: 20 - of_the_edit]])
    message = 5 * (of_the_edit - (8 - of_the_edit)) / 8
    found = log_odds_of_one(share, smoothing=5, near=near)
    assert found == pytest.approx(1.5 + message, abs=0.01)


@pytest.mark.parametrize("views", [7, 8])
@pytest.mark.parametrize("false_alarms", [0.02, 0.05, 0.2])
def test_a_flag_counts_less_where_masks_have_many_false_alarms(views, false_alarms):
    """The log odds of 3 allow for false alarms in 1 / (1 + e^3), 4.7 %, of the authentic views."""
    decoys = 2 * 20 * 7
    rate = (1200 * 12 * false_alarms + decoys) / (1240 * 12)
    of_a_flag = 3 - max(np.log(rate * (1 + np.exp(3))), 0)
    assert (of_a_flag < 3) == (false_alarms > 0.03)
    found = log_odds_of_one([0.0] * (12 - views) + [1.0] * views, false_alarms=false_alarms)
    assert found == pytest.approx(of_a_flag * views - 3 * (12 - views), abs=0.02)


def test_another_seed_gives_other_starts():
    """Of masks that are noise, EM finds other classes from another start."""
    rng = np.random.default_rng(0)
    total = np.full((VIEWS, len(KINDS) + 1), 1e6, np.float32)
    noise = Evidence(total=total, tampered=total * rng.random(total.shape, np.float32))
    one_start = dataclasses.replace(FOUR_CLASSES, restarts=1)
    estimators = [dataclasses.replace(one_start, seed=seed) for seed in (0, 0, 1)]
    means = np.zeros((len(KINDS) + 1, 3))
    one, same, other = (each.from_masks(noise, means).probability for each in estimators)
    np.testing.assert_array_equal(one, same)
    assert np.abs(logit(one) - logit(other)).max() > 1
