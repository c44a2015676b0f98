"""Two opinions as one: each is believed as far as it is sure."""

import dataclasses

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gsc_jax.estimators.robust.prior_fusion import Prior, both, fused, log_odds_of, pooled

UNIT = st.floats(0, 1, width=32)
OPINIONS = hnp.arrays(np.float32, 5, elements=UNIT)
ALL = np.ones(5, bool)


def prior(probability: np.ndarray, verdict: float, known: np.ndarray = ALL) -> Prior:
    return Prior(probability=probability, verdict=verdict, known=known)


@given(OPINIONS, OPINIONS, OPINIONS)
def test_what_is_pooled_lies_between_both(one, other, share):
    result = pooled(one, other, share)
    assert result.dtype == np.float32
    assert (result >= np.minimum(one, other) - 1e-6).all()
    assert (result <= np.maximum(one, other) + 1e-6).all()


@given(OPINIONS, OPINIONS, OPINIONS)
@example(np.eye(5, dtype=np.float32)[0], np.eye(5, dtype=np.float32)[1], np.full(5, 0.5))
def test_where_one_names_something_both_do(one, other, share):
    named = bool(((one > 0.5) | (other > 0.5)).any())
    assume(not (one == 0.5).any() and not (other == 0.5).any())
    assert (pooled(one, other, share) > 0.5).any() == named


@given(OPINIONS, OPINIONS)
def test_who_alone_counts_is_believed(one, other):
    assume((one > 0.5).any() and (other > 0.5).any())
    np.testing.assert_array_equal(pooled(one, other, np.zeros(5)), one)
    np.testing.assert_array_equal(pooled(one, other, np.ones(5)), other)


@pytest.mark.parametrize("exact", [False, True])
@pytest.mark.parametrize(("shown", "verdict"), [(0.3, 0.4), (0.9, 0.9), (0.2, 0.95), (0.9, 1.0)])
def test_each_counts_as_far_as_it_is_sure(exact, shown, verdict):
    masks, own = np.array([0.9, 0.9, 0.1], np.float32), np.array([0.1, 0.9, 0.9], np.float32)
    known = np.ones(3, bool)
    given = Prior(probability=own, verdict=verdict, known=known, exact=exact)
    share = (1 - shown + exact * shown / 2) * verdict
    for weight in (1.0, 0.5):
        told, _ = fused(masks, shown, known, given, weight)
        expected = (1 - weight * share) * masks + weight * share * own
        np.testing.assert_allclose(told, expected, rtol=1e-6)


def test_masks_say_nothing_of_the_unseen_and_the_prior_nothing_of_the_unknown():
    masks, own = np.array([0, 1, 1], np.float32), np.array([1, 0, 0], np.float32)
    seen, known = np.array([False, True, True]), np.array([True, True, False])
    told, _ = fused(masks, 0.8, seen, prior(own, 0.75, known))
    np.testing.assert_allclose(told, [0.75, 1 - 0.2 * 0.75, 1], rtol=1e-6)


@given(UNIT, UNIT, UNIT)
def test_what_the_prior_says_against_an_edit_is_no_evidence(shown, verdict, weight):
    _, certain = fused(np.zeros(5, np.float32), shown, ALL, prior(np.zeros(5), verdict), weight)
    assert 0 <= certain <= 1
    assert certain >= shown - 1e-6
    assert certain == pytest.approx(shown) or verdict > 0.5


@given(st.floats(1e-6, 1 - 1e-6), st.floats(-20, 20))
@example(1e-6, -20.0)
def test_odds_of_independent_evidence_multiply(certain, log_odds):
    added = np.clip(log_odds_of(certain) + log_odds, log_odds_of(0.0), log_odds_of(1.0))
    assert log_odds_of(both(certain, log_odds)) == pytest.approx(added, abs=1e-3)


@pytest.mark.parametrize(
    "wrong",
    [
        {"probability": np.append(np.zeros(4), np.nan)},
        {"probability": np.full(5, 1.5)},
        {"verdict": np.nan},
        {"verdict": -0.1},
        {"known": np.ones(4, bool)},
        {"known": np.arange(5)},
    ],
)
def test_what_is_no_prior_is_refused(wrong):
    (name,) = wrong
    with pytest.raises(ValueError, match=f"^{name} must be"):
        dataclasses.replace(prior(np.zeros(5), 0.5), **wrong)


def test_a_prior_of_another_scene_is_refused():
    with pytest.raises(ValueError, match="speaks of 5 Gaussians, expected 3"):
        fused(np.zeros(3, np.float32), 0.5, np.ones(3, bool), prior(np.zeros(5), 0.5))
