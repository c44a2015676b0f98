"""Sampled Gaussians, and their distances from the patterns of classes, by what views show."""

import numpy as np
import pytest

from gsc_jax.estimators.robust.class_roles import Roles, assign_roles
from gsc_jax.estimators.robust.estimator import false_alarm_rates, pattern_errors
from gsc_jax.estimators.robust.gaussian_visibility import stratified_sample, visibility
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


def test_pattern_errors_count_views_that_contradict_a_pattern():
    total = np.array([[8.0, 8.0], [8.0, 0.0]], np.float32)
    evidence = Evidence(total=total, tampered=np.array([[8.0, 2.0], [0.0, 0.0]], np.float32))
    looked, flagged = visibility(evidence, slice(None), 8.0)
    assert looked.tolist() == [[0.5, 0.5], [0.5, 0.0]]
    assert flagged.tolist() == [[0.5, 0.125], [0.0, 0.0]]
    roles = assign_roles(np.array([[0.1, 0.1], [0.9, 0.9]]), np.array([[9.0, 9.0], [1.0, 1.0]]))
    assert roles is not None
    # A flag contradicts the authentic class, the lack of one contradicts the tampered class.
    false_alarms, misses = pattern_errors(looked, flagged, roles)
    [rates] = false_alarm_rates(evidence, [roles], 8.0)
    assert false_alarms.T.tolist() == [[0.5, 0.0], [0.125, 0.0]]
    assert misses.T.tolist() == [[0.0, 0.5], [0.0, 0.375]]
    assert rates.tolist() == [0.625, 0.0], "the first one is as near to either class"


def test_pattern_errors_of_a_mixed_pattern_with_an_inverted_view():
    evidence = Evidence(
        total=np.full((2, 1), 8, np.float32), tampered=np.array([[2], [6]], np.float32)
    )
    roles = Roles(
        inverted=np.array([False, True]),
        patterns=np.array([[False, False], [True, False]]),
        tampered=np.array([False, True]),
        rates=np.zeros(2),
        seen=np.ones(2),
    )
    false_alarms, misses = pattern_errors(*visibility(evidence, slice(None), 8.0), roles)
    [rates] = false_alarm_rates(evidence, [roles], 8.0)
    assert false_alarms.T.tolist() == [[0.25, 0.125]]
    assert misses.T.tolist() == [[0.0, 0.375]]
    assert rates.tolist() == [0.25, 0.25]


def test_false_alarm_rates_of_several_fits_are_those_of_each():
    """Fits of other numbers of classes and other inverted views, over several blocks."""
    rng = np.random.default_rng(0)
    total = rng.exponential(8, (6, 70_000)).astype(np.float32)
    evidence = Evidence(total=total, tampered=total * rng.random(total.shape, np.float32))
    fits = [
        Roles(
            inverted=rng.random(6) < 0.3,
            patterns=rng.random((classes, 6)) < 0.5,
            tampered=np.arange(classes) == 1,
            rates=np.zeros(classes),
            seen=np.full(classes, 6.0),
        )
        for classes in (2, 4, 3)
    ]
    rates = false_alarm_rates(evidence, fits, 8.0)
    seen, flagged = visibility(evidence, slice(None), 8.0)
    for roles, of_fit in zip(fits, rates, strict=True):
        turned = np.where(roles.inverted[:, None], seen - flagged, flagged)
        errors = np.array([patterns_differ(turned, seen, one) for one in roles.patterns])
        authentic = ~roles.tampered[errors.argmin(axis=0)]
        share = turned[:, authentic].sum(axis=1) / seen[:, authentic].sum(axis=1)
        np.testing.assert_allclose(of_fit, share, rtol=1e-4)


def patterns_differ(turned: np.ndarray, seen: np.ndarray, pattern: np.ndarray) -> np.ndarray:
    """Visibility of each Gaussian, (N,), summed over the views that contradict a pattern (V,)."""
    return np.where(pattern[:, None], seen - turned, turned).sum(axis=0)
