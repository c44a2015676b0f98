"""Fusion of masks and prior: bounds, weights, independence."""

import dataclasses

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gsc_jax.estimators import Prior
from gsc_jax.estimators.robust.prior_fusion import (
    fuse,
    linear_pool,
    log_odds_of,
    rank_in_scene,
    refuted,
)
from gsc_jax.scene.neighbours import parts

UNIT = st.floats(0, 1, width=32)
PROBABILITIES = hnp.arrays(np.float32, 5, elements=UNIT)
ALL = np.ones(5, bool)


def prior(probability: np.ndarray, verdict: float, known: np.ndarray = ALL) -> Prior:
    return Prior(probability=probability, verdict=verdict, known=known)


@given(PROBABILITIES, PROBABILITIES, PROBABILITIES)
def test_the_pool_lies_between_both_probabilities(one, other, share):
    result = linear_pool(one, other, share)
    assert result.dtype == np.float32
    assert (result >= np.minimum(one, other) - 1e-6).all()
    assert (result <= np.maximum(one, other) + 1e-6).all()


@given(PROBABILITIES, PROBABILITIES, PROBABILITIES)
@example(np.eye(5, dtype=np.float32)[0], np.eye(5, dtype=np.float32)[1], np.full(5, 0.5))
def test_the_pool_labels_something_exactly_if_one_estimate_does(one, other, share):
    labelled = bool(((one > 0.5) | (other > 0.5)).any())
    assume(not (one == 0.5).any() and not (other == 0.5).any())
    assert (linear_pool(one, other, share) > 0.5).any() == labelled


@given(PROBABILITIES, PROBABILITIES)
def test_shares_of_0_and_1_select_one_estimate(one, other):
    assume((one > 0.5).any() and (other > 0.5).any())
    np.testing.assert_array_equal(linear_pool(one, other, np.zeros(5)), one)
    np.testing.assert_array_equal(linear_pool(one, other, np.ones(5)), other)


@pytest.mark.parametrize(
    ("one", "other", "share", "returned"),
    [
        ([0.6, 0], [0, 0.6], 0.6, "other"),
        ([0.6, 0], [0, 0.6], 0.5, "one"),
        ([0.6, 0], [0, 0.6], 0.4, "one"),
        ([0.6, 0], [0, 0.1], 0.6, "one"),
        ([0.1, 0], [0, 0.6], 0.4, "other"),
        ([0.4, 0], [0, 0.4], 0.5, "pooled"),
    ],
)
def test_the_pool_is_one_estimate_where_the_mean_would_label_nothing(one, other, share, returned):
    one, other = np.array(one, np.float32), np.array(other, np.float32)
    expected = {"one": one, "other": other, "pooled": (1 - share) * one + share * other}
    result = linear_pool(one, other, np.full(2, share))
    np.testing.assert_allclose(result, expected[returned], rtol=1e-6)


def test_a_prior_that_alone_labels_leaves_unknown_gaussians_at_0():
    known = np.array([True, False, True])
    fused, _ = fuse(np.zeros(3, np.float32), 0.5, np.ones(3, bool), prior(np.ones(3), 0.4, known))
    assert fused.tolist() == [1, 0, 1]


def test_unseen_gaussians_follow_the_prior_and_unknown_ones_the_masks():
    masks, own = np.array([0, 1, 1], np.float32), np.array([1, 0, 0], np.float32)
    seen, known = np.array([False, True, True]), np.array([True, True, False])
    fused, _ = fuse(masks, 0.8, seen, prior(own, 0.75, known))
    np.testing.assert_allclose(fused, [0.75, 1, 1], rtol=1e-6)
    few_agree, _ = fuse(masks, 0.1, seen, prior(own, 0.75, known))
    np.testing.assert_allclose(few_agree, [0.75, 1 - 0.9 * 0.75, 1], rtol=1e-6)
    exact = dataclasses.replace(prior(own, 0.75, known), exact=True)
    np.testing.assert_allclose(fuse(masks, 0.8, seen, exact)[0][1], 1 - 0.6 * 0.75, rtol=1e-6)


@given(PROBABILITIES, PROBABILITIES, st.floats(0.15, 1), UNIT, hnp.arrays(bool, 5))
@example(np.eye(5, dtype=np.float32)[0], 1 - np.eye(5, dtype=np.float32)[0], 0.15, 1.0, ALL)
def test_what_the_masks_label_is_kept_where_views_see_it(masks, own, shown, verdict, seen):
    """A prior that is sure and wrong costs nothing, unless it is exact."""
    assume(((masks > 0.5) & seen).any())
    fused, _ = fuse(masks, shown, seen, prior(own, verdict))
    np.testing.assert_array_equal((fused > 0.5)[seen], (masks > 0.5)[seen])


@given(UNIT, UNIT, UNIT)
def test_a_prior_against_an_edit_is_no_evidence(shown, verdict, weight):
    _, certain = fuse(np.zeros(5, np.float32), shown, ALL, prior(np.zeros(5), verdict), weight)
    assert 0 <= certain <= 1
    assert certain >= shown - 1e-6
    assert certain == pytest.approx(shown) or verdict > 0.5


@given(st.floats(0.01, 0.99), st.floats(0.5, 0.99))
@example(0.5, 0.5)
def test_odds_of_independent_evidence_multiply(verdict, prior_verdict):
    nothing = np.zeros(5, np.float32)
    _, certain = fuse(nothing, verdict, ALL, prior(nothing, prior_verdict))
    expected = log_odds_of(verdict) + log_odds_of(prior_verdict)
    assert log_odds_of(certain) == pytest.approx(expected, abs=1e-6)


def test_a_prior_without_known_gaussians_labels_none():
    masks, certain = np.zeros(5, np.float32), np.ones(5)
    fused, _ = fuse(masks, 0.5, ALL, prior(certain, 0.9, known=~ALL))
    assert not fused.any()


WRONG = {
    "probability": [np.append(np.zeros(4), np.nan), np.full(5, 1.5)],
    "verdict": [np.nan, -0.1],
    "known": [np.ones(4, bool), np.arange(5)],
}


@pytest.mark.parametrize(("name", "value"), [(n, v) for n, values in WRONG.items() for v in values])
def test_invalid_priors_are_errors(name, value):
    with pytest.raises(ValueError, match=f"^{name} must be"):
        dataclasses.replace(prior(np.zeros(5), 0.5), **{name: value})


def test_a_prior_of_another_size_is_an_error():
    with pytest.raises(ValueError, match="has 5 Gaussians, the scene 3"):
        prior(np.zeros(5), 0.5).of(3)


LINE = np.linspace(0, 1, 1000)
PLACES = np.stack([LINE, 0 * LINE, 0 * LINE], axis=1)
FIRST = np.arange(1000) < 10


def ranked(probability: np.ndarray, region: np.ndarray = FIRST, **changes) -> float | None:
    given = {"probability": probability, "verdict": 0.5, "known": np.ones(1000, bool), **changes}
    return rank_in_scene(Prior(**given), region, PLACES)


def test_the_rank_is_the_share_of_parts_that_stand_out_more():
    count = len(parts(PLACES[10:], 10)[1])
    assert ranked(1 - LINE) == pytest.approx(1 / (1 + count))
    assert ranked(LINE) == 1
    assert ranked(np.abs(LINE - 0.5)) == pytest.approx(2 / (1 + count), abs=1e-6)
    middle = np.abs(LINE - 0.5) < 0.005
    assert ranked(LINE, middle) == pytest.approx(0.5, abs=0.02)
    half = LINE < 0.5  # compared with parts of a 64th of the rest
    count = len(parts(PLACES[500:], 500 // 64)[1])
    assert ranked(1 - LINE, half) == pytest.approx(1 / (1 + count))


def test_parts_as_prominent_as_the_region_count_half():
    assert ranked(np.where(LINE > 0.99, 0.9, 0.1)) == pytest.approx(0.51, abs=0.02)
    assert ranked(np.where(LINE > 0.99, 0.1, 0.9)) == pytest.approx(0.5, abs=0.02)
    first = ranked(np.where(FIRST | (LINE > 0.99), 0.9, 0.1))
    assert first is not None
    assert first < 0.02


def test_gaussians_without_a_place_do_not_count():
    places = np.where(LINE[:, None] > 0.9, np.nan, PLACES)
    given = Prior(probability=LINE, verdict=0.5, known=np.ones(1000, bool))
    few = dataclasses.replace(given, known=LINE <= 0.9)
    assert rank_in_scene(given, FIRST, places) == rank_in_scene(few, FIRST, PLACES)
    assert rank_in_scene(given, FIRST, np.full((1000, 3), np.nan)) is None


def test_there_is_no_rank_without_a_difference():
    for region in (FIRST, ~FIRST):
        assert ranked(np.full(1000, 0.3), region) is None
    assert ranked(LINE, np.zeros(1000, bool)) is None
    assert ranked(LINE, np.ones(1000, bool)) is None
    assert ranked(LINE, known=np.zeros(1000, bool)) is None
    assert ranked(LINE, known=FIRST) is None
    assert ranked(LINE, known=~FIRST) is None


@given(hnp.arrays(np.float32, 100, elements=UNIT), hnp.arrays(bool, 100), hnp.arrays(bool, 100))
def test_the_rank_is_a_share(probability, region, known):
    found = rank_in_scene(prior(probability, 0.5, known), region, PLACES[:100])
    assert found is None or 0 < found <= 1


@pytest.mark.parametrize("weight", [0.0, 0.5, 1.0])
@given(st.floats(0.15, 1), st.floats(1e-3, 1), st.floats(0, 1))
def test_odds_fall_with_the_rank_by_a_factor_of_three_at_most(weight, shown, rank, verdict):
    given = prior(np.zeros(5), verdict)
    (_, alone), (_, found) = (fuse(np.ones(5), shown, ALL, given, weight, r) for r in (None, rank))
    factor = min(rank ** (-2 / 3) / 3, 1) ** weight
    assert 1 / 3 - 1e-6 <= factor <= 1
    assert found * (1 - alone) == pytest.approx(factor * alone * (1 - found), abs=1e-9)


def test_the_rank_of_what_the_masks_label_does_not_count_where_the_prior_labels():
    exact = dataclasses.replace(prior(np.ones(5), 0.9), exact=True)
    for shown, own in ((0.14, prior(np.ones(5), 0.9)), (0.8, exact)):
        _, alone = fuse(np.zeros(5), shown, ALL, own)
        assert fuse(np.zeros(5), shown, ALL, own, 1.0, 1.0)[1] == alone


def test_of_rivals_those_that_are_ordinary_are_refuted_if_one_stands_out():
    region, places = np.zeros(1000, int), {1: 985, 2: 800, 3: 500}  # ranks near 0.01, 0.2 and 0.5
    for rival, start in places.items():
        region[start : start + 10] = rival
    given = Prior(probability=0.9 * LINE, verdict=0.5, known=np.ones(1000, bool))
    for rivals, wrong in (((1, 2, 3), [3]), ((1, 2), []), ((2, 3), []), ((1, 3), [3]), ((), [])):
        dropped = refuted(np.isin(np.arange(4), rivals), region, given, PLACES)
        assert np.flatnonzero(dropped).tolist() == wrong
    unknown = Prior(probability=0.9 * LINE, verdict=0.5, known=region != 3)
    assert not refuted(np.array([False, True, False, True]), region, unknown, PLACES).any()
