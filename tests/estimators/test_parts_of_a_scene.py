"""`robust` on a street along which the cameras move, so that a view shows a tenth of the scene."""

import dataclasses

import numpy as np
import pytest

from gsc_jax.estimators import RobustEstimator
from gsc_jax.estimators.protocol import outcome
from gsc_jax.estimators.robust.class_roles import assign_roles
from gsc_jax.estimators.robust.gaussian_visibility import covisible_parts
from gsc_jax.evidence.lifting import Evidence

COUNT, VIEWS = 4000, 48
ESTIMATOR, UNDIVIDED = RobustEstimator(), RobustEstimator(covisibility=0.0)
RNG = np.random.default_rng(0)
MEANS = np.column_stack([np.sort(RNG.random(COUNT)), 0.01 * RNG.normal(size=(COUNT, 2))])
ALONG = MEANS[:, 0]
EDIT = (ALONG >= 0.5) & (ALONG < 0.52)
LOW, HIGH = 0.05, 0.95


def windows(width: float) -> np.ndarray:
    """Which Gaussians each view shows, (VIEWS, COUNT) bool: those along a part of the street."""
    start = np.linspace(0, 1 - width, VIEWS)[:, None]
    return (start <= ALONG) & (start + width > ALONG)


def masked(seed: int, edit: np.ndarray = EDIT) -> Evidence:
    """Masks that miss the edit in a fifth of the views and flag something else in each."""
    rng, shown = np.random.default_rng(seed), windows(0.1)
    places = np.array([rng.choice(ALONG[row]) for row in shown])[:, None]
    flagged = (rng.random((VIEWS, 1)) > 0.2) & edit | (abs(ALONG - places) < 0.003)
    total = np.where(shown, np.float32(100), np.float32(0))
    return Evidence(total=total, tampered=total * flagged)


def f1(labels: np.ndarray) -> float:
    return 2 * (labels & EDIT).sum() / (labels.sum() + EDIT.sum())


@pytest.mark.parametrize("seed", [1, 2, 4, 7])
def test_an_edit_is_found_where_each_view_shows_a_tenth_of_the_scene(seed):
    found, whole = (e.estimate_from_evidence(masked(seed), MEANS) for e in (ESTIMATOR, UNDIVIDED))
    assert f1(found.labels) > 0.8
    assert f1(whole.labels) < 0.1


def test_false_alarms_that_agree_by_chance_in_one_of_many_parts_are_seldom_evidence():
    authentic = (masked(seed, EDIT & False) for seed in range(12))
    verdicts = [ESTIMATOR.estimate_from_evidence(masks, MEANS).verdict for masks in authentic]
    outcomes = [outcome(verdict) for verdict in verdicts]
    assert outcomes.count("none") >= 9
    assert "evidence" not in outcomes


@pytest.mark.parametrize(("width", "parts"), [(1.0, 1), (0.6, 1), (0.3, 4), (0.1, 8)])
def test_parts_are_small_enough_that_a_view_shows_most_of_one(width, parts):
    shown = windows(width).astype(np.float32)
    found = covisible_parts(shown, np.ones(COUNT), MEANS, 0.45)
    assert len(found) == parts
    assert sorted(np.concatenate(found)) == list(range(COUNT))
    assert all((np.diff(rows) > 0).all() for rows in found), "their order is no matter of the CPU"
    assert all(np.ptp(ALONG[rows]) < 1.2 / parts for rows in found)
    assert len(covisible_parts(shown, np.ones(COUNT), MEANS, 0.0)) == 1


@pytest.mark.parametrize("axes", [1, 2, 3, 5])
def test_parts_of_positions_of_any_dimension_and_small_samples(axes):
    means = np.pad(MEANS, ((0, 0), (0, 2)))[:, :axes]
    means[7] = np.nan
    shown = windows(0.1).astype(np.float32)
    assert len(covisible_parts(shown, np.ones(COUNT), means, 0.45)) == 8
    odd = slice(3987)
    assert {
        len(rows) for rows in covisible_parts(shown[:, odd], np.ones(3987), means[odd], 0.45)
    } == {3987 // 8}
    few = slice(None, None, 20)  # 200 Gaussians: too few for two parts
    assert len(covisible_parts(shown[:, few], np.ones(200), means[few], 0.45)) == 1


def test_each_part_has_something_authentic():
    """Three views show one part, three the other; in each, masks flag one of two classes."""
    weights = np.repeat([[100.0, 0], [10, 0], [0, 80], [0, 8]], 3, axis=1)
    rates = np.repeat([[LOW, 0.5], [HIGH, 0.5], [0.5, LOW], [0.5, HIGH]], 3, axis=1)
    part = np.array([0, 0, 1, 1])
    roles = assign_roles(rates, weights, part)
    assert roles is not None
    assert not roles.patterns[0].any()
    assert (roles.patterns & ~roles.unseen)[roles.tampered].sum(axis=1).tolist() == [3, 3]
    assert roles.unseen[roles.tampered].sum(axis=1).tolist() == [3, 3]
    turned = np.where(np.arange(6) == 4, 1 - rates, rates)
    roles = assign_roles(turned, weights, part)
    assert roles is not None
    assert roles.inverted.tolist() == [False] * 4 + [True, False]
    assert (roles.patterns & ~roles.unseen)[roles.tampered].sum(axis=1).tolist() == [3, 3]


def test_what_no_view_shows_together_is_compared_within_a_part_only():
    """One of two parts of a scene has two edits, which outweigh what is authentic there."""
    weights = np.repeat([[100.0, 0], [0, 10], [0, 9], [0, 9]], 4, axis=1)
    flagged = np.zeros((4, 8), bool)
    flagged[2, 4:7] = flagged[3, 5:] = True
    roles = assign_roles(np.where(flagged, HIGH, LOW), weights, np.array([0, 1, 1, 1]))
    assert roles is not None
    assert not roles.inverted.any()
    assert not roles.patterns[0].any()


def test_a_part_that_shows_little_but_the_edit_has_no_authentic_class():
    weights = np.array([[100.0] * 4, [20] * 4, [1] * 4])
    rates = np.array([[LOW] * 4, [HIGH] * 4, [LOW] * 4])
    roles = assign_roles(rates, weights, np.array([0, 1, 1]))
    assert roles is not None
    assert not roles.patterns[0].any()
    assert roles.patterns[roles.tampered].tolist() == [[True] * 4]


def test_the_odds_of_a_scene_fall_with_the_root_of_the_number_of_its_parts():
    roles = assign_roles(np.array([[LOW] * 4, [HIGH] * 4]), np.array([[9.0] * 4, [1] * 4]))
    assert roles is not None
    one, many = (dataclasses.replace(roles, parts=n).scene_probability for n in (1, 16))
    assert many / (1 - many) == pytest.approx(one / (1 - one) / 4)
