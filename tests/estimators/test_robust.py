"""`robust`: failures of masks, invariances, and arbitrary evidence."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from limits import assert_limits

from gsc_jax.estimators import Finding, Prior, RobustEstimator
from gsc_jax.estimators.protocol import DISAGREEMENT, NONE_FLAGGED
from gsc_jax.estimators.robust import diagnostics
from gsc_jax.estimators.robust.class_roles import Roles, assign_roles, scene_probability
from gsc_jax.estimators.robust.estimator import pattern_distance
from gsc_jax.estimators.robust.gaussian_visibility import stratified_sample, visibility
from gsc_jax.evidence.lifting import Evidence

VIEWS, COUNT = 12, 400
ESTIMATOR = RobustEstimator(sample=512)
AUTHENTIC, TAMPERED, DECOY = 0, 1, 2


def world(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Kinds (N,), centres (N, 3) in three clusters, and weights (V, N)."""
    rng = np.random.default_rng(seed)
    kinds = rng.choice([AUTHENTIC, TAMPERED, DECOY], COUNT, p=[0.7, 0.15, 0.15])
    means = rng.normal(size=(COUNT, 3)) + 20 * np.eye(3)[kinds]
    total = rng.exponential(20, (VIEWS, COUNT)) * (rng.random((VIEWS, COUNT)) < 0.8)
    return kinds, means.astype(np.float32), total.astype(np.float32)


KINDS, MEANS, TOTAL = world()
TRUE, ALL = KINDS == TAMPERED, np.ones(COUNT, bool)


def masked(flagged: np.ndarray, total: np.ndarray = TOTAL, noise: float = 0.05) -> Evidence:
    """Evidence of masks that flag these Gaussians in these views (V, N), up to noise."""
    rng = np.random.default_rng(1)
    rate = np.where(flagged, 1 - noise * rng.random(total.shape), noise * rng.random(total.shape))
    return Evidence(total=total, tampered=(total * rate).astype(np.float32))


def failing(failure: str) -> np.ndarray:
    """Flagged Gaussians, shape (V, N), of a detector with one kind of failure."""
    flagged = np.tile(TRUE, (VIEWS, 1))
    if failure in ("misses", "mixture"):
        flagged[[1, 4, 9]] = False
    if failure in ("consistent", "mixture"):
        flagged[np.ix_([0, 1, 3, 6, 8], KINDS == DECOY)] = True
    if failure in ("inverted", "mixture"):
        flagged[[2, 7]] = ~flagged[[2, 7]]
    return flagged


def estimate(
    evidence: Evidence, estimator: RobustEstimator = ESTIMATOR, prior: Prior | None = None
) -> Finding:
    return estimator.estimate_from_evidence(evidence, MEANS, prior)


def verdict_of(evidence: Evidence, estimator: RobustEstimator = ESTIMATOR) -> float:
    verdict = estimate(evidence, estimator).verdict
    assert verdict is not None
    return verdict


def labels_of(evidence: Evidence, means: np.ndarray = MEANS) -> np.ndarray:
    return ESTIMATOR.from_masks(evidence, means).probability > 0.5


@pytest.mark.parametrize("failure", ["clean", "misses", "consistent", "inverted", "mixture"])
def test_labels_are_exact_under_every_failure(failure):
    assert np.array_equal(labels_of(masked(failing(failure))), TRUE & (TOTAL.sum(0) > 0))


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
    assert verdict_of(masked(flagged), without) < 0.7 < 0.99 < verdict_of(masked(flagged))
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
    assert scene_probability(0.55, 10) == pytest.approx(0.5)
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


LIMITS = {
    "sample": (1, 10**9),
    "seed": (0, 2**32 - 1),
    **dict.fromkeys(("restarts", "neighbours"), (1, 1000)),
    **dict.fromkeys(("half_weight", "effective_pixels", "class_log_odds", "near"), (1e-9, 1e9)),
    "smoothing": (0.0, 1e9),
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
        "restarts": 2,
        "sample": 8192,
        "half_weight": 8.0,
        "effective_pixels": 8.0,
        "inversion": True,
        "distractors": True,
        "class_log_odds": 3.0,
        "smoothing": 5.0,
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


def test_pattern_distance_counts_views_that_contradict_a_pattern():
    total = np.array([[8.0, 8.0], [8.0, 0.0]], np.float32)
    evidence = Evidence(total=total, tampered=np.array([[8.0, 2.0], [0.0, 0.0]], np.float32))
    looked, flagged = visibility(evidence, slice(None), 8.0)
    assert looked.tolist() == [[0.5, 0.5], [0.5, 0.0]]
    assert flagged.tolist() == [[0.5, 0.125], [0.0, 0.0]]
    roles = assign_roles(np.array([[0.1, 0.1], [0.9, 0.9]]), np.array([[9.0, 9.0], [1.0, 1.0]]))
    assert roles is not None
    # Authentic: what was flagged; tampered: what was not.
    expected = [[0.5, 0.5], [0.125, 0.375]]
    assert pattern_distance(evidence, roles, 8.0).tolist() == expected


def decoy_in(views: int) -> Evidence:
    """Masks that flag the decoy in the first views."""
    flagged = np.zeros((VIEWS, COUNT), bool)
    flagged[:views, KINDS == DECOY] = True
    return masked(flagged)


def true_prior(verdict: float, *, exact: bool = False) -> Prior:
    """A prior that is correct."""
    own, known = np.where(TRUE, 0.99, 0.0), np.ones(COUNT, bool)
    return Prior(probability=own, verdict=verdict, known=known, exact=exact)


@pytest.mark.parametrize(
    ("views", "verdict", "exact", "decoy"),
    [
        (4, 0.9999, False, False),
        (4, 0.3, False, True),
        (6, 0.9999, False, True),
        (6, 0.95, True, False),
        (11, 0.9999, False, True),
        (11, 0.9999, True, False),
        (11, 0.9, True, True),
    ],
)
def test_the_prior_decides_where_masks_are_unreliable(views, verdict, exact, decoy):
    """A region flagged in few views is a decoy; one flagged in nearly all views is an edit."""
    found = estimate(decoy_in(views), prior=true_prior(verdict, exact=exact))
    seen, expected = TOTAL.sum(axis=0) > 0, KINDS == DECOY if decoy else TRUE
    assert np.array_equal(found.labels[seen], expected[seen])
    assert np.array_equal(found.labels[~seen], TRUE[~seen] & (verdict > 0.5))
    assert found.verdict is not None
    assert found.verdict >= verdict_of(decoy_in(views))
    word = "reliable" if decoy else "uninformative"
    assert set(found.reliability[:views]) == {word}
    overruled = "the attributes alone" if decoy else "the masks agree on are not labelled"
    assert any(overruled in text for text in found.warnings) == (verdict > 0.5)


def test_the_prior_may_label_what_no_view_flags():
    nothing = masked(np.zeros((VIEWS, COUNT), bool), noise=0)
    found = estimate(nothing, prior=true_prior(0.9999))
    assert np.array_equal(found.labels, TRUE)
    assert found.warnings == [
        f"{NONE_FLAGGED} The labels come from the attributes of the Gaussians."
    ]
    unsure = estimate(nothing, prior=true_prior(0.4))
    assert not unsure.labels.any()
    assert not unsure.tamper.any()


def test_labels_from_the_prior_are_counted_in_a_warning():
    masks = np.tile(TRUE & (np.cumsum(TRUE) % 2 == 0), (VIEWS, 1))
    unseen = TOTAL * (masks.any(axis=0) | ~TRUE)
    found = estimate(masked(masks, unseen), prior=true_prior(0.9))
    assert np.array_equal(found.labels, TRUE)
    more = (TRUE & ~masks[0]).sum()
    assert any(text.startswith(f"{more} of {TRUE.sum()} labelled") for text in found.warnings)
    assert (found.attribute[TRUE] > 0).all()


def test_a_view_without_labelled_gaussians_is_unseen():
    away = TOTAL.copy()
    away[0, TRUE] = 0
    found = estimate(masked(np.tile(TRUE, (VIEWS, 1)), away), prior=true_prior(0.9))
    assert found.reliability == ("unseen", *["reliable"] * (VIEWS - 1))


@pytest.mark.parametrize("failure", ["clean", "misses", "consistent", "mixture"])
@pytest.mark.parametrize("kind", [AUTHENTIC, TAMPERED, DECOY])
def test_a_prior_without_a_verdict_changes_the_scene_probability_and_no_label(failure, kind):
    """The probability falls where the prior does not set the labelled Gaussians apart."""
    evidence, rng = masked(failing(failure)), np.random.default_rng(2)
    own = np.where(kind == KINDS, 0.6, 0.4) + 0.01 * rng.random(COUNT)
    given = Prior(probability=own, verdict=0.5, known=ALL)
    alone, found = estimate(evidence), estimate(evidence, prior=given)
    seen = TOTAL.sum(axis=0) > 0
    np.testing.assert_array_equal(found.labels[seen], alone.labels[seen])
    odds = [np.divide(v, 1 - v) for v in (found.verdict, alone.verdict) if v is not None]
    change = odds[0] / odds[1]
    assert 1 / 3 - 1e-6 <= change <= 1 + 1e-9
    assert (change < 1 - 1e-9) == (kind != TAMPERED)


def test_there_is_no_rank_where_the_prior_decides():
    """Else it is that of what the masks label."""
    for views, exact, asked in ((11, False, True), (11, True, False), (4, False, False)):
        found = estimate(decoy_in(views), prior=true_prior(0.9, exact=exact))
        assert (found.rank is not None) == asked
    assert estimate(decoy_in(11)).rank is None


def test_a_prior_that_contradicts_masks_takes_no_labels():
    flagged = np.zeros((VIEWS, COUNT), bool)
    flagged[:6, TRUE] = True
    evidence = masked(flagged)
    alone, given = estimate(evidence), Prior(probability=0.6 - 0.2 * TRUE, verdict=0.5, known=ALL)
    least = dataclasses.replace(ESTIMATOR, min_verdict=verdict_of(evidence))
    found = estimate(evidence, least, given)
    assert found.verdict is not None
    assert found.verdict < verdict_of(evidence)
    np.testing.assert_array_equal(found.labels, alone.labels)
    assert found.labels.any()


def rivals(edit: int, decoy: int) -> tuple[Evidence, Prior]:
    """Masks that flag an edit and an authentic region in `edit` and `decoy` views; a true prior."""
    flagged = np.zeros((VIEWS, COUNT), bool)
    flagged[:edit, TRUE] = True
    flagged[VIEWS - decoy :, KINDS == DECOY] = True
    own = np.where(TRUE, 0.45, 0.2) + 0.05 * np.random.default_rng(3).random(COUNT)
    return masked(flagged), Prior(probability=own, verdict=0.4, known=ALL)


@pytest.mark.parametrize(("views", "decided"), [(7, True), (11, False)])
def test_attributes_decide_between_rivals_only_where_masks_give_no_evidence(views, decided):
    evidence, given = rivals(views, views)
    alone, found = estimate(evidence), estimate(evidence, prior=given)
    apart = KINDS != DECOY
    assert alone.labels[~apart].mean() > 0.9
    assert found.labels[TRUE].mean() > 0.9
    assert found.labels[~apart].mean() < 0.1 or not decided
    np.testing.assert_array_equal(found.labels[apart], alone.labels[apart])
    assert decided or np.array_equal(found.labels, alone.labels)
    contradicted = "the masks agree on are not labelled, because their attributes contradict"
    assert any(contradicted in text for text in found.warnings) == decided
    light = dataclasses.replace(ESTIMATOR, prior_weight=0.49)
    np.testing.assert_array_equal(estimate(evidence, light, given).labels, alone.labels)


def test_the_scene_probability_is_that_of_the_region_that_is_left():
    evidence, given = rivals(6, 7)
    found = estimate(evidence, prior=given)
    assert found.labels[KINDS == DECOY].mean() < 0.1
    assert found.verdict is not None
    assert found.verdict == pytest.approx(verdict_of(rivals(6, 0)[0]), abs=0.02)
    assert found.verdict < verdict_of(evidence) - 0.1
    assert any("flagged in 50% of the views" in text for text in found.warnings)


def test_a_prior_with_weight_0_changes_nothing():
    estimator = dataclasses.replace(ESTIMATOR, prior_weight=0.0)
    with_prior, without = (
        estimate(decoy_in(4), estimator, prior) for prior in (true_prior(0.99), None)
    )
    np.testing.assert_array_equal(with_prior.tamper, without.tamper)
    assert with_prior.verdict == without.verdict


@pytest.mark.parametrize("threshold", [0.01, 0.999999])
def test_the_scene_probability_does_not_depend_on_the_threshold(threshold):
    evidence = masked(failing("mixture"))
    changed = dataclasses.replace(ESTIMATOR, threshold=threshold)
    assert verdict_of(evidence, changed) == verdict_of(evidence)


HALF = np.arange(40) < 20
SOME_ROLES = Roles(
    inverted=np.zeros(4, bool),
    patterns=np.zeros((2, 4), bool),
    tampered=np.array([False, True]),
    rates=np.full(2, 0.5),
    seen=np.full(2, 4.0),
)


def sentences(agreed, labels, *, verdicts=(0.9, 0.9), prior=None, inverted=0) -> list[str]:
    roles = dataclasses.replace(SOME_ROLES, inverted=np.arange(4) < inverted)
    return diagnostics.warnings(roles, agreed, labels, verdicts, prior)


@pytest.mark.parametrize(("count", "warned"), [(0, False), (1, False), (2, True)])
def test_more_than_a_twentieth_of_conflicts_is_a_warning(count, warned):
    fewer = HALF & (np.arange(40) >= count)
    prior = Prior(probability=HALF.astype(float), verdict=0.9, known=np.ones(40, bool))
    added = sentences(fewer, HALF)
    dropped = sentences(HALF, fewer)
    missed = sentences(fewer, fewer, prior=prior)
    for found, words in (
        (added, f"{count} of 20 labelled Gaussians are labelled because of their attributes"),
        (dropped, f"{count} of 20 Gaussians that the masks agree on are not labelled"),
        (missed, f"{count} of 20 Gaussians that the attributes alone would label are not"),
    ):
        assert [words in text for text in found] == [True] * warned


def test_a_prior_that_is_not_likely_or_known_conflicts_with_nothing():
    prior = Prior(probability=np.where(HALF, 0.0, 0.5), verdict=0.9, known=np.ones(40, bool))
    assert sentences(HALF, HALF, prior=prior) == []
    sure = dataclasses.replace(prior, probability=np.where(HALF, 0.0, 0.6))
    assert len(sentences(HALF, HALF, prior=sure)) == 1
    assert sentences(HALF, HALF, prior=dataclasses.replace(sure, known=HALF)) == []
    assert sentences(HALF, HALF, prior=dataclasses.replace(sure, verdict=0.5)) == []


def test_weak_masks_are_a_warning_that_names_what_decided():
    assert sentences(HALF, HALF, verdicts=(0.5, 0.5)) == []
    (nothing,) = sentences(HALF, HALF, verdicts=(0.49, 0.49))
    (attributes,) = sentences(HALF, HALF, verdicts=(0.49, 0.5))
    assert nothing.endswith("perhaps nothing was edited.")
    assert attributes.endswith("comes from the attributes of the Gaussians.")


def test_more_than_half_of_the_masks_inverted_is_a_warning():
    assert sentences(HALF, HALF, inverted=2) == []
    (warning,) = sentences(HALF, HALF, inverted=3)
    assert warning.startswith("3 of 4 masks")


def test_nothing_agreed_or_nothing_labelled_is_a_disagreement():
    for agreed, labels in ((HALF, HALF & ~HALF), (HALF & ~HALF, HALF)):
        (warning,) = sentences(agreed, labels)
        assert warning.startswith(DISAGREEMENT)
        assert ("come from the attributes" in warning) == labels.any()


def test_a_mask_is_reliable_if_it_flags_more_than_half_of_the_labelled_weight():
    total, flagged = np.array([[8.0], [8], [0.8], [0.9]]), np.array([[4.0], [4.1], [0.8], [0.9]])
    evidence = Evidence(total=total, tampered=flagged)
    words = ("uninformative", "reliable", "unseen", "reliable")
    assert diagnostics.reliability(evidence, np.ones(1, bool), SOME_ROLES) == words
    assert diagnostics.reliability(evidence, np.zeros(1, bool), SOME_ROLES) == ()
    assert diagnostics.reliability(evidence, np.ones(1, bool), None) == ()


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


def test_a_score_at_the_threshold_is_not_labelled():
    scores = estimate(MIXED).tamper
    some = float(scores[np.argsort(scores)[COUNT // 2]])
    found = estimate(MIXED, dataclasses.replace(ESTIMATOR, threshold=some))
    assert (found.tamper == some).any()
    assert np.array_equal(found.labels, found.tamper > some)
