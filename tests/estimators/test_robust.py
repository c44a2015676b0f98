"""`robust`: failures of masks, invariances, and arbitrary evidence."""

import dataclasses

import numpy as np
import pytest
from failing_masks import (
    COUNT,
    DECOY,
    ESTIMATOR,
    KINDS,
    MEANS,
    TOTAL,
    TRUE,
    VIEWS,
    estimate,
    failing,
    labels_of,
    masked,
    verdict_of,
)
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from limits import assert_limits

from gsc_jax.estimators import Prior, RobustEstimator
from gsc_jax.estimators.robust.class_roles import scene_probability
from gsc_jax.evidence.lifting import Evidence


@pytest.mark.parametrize("failure", ["clean", "misses", "consistent", "inverted", "mixture"])
def test_labels_are_exact_under_every_failure(failure):
    assert np.array_equal(labels_of(masked(failing(failure))), TRUE & (TOTAL.sum(0) > 0))


def test_pixels_that_are_flipped_by_chance_hide_nothing():
    flags = np.where(TRUE, 0.7, 0.3).astype(np.float32)
    found = estimate(Evidence(total=TOTAL, tampered=TOTAL * flags))
    assert np.array_equal(found.labels, TRUE & (TOTAL.sum(0) > 0))


def test_views_that_do_not_show_an_edit_do_not_count_as_misses():
    """What other views show, and no view of the edit, belongs to no class by the masks alone."""
    kinds, total = np.repeat(np.arange(3), [200, 20, 800]), np.full((12, 1020), 100, np.float32)
    total[4:, kinds == 1] = total[:4, kinds == 2] = 0
    flagged = np.zeros(total.shape, np.float32)
    flagged[:4, kinds == 1] = 90
    found = ESTIMATOR.estimate_from_evidence(
        Evidence(total=total, tampered=flagged), 20 * np.eye(3)[kinds]
    )
    assert np.array_equal(found.labels, kinds == 1)
    assert found.verdict == pytest.approx(scene_probability(1.0, 4), abs=0.01)


def test_inverted_and_uninformative_views_are_identified():
    found = estimate(masked(failing("mixture")))
    expected = np.full(VIEWS, "reliable", object)
    expected[[1, 4, 9]] = "uninformative"
    expected[[2, 7]] = "inverted"
    assert list(found.reliability) == list(expected)
    assert not found.attribute[TOTAL.sum(0) == 0].any(), "log odds without evidence"


def test_without_inversion_the_scene_probability_falls():
    flagged = failing("clean")
    flagged[:5] = ~flagged[:5]
    without = dataclasses.replace(ESTIMATOR, inversion=False)
    kept, turned = (estimate(masked(flagged), c) for c in (without, ESTIMATOR))
    assert verdict_of(masked(flagged), without) < 0.7 < 0.98 < verdict_of(masked(flagged))
    assert "inverted" not in kept.reliability
    assert turned.reliability[:5] == ("inverted",) * 5


def test_a_clean_mask_of_an_edit_that_fills_the_image_is_not_inverted():
    total = TOTAL.copy()
    total[3, ~TRUE] *= 0.01
    total[3, TRUE] += 100
    evidence = masked(failing("clean"), total)
    assert evidence.tampered[3].sum() > 0.9 * evidence.total[3].sum(), "the edit fills this view"
    found = ESTIMATOR.from_masks(evidence, MEANS)
    assert found.roles is not None
    assert not found.roles.inverted.any()
    assert np.array_equal(found.probability > 0.5, TRUE)


def test_the_scene_probability_rises_with_the_share_of_reliable_views():
    assert verdict_of(masked(failing("clean"))) > verdict_of(masked(failing("misses"))) > 0.5
    assert scene_probability(0.58, 10) == pytest.approx(0.5)
    decoy = failing("consistent") & (KINDS == DECOY)
    decoy[8:] = False
    untouched = estimate(masked(decoy))
    assert verdict_of(masked(decoy)) < 0.5
    assert any("perhaps nothing was edited" in text for text in untouched.warnings)


def test_a_region_flagged_in_few_views_is_labelled_only_without_min_verdict():
    flagged = np.zeros((VIEWS, COUNT), bool)
    flagged[np.ix_([2, 7], KINDS == DECOY)] = True
    few = estimate(masked(flagged))
    assert not few.labels.any()
    assert not few.tamper.any()
    assert any("No region is flagged in more than 17%" in text for text in few.warnings)
    without = estimate(masked(flagged), dataclasses.replace(ESTIMATOR, min_verdict=0.0))
    assert np.array_equal(without.labels, KINDS == DECOY)


def test_a_region_that_three_masks_flag_and_little_else_is_labelled():
    flagged = np.zeros((VIEWS, COUNT), bool)
    flagged[np.ix_([2, 7, 9], KINDS == DECOY)] = True
    alone = estimate(masked(flagged))
    assert verdict_of(masked(flagged)) < ESTIMATOR.min_verdict
    assert np.array_equal(alone.labels, KINDS == DECOY)
    assert any("perhaps nothing was edited" in text for text in alone.warnings)
    flagged[4] = ~flagged[4]
    turned = estimate(masked(flagged))
    assert turned.reliability[4] == "inverted"
    assert np.array_equal(turned.labels, KINDS == DECOY)
    flagged[4] = False
    for view in range(VIEWS):  # as many flags, elsewhere in each view
        flagged[view, (np.arange(COUNT) // 40 == view % 10) & (KINDS != DECOY)] = True
    assert not estimate(masked(flagged)).labels.any()


def test_a_region_that_few_views_see_is_no_evidence():
    total = TOTAL.copy()
    total[2:, KINDS == DECOY] = 0
    flagged = np.zeros((VIEWS, COUNT), bool)
    flagged[:2, KINDS == DECOY] = True
    found = estimate(masked(flagged, total))
    assert found.labels.any()
    assert found.verdict is not None
    assert found.verdict <= 0.6
    assert any("fewer than 3 masks" in text for text in found.warnings)


LIMITS = {
    "sample": (1, 10**9),
    "seed": (0, 2**32 - 1),
    **dict.fromkeys(("restarts", "neighbours"), (1, 1000)),
    **dict.fromkeys(("half_weight", "effective_pixels", "class_log_odds", "near"), (1e-9, 1e9)),
    "smoothing": (0.0, 1e9),
    "covisibility": (0.0, 1.0),
    **dict.fromkeys(("prior_weight", "min_verdict", "tolerance", "threshold"), (0.0, 1.0)),
}


@pytest.mark.parametrize("name", LIMITS)
def test_the_ends_of_a_range_are_valid_and_numbers_beyond_them_are_not(name):
    assert_limits(ESTIMATOR, name, *LIMITS[name])


def test_between_2_and_100_classes_may_be_candidates():
    assert dataclasses.replace(ESTIMATOR, classes=(2, 100)).classes == (2, 100)
    for classes in ((), (1,), (101,), (4, 1), [4, 8], (4.5,)):
        with pytest.raises(ValueError, match="classes"):
            dataclasses.replace(ESTIMATOR, classes=classes)


def test_the_defaults_are_those_of_the_tables():
    assert dataclasses.asdict(RobustEstimator()) == {
        "name": "robust",
        "classes": (4, 8),
        "restarts": 8,
        "sample": 8192,
        "half_weight": 8.0,
        "covisibility": 0.45,
        "effective_pixels": 8.0,
        "inversion": True,
        "distractors": True,
        "class_log_odds": 3.0,
        "smoothing": 3.0,
        "neighbours": 8,
        "prior_weight": 1.0,
        "min_verdict": 0.06,
        "tolerance": 0.02,
        "threshold": 0.5,
        "mask_rule": "share",
        "near": 0.2,
        "seed": 0,
    }


WRONG = {
    "mask_rule": "all",
    "inversion": "no",
    "distractors": None,
    "sample": 0,
    "half_weight": 0.0,
    "threshold": 1.0,
    "min_verdict": -0.1,
    "tolerance": np.nan,
    "seed": -1,
    "restarts": 10**8,
    "neighbours": 2.5,
    "classes": (4, 10**8),
}


@pytest.mark.parametrize("name", WRONG)
def test_values_out_of_range_are_errors(name):
    with pytest.raises(ValueError, match=name):
        dataclasses.replace(ESTIMATOR, **{name: WRONG[name]})


def test_empty_and_full_masks_are_defined():
    nothing = estimate(Evidence(total=TOTAL, tampered=np.zeros_like(TOTAL)))
    assert not nothing.labels.any()
    assert nothing.verdict == scene_probability(0.0, VIEWS)
    unflagged = ESTIMATOR.from_masks(MIXED, MEANS, flagged=False)
    assert unflagged.roles is None
    assert not unflagged.probability.any()
    everything = estimate(Evidence(total=TOTAL, tampered=TOTAL))
    assert np.array_equal(everything.labels, TOTAL.sum(0) > 0)


MIXED = masked(failing("mixture"))
LABELS = labels_of(MIXED)


@given(st.integers(0, 2**32 - 1))
def test_the_order_of_views_and_gaussians_does_not_matter(seed):
    rng = np.random.default_rng(seed)
    views, order = rng.permutation(VIEWS), rng.permutation(COUNT)
    total, tampered = (values[np.ix_(views, order)] for values in (TOTAL, MIXED.tampered))
    evidence = Evidence(total=total, tampered=tampered)
    assert np.array_equal(labels_of(evidence, MEANS[order]), LABELS[order])


@pytest.mark.parametrize("more", [MIXED.tampered[0], 0 * TOTAL[0]])
@pytest.mark.parametrize("total", [TOTAL[0], 0 * TOTAL[0]])
def test_a_view_may_be_given_twice_and_may_flag_or_see_nothing(total, more):
    total, more = total[None], np.minimum(total, more)[None]
    total, tampered = np.concatenate([TOTAL, total]), np.concatenate([MIXED.tampered, more])
    assert np.array_equal(labels_of(Evidence(total=total, tampered=tampered)), LABELS)


def test_complementing_all_masks_changes_nothing():
    complement = Evidence(total=TOTAL, tampered=TOTAL - MIXED.tampered)
    assert np.array_equal(labels_of(complement), LABELS)
    warnings = estimate(complement).warnings
    assert any("were inverted" in text for text in warnings)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_the_unit_of_the_scene_does_not_matter(scale):
    assert np.array_equal(labels_of(MIXED, MEANS * np.float32(scale)), LABELS)


@pytest.mark.usefixtures("nan_is_an_error")
def test_the_estimate_is_the_same_to_the_bit_and_no_intermediate_value_is_nan():
    first, second = (ESTIMATOR.from_masks(MIXED, MEANS).probability for _ in range(2))
    assert first.tobytes() == second.tobytes()


WEIGHTS = st.sampled_from([0.0, 1e-30, 1e-3, 1.0, 50.0, 1e6])
SHARES, PLACES = st.sampled_from([0.0, 0.5, 1.0]), st.sampled_from([0.0, 1.0, 1e30, np.nan])
SURE = st.sampled_from([0.0, 0.3, 0.6, 1.0])


def priors(count: int) -> st.SearchStrategy[Prior]:
    """Priors of `count` Gaussians."""
    return st.builds(
        Prior,
        probability=hnp.arrays(np.float32, count, elements=SURE),
        verdict=SURE,
        known=hnp.arrays(bool, count),
    )


@pytest.mark.parametrize(("views", "count"), [(1, 1), (1, 5), (6, 1), (6, 12)])
@given(data=st.data())
def test_any_evidence_gives_probabilities(views, count, data):
    total = data.draw(hnp.arrays(np.float32, (views, count), elements=WEIGHTS))
    share = data.draw(hnp.arrays(np.float32, (views, count), elements=SHARES))
    means = data.draw(hnp.arrays(np.float32, (count, 3), elements=PLACES))
    prior = data.draw(st.none() | priors(count))
    evidence = Evidence(total=total, tampered=total * share)
    with np.errstate(over="ignore"):
        found = ESTIMATOR.estimate_from_evidence(evidence, means, prior)
    assert np.isfinite(found.tamper).all()
    assert np.isfinite(found.attribute).all()
    assert 0 <= found.tamper.min() <= found.tamper.max() <= 1
    known = (total.sum(0) > 0) | (prior is not None and prior.known & (prior.probability > 0))
    assert not found.labels[~known].any(), "a Gaussian without evidence is labelled"
    assert found.verdict is not None
    assert 0 < found.verdict < 1


@pytest.mark.parametrize("threshold", [0.01, 0.999999])
def test_the_scene_probability_does_not_depend_on_the_threshold(threshold):
    evidence = masked(failing("mixture"))
    changed = dataclasses.replace(ESTIMATOR, threshold=threshold)
    assert verdict_of(evidence, changed) == verdict_of(evidence)


def test_a_score_at_the_threshold_is_not_labelled():
    scores = estimate(MIXED).tamper
    some = float(scores[np.argsort(scores)[COUNT // 2]])
    found = estimate(MIXED, dataclasses.replace(ESTIMATOR, threshold=some))
    assert (found.tamper == some).any()
    assert np.array_equal(found.labels, found.tamper > some)
