"""Sampled Gaussians, views that contradict their classes, and false flags."""

import dataclasses

import numpy as np
import pytest

from gsc_jax.estimators.robust.class_roles import Roles, assign_roles
from gsc_jax.estimators.robust.gaussian_visibility import stratified_sample, visibility
from gsc_jax.estimators.robust.pattern_errors import authentic_flag_share, pattern_errors
from gsc_jax.evidence.lifting import Evidence


def test_a_sample_is_half_flagged_and_represents_all_visible_gaussians():
    seen, flagged = np.ones(1000), np.where(np.arange(1000) < 50, 1.0, 0.0)
    rows, represents = stratified_sample(seen, flagged, 100)
    assert len(rows) == 100
    assert 45 <= (rows < 50).sum() <= 60
    assert represents[rows < 50].max() < represents[rows >= 50].min()
    share = represents[rows < 50].sum() / represents.sum()
    assert share == pytest.approx(0.05, abs=0.01)
    unseen = np.where(np.arange(1000) < 900, 0.0, 1.0)
    rows, _ = stratified_sample(unseen, 0 * unseen, 200)
    assert sorted(rows) == list(range(900, 1000))
    faint, _ = stratified_sample(1e-9 * seen, 1e-9 * flagged, 100)
    assert 45 <= (faint < 50).sum() <= 60


def test_the_sample_is_the_same_in_any_order_of_the_file_where_most_shares_are_equal():
    rng = np.random.default_rng(0)
    seen = rng.uniform(0, 3, 1000)
    flagged = np.where(rng.uniform(size=1000) < 0.1, seen, 0.0)
    order = rng.permutation(1000)
    rows, represents = stratified_sample(seen, flagged, 100)
    permuted, again = stratified_sample(seen[order], flagged[order], 100)
    assert rows.tolist() == order[permuted].tolist()
    assert represents == pytest.approx(again)


def test_pattern_errors_count_views_that_contradict_a_pattern():
    total = np.array([[8.0, 8.0], [8.0, 0.0]], np.float32)
    evidence = Evidence(total=total, tampered=np.array([[8.0, 2.0], [0.0, 0.0]], np.float32))
    looked, flagged = visibility(evidence, slice(None), 8.0)
    assert looked.tolist() == [[0.5, 0.5], [0.5, 0.0]]
    assert flagged.tolist() == [[0.5, 0.125], [0.0, 0.0]]
    roles = assign_roles(np.array([[0.1, 0.1], [0.9, 0.9]]), np.array([[9.0, 9.0], [1.0, 1.0]]))
    assert roles is not None
    # A flag contradicts the authentic class, the lack of one contradicts the tampered class.
    false_alarms, misses = pattern_errors(roles, looked, flagged)
    assert false_alarms.T.tolist() == [[0.5, 0.0], [0.125, 0.0]]
    assert misses.T.tolist() == [[0.0, 0.5], [0.0, 0.375]]
    # Half of the share in the first of two views: nothing is flagged in the second one.
    assert authentic_flag_share(roles, looked, flagged, np.ones(2)) == 0.625 / 2
    assert authentic_flag_share(roles, looked, flagged, np.array([0, 1])) == 0.25 / 2


def test_pattern_errors_of_a_mixed_pattern_with_an_inverted_view():
    evidence = Evidence(
        total=np.full((2, 1), 8, np.float32), tampered=np.array([[2], [6]], np.float32)
    )
    roles = Roles(
        inverted=np.array([False, True]),
        patterns=np.array([[False, False], [True, False]]),
        unseen=np.zeros((2, 2), bool),
        tampered=np.array([False, True]),
        rates=np.zeros(2),
        seen=np.ones(2),
        missed=0.0,
    )
    seen, flagged = visibility(evidence, slice(None), 8.0)
    false_alarms, misses = pattern_errors(roles, seen, flagged)
    assert false_alarms.T.tolist() == [[0.25, 0.125]]
    assert misses.T.tolist() == [[0.0, 0.375]]
    assert authentic_flag_share(roles, seen, flagged, np.ones(1)) == 0.25
    elsewhere = dataclasses.replace(roles, unseen=np.array([[False, False], [False, True]]))
    false_alarms, misses = pattern_errors(elsewhere, seen, flagged)
    assert false_alarms.T.tolist() == [[0.25, 0.5]], "it is visible where its class is not"
    assert misses.T.tolist() == [[0.0, 0.375]]


@pytest.mark.parametrize("classes", [2, 3, 4])
def test_authentic_flag_share_of_a_sample(classes):
    """Each sampled Gaussian stands for several others, and some masks are inverted."""
    rng = np.random.default_rng(classes)
    seen = rng.random((7, 500))
    flagged = seen * rng.random(seen.shape)
    roles = Roles(
        inverted=rng.random(7) < 0.3,
        patterns=rng.random((classes, 7)) < 0.5,
        unseen=np.zeros((classes, 7), bool),
        tampered=np.arange(classes) == 1,
        rates=np.zeros(classes),
        seen=np.full(classes, 7.0),
        missed=0.0,
    )
    represents = rng.integers(1, 9, 500)
    turned = np.where(roles.inverted[:, None], seen - flagged, flagged)
    errors = [np.where(one[:, None], seen - turned, turned).sum(axis=0) for one in roles.patterns]
    authentic = np.repeat(np.argmin(errors, axis=0) != 1, represents)
    share = [
        np.repeat(flags, represents)[authentic].sum()
        / np.repeat(shown, represents)[authentic].sum()
        for flags, shown in zip(turned, seen, strict=True)
    ]
    found = authentic_flag_share(roles, seen, flagged, represents)
    assert found == pytest.approx(np.median(share), rel=1e-5)
