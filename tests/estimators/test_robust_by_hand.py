"""`robust` on small evidence for which the log odds can be calculated by hand, and its seed.

Every view sees all Gaussians well, so that each view whose mask differs from the pattern of a class
counts `class_log_odds`, 3, against it; less for a flag where masks have many false alarms.
"""

import dataclasses
import itertools
from typing import Any

import numpy as np
import pytest
from failing_masks import ESTIMATOR
from scipy.special import logit

from gsc_jax.estimators.robust import estimator, gaussian_visibility
from gsc_jax.estimators.robust.class_roles import Roles, assign_roles
from gsc_jax.estimators.robust.estimator import RobustEstimator
from gsc_jax.estimators.robust.gaussian_visibility import visibility
from gsc_jax.estimators.robust.pattern_errors import error_weight
from gsc_jax.evidence.lifting import Evidence

VIEWS = 12
FLAGGED = np.zeros((4, VIEWS), bool)
"""Whether each view flags a group of Gaussians: authentic ones, the edit, and two authentic regions
that are flagged in nearly the same views."""
FLAGGED[1] = FLAGGED[2, :7] = FLAGGED[3, [0, 1, 2, 3, 4, 5, 7]] = True
KINDS = np.repeat(np.arange(4), [1200, 40, 20, 20])
DECOYS_OF_A_VIEW = 30
"""Of the 40 Gaussians in the two authentic regions, 6 views flag 40, 2 views 20, 4 views none: the
median over the views."""
AUTHENTIC, EDIT = (np.flatnonzero(kind == KINDS) for kind in (0, 1))
FOUR_CLASSES = dataclasses.replace(ESTIMATOR, classes=(4,), restarts=32)
"""EM finds these four classes; with more, a single odd Gaussian would be a class of its own."""

ODD = np.array([200.0, 0, 0])
"""Position of the odd Gaussian, far from all others."""
ALL_GROUPS = ((0, 1, 2, 3),)
"""One fit, whose classes are the groups."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class WithRoles(RobustEstimator):
    """`robust` with the fits given.

    `fits` are the groups that are the classes of each, what is authentic first, then the edit;
    `turned` is the number of views that are inverted, which are the first ones, and `missed` the
    share of what the edit shows that is clear in views that flag it.
    """

    fits: tuple[tuple[int, ...], ...] = ALL_GROUPS
    turned: int = 0
    missed: float = 0.0

    def _roles_by_fit(
        self, seen: object, flagged: object, represents: object, parts: object
    ) -> list[Roles]:
        del seen, flagged, represents, parts
        return [
            Roles(
                inverted=np.arange(VIEWS) < self.turned,
                patterns=FLAGGED[list(groups)],
                unseen=np.zeros((len(groups), VIEWS), bool),
                tampered=np.arange(len(groups)) == 1,
                rates=FLAGGED[list(groups)].mean(axis=1),
                seen=np.full(len(groups), float(VIEWS)),
                missed=self.missed,
            )
            for groups in self.fits
        ]


def log_odds_of_one(
    share: list[float],
    *,
    smoothing: float = 0.0,
    near: np.ndarray = KINDS[:0],
    false_alarms: float = 0.0,
    inverted: int = 0,
    missed: float = 0.0,
    fits: tuple[tuple[int, ...], ...] = ALL_GROUPS,
) -> float:
    """Log odds that one Gaussian is edited, whose weight is in the masks to these shares by view.

    The Gaussians `near` it, at distances of 1, 2, ..., have a class; all others are far away. The
    masks have a share of `false_alarms` of each authentic Gaussian; the first ones are `inverted`;
    a share of the edit is `missed`.
    """
    shares = np.vstack([FLAGGED[KINDS].astype(float), share])
    shares[AUTHENTIC] = false_alarms
    shares[:, :inverted] = 1 - shares[:, :inverted]
    total = np.full(shares.T.shape, 1e6, np.float32)
    means = np.random.default_rng(0).normal(size=(len(shares), 3))
    means[-1] = ODD
    means[near] = ODD + np.outer(np.arange(1, len(near) + 1), [0, 1, 0])
    found = WithRoles(smoothing=smoothing, fits=fits, turned=inverted, missed=missed).from_masks(
        Evidence(total=total, tampered=(total * shares.T).astype(np.float32)), means
    )
    return float(logit(found.probability[-1].astype(np.float64)))


@pytest.mark.parametrize(("last", "views"), [(0.0, -1), (0.25, -0.5), (0.75, 0.5), (1.0, 1)])
def test_log_odds_are_3_for_each_view_that_separates_two_classes(last, views):
    """Half of the masks between distractor and edit: the views 7 to 9, and a share of view 10."""
    share = [1.0] * 7 + [1, 1, 0, last, 0]
    distance_to_edit, distance_to_distractor = 3 - last, 2 + last
    assert views == distance_to_distractor - distance_to_edit
    assert log_odds_of_one(share) == pytest.approx(3 * views, abs=0.01)


def test_what_differs_from_two_classes_alike_is_authentic():
    assert log_odds_of_one([0.5] * VIEWS, fits=((0, 1),)) == pytest.approx(-0.001, abs=5e-4)


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


GROUPS = Evidence(
    total=np.full((VIEWS, len(KINDS)), 1e6, np.float32),
    tampered=(1e6 * FLAGGED[KINDS].T).astype(np.float32),
)
"""Masks that flag the groups without an error."""
ONE_PART = [np.arange(len(KINDS))]
EVERYTHING = *visibility(GROUPS, slice(None), 8.0), np.ones(len(KINDS), np.float32), ONE_PART


def test_em_finds_the_given_roles():
    best, given = (each._roles_by_fit(*EVERYTHING)[0] for each in (FOUR_CLASSES, WithRoles()))
    assert best.tampered.tolist() == given.tampered.tolist()
    assert sorted(best.patterns.tolist()) == sorted(given.patterns.tolist())
    np.testing.assert_allclose(best.rate, given.rate, atol=0.01)


@pytest.mark.parametrize(("restarts", "fits"), [(1, 1), (2, 3), (3, 3), (4, 5), (5, 5), (8, 9)])
def test_the_better_half_of_the_fits_decides_and_is_odd(restarts, fits):
    """EM starts `restarts` times with 4 classes and as often with 8: all these are fits."""
    assert len(dataclasses.replace(ESTIMATOR, restarts=restarts)._roles_by_fit(*EVERYTHING)) == fits


@pytest.mark.parametrize(("left_out", "fits"), [(0, 9), (11, 3), (14, 1), (16, 0)])
def test_fits_of_one_class_are_left_out(left_out, fits, monkeypatch):
    calls = itertools.count()

    def roles_of_some(*args: Any, **options: Any) -> Roles | None:
        return None if next(calls) < left_out else assign_roles(*args, **options)

    monkeypatch.setattr(estimator, "assign_roles", roles_of_some)
    assert len(ESTIMATOR._roles_by_fit(*EVERYTHING)) == fits


@pytest.mark.parametrize("edit", [1, 2])
def test_what_most_fits_say_is_labelled_and_a_fit_that_agrees_is_reported(edit):
    """Three of five fits take one region for the edit, two another one; distractors are none."""
    fits = ((0, 3 - edit), (0, edit, 3), (0, 3 - edit), (0, edit, 3), (0, edit, 3))
    found = WithRoles(fits=fits, smoothing=0.0).from_masks(GROUPS, np.zeros((len(KINDS), 3)))
    assert found.roles is not None
    assert found.roles.patterns.tolist() == FLAGGED[[0, edit, 3]].tolist()
    labelled = found.probability > 0.5
    assert labelled[edit == KINDS].all()
    assert not labelled[KINDS == 0].any()
    np.testing.assert_array_equal(found.roles.tampered[found.region], labelled)
    np.testing.assert_array_equal(found.region[KINDS == 0], 0)


def test_the_size_of_the_blocks_does_not_matter(monkeypatch):
    robust, means = WithRoles(fits=((0, 1), (0, 1, 2), (0, 1, 2, 3))), np.zeros((len(KINDS), 3))
    whole = robust.from_masks(GROUPS, means)
    monkeypatch.setattr(gaussian_visibility, "BLOCK", 100)  # the last block has 80
    parts = robust.from_masks(GROUPS, means)
    np.testing.assert_allclose(parts.probability, whole.probability, atol=1e-6)
    np.testing.assert_array_equal(parts.region, whole.region)


@pytest.mark.parametrize(("with_distractor", "log_odds"), [(0, 12), (1, 12), (2, 1.5), (3, -9)])
def test_the_median_of_several_fits_counts(with_distractor, log_odds):
    """Four fits: all have the edit, some a distractor, whose pattern is nearer to the Gaussian.

    The Gaussian differs in 1 view from it, in 4 from the edit, in 8 from what is authentic.
    """
    share = [1.0] * 8 + [0.0] * 4
    fits = ((0, 1),) * (4 - with_distractor) + ((0, 1, 2),) * with_distractor
    assert log_odds_of_one(share, fits=fits) == pytest.approx(log_odds, abs=0.01)


@pytest.mark.parametrize("inverted", [0, 4])
@pytest.mark.parametrize("views", [7, 8])
@pytest.mark.parametrize("false_alarms", [0.02, 0.05, 0.2])
def test_a_flag_counts_less_where_masks_have_many_false_alarms(views, false_alarms, inverted):
    """A flag counts 3 until masks flag more than 1 / (1 + e^3) = 4.7 % of what is authentic."""
    rate = (1200 * false_alarms + DECOYS_OF_A_VIEW) / 1240
    of_a_flag = 3 - max(np.log(rate * (1 + np.exp(3))), 0)
    assert (of_a_flag < 3) == (false_alarms > 0.03)
    share = [0.0] * (12 - views) + [1.0] * views
    found = log_odds_of_one(share, false_alarms=false_alarms, inverted=inverted)
    assert found == pytest.approx(of_a_flag * views - 3 * (12 - views), abs=0.02)


def test_a_flag_counts_less_against_distractors_too():
    """Two views flag what they should not if it is a distractor; three miss it if it is edited."""
    share = [1.0] * 8 + [1, 0, 0, 0]
    rate = (1200 * 0.2 + DECOYS_OF_A_VIEW) / 1240
    of_a_flag = 3 - np.log(rate * (1 + np.exp(3)))
    flags, misses = 2, 3
    found = log_odds_of_one(share, false_alarms=0.2)
    assert found == pytest.approx(of_a_flag * flags - 3 * misses, abs=0.02)


def test_a_miss_counts_less_if_masks_miss_parts_of_the_edit():
    """If the Gaussian is edited, the masks of five views miss it.

    By the pattern of the nearest distractor, three views miss it and three flag it wrongly.
    """
    share = [1.0] * 4 + [0.0] * 5 + [1.0] * 3
    assert log_odds_of_one(share) == pytest.approx(3, abs=0.01)
    of_a_miss = 3 - np.log(0.2 * (1 + np.exp(3)))
    found = log_odds_of_one(share, missed=0.2)
    assert found == pytest.approx(3 * 3 + 3 * of_a_miss - 5 * of_a_miss, abs=0.01)


@pytest.mark.parametrize("log_odds", [1e-9, 0.5, 3, 40, 1e9])
def test_weight_of_an_error(log_odds):
    error = np.exp(-np.logaddexp(0, log_odds))
    assert error_weight(log_odds, 0.0) == pytest.approx(min(log_odds, 300 * np.log(10)))
    assert error_weight(log_odds, error / 2) == pytest.approx(error_weight(log_odds, 0.0))
    for rate in (0.1, 0.3, 0.5):
        weight = min(log_odds, np.log((1 - error) / rate))
        assert error_weight(log_odds, rate) == pytest.approx(weight)
    assert error_weight(log_odds, 0.9) == error_weight(log_odds, 0.5) > 0


@pytest.mark.parametrize("log_odds", [0.5, 3, 1e3, 1e9])
def test_any_log_odds_label_an_edit_that_all_masks_show(log_odds):
    robust = dataclasses.replace(FOUR_CLASSES, class_log_odds=log_odds)
    found = robust.from_masks(GROUPS, np.random.default_rng(0).normal(size=(len(KINDS), 3)))
    np.testing.assert_array_equal(found.probability > 0.5, KINDS == 1)


def test_another_seed_gives_other_starts():
    """Of masks that are noise, EM finds other classes from another start."""
    rng = np.random.default_rng(0)
    total = np.full((VIEWS, len(KINDS) + 1), 1e6, np.float32)
    noise = Evidence(total=total, tampered=total * rng.random(total.shape, np.float32))
    one_start = dataclasses.replace(FOUR_CLASSES, restarts=1)
    estimators = [dataclasses.replace(one_start, seed=seed) for seed in (0, 0, 1)]
    means = np.zeros((len(KINDS) + 1, 3))
    one, same, other = (each.from_masks(noise, means) for each in estimators)
    np.testing.assert_array_equal(one.probability, same.probability)
    assert one.roles is not None
    assert other.roles is not None
    assert one.roles.inverted.tolist() != other.roles.inverted.tolist()
