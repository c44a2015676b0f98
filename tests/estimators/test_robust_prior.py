"""`robust` with masks and a prior from the attributes of Gaussians: which of both decides."""

import dataclasses

import numpy as np
import pytest
from failing_masks import (
    AUTHENTIC,
    COUNT,
    DECOY,
    ESTIMATOR,
    KINDS,
    TAMPERED,
    TOTAL,
    TRUE,
    VIEWS,
    estimate,
    failing,
    masked,
    verdict_of,
)

from gsc_jax.estimators import Prior
from gsc_jax.estimators.protocol import NONE_FLAGGED
from gsc_jax.evidence.lifting import Evidence

ALL = np.ones(COUNT, bool)


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
    """Masks flag an authentic region, and the prior is right.

    It decides if the masks flag the region in few views, or if it is exact and more certain.
    """
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
    """Otherwise the rank is that of the region that the masks label."""
    for views, exact, ranked in ((11, False, True), (11, True, False), (4, False, False)):
        found = estimate(decoy_in(views), prior=true_prior(0.9, exact=exact))
        assert (found.rank is not None) == ranked
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
    """Masks and a prior that is right.

    The masks flag the edit in `edit` of the views, and an authentic region in `decoy` of them.
    """
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


def test_a_prior_of_another_size_is_an_error_whatever_the_masks_say():
    other = Prior(probability=np.ones(3), verdict=0.9, known=ALL[:3])
    for weight in (0.0, 1.0):
        estimator = dataclasses.replace(ESTIMATOR, prior_weight=weight)
        for evidence in (decoy_in(4), decoy_in(0), decoy_in(VIEWS)):
            with pytest.raises(ValueError, match=f"the prior has 3 Gaussians, the scene {COUNT}"):
                estimate(evidence, estimator, other)
