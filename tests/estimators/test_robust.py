"""The estimator: what masks may do wrong, what must not matter to it, and evidence of any kind."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from gsc_jax.estimators.protocol import NOTHING
from gsc_jax.estimators.robust.class_roles import assign_roles, verdict
from gsc_jax.estimators.robust.estimator import (
    RobustConfig,
    disagreement,
    estimate,
    find_robust,
    looks_of,
)
from gsc_jax.estimators.robust.prior_fusion import Prior
from gsc_jax.evidence.lifting import Evidence

VIEWS, COUNT = 12, 400
CONFIG = RobustConfig(sample=512)
AUTHENTIC, TAMPERED, DECOY = 0, 1, 2


def world(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Kinds (N,), centres (N, 3) in three heaps, and what each view sees of each Gaussian."""
    rng = np.random.default_rng(seed)
    kinds = rng.choice([AUTHENTIC, TAMPERED, DECOY], COUNT, p=[0.7, 0.15, 0.15])
    means = rng.normal(size=(COUNT, 3)) + 20 * np.eye(3)[kinds]
    total = rng.exponential(20, (VIEWS, COUNT)) * (rng.random((VIEWS, COUNT)) < 0.8)
    return kinds, means.astype(np.float32), total.astype(np.float32)


KINDS, MEANS, TOTAL = world()
TRUE = KINDS == TAMPERED


def masked(flagged: np.ndarray, total: np.ndarray = TOTAL, noise: float = 0.05) -> Evidence:
    """Evidence of masks that flag these Gaussians in these views (V, N), but for a few percent."""
    rng = np.random.default_rng(1)
    rate = np.where(flagged, 1 - noise * rng.random(total.shape), noise * rng.random(total.shape))
    return Evidence(total=total, tampered=(total * rate).astype(np.float32))


def failing(failure: str) -> np.ndarray:
    """What is flagged, shape (V, N), by a detector that fails in one way."""
    flagged = np.tile(TRUE, (VIEWS, 1))
    if failure in ("misses", "mixture"):
        flagged[[1, 4, 9]] = False
    if failure in ("consistent", "mixture"):
        flagged[np.ix_([0, 1, 3, 6, 8], KINDS == DECOY)] = True
    if failure in ("inverted", "mixture"):
        flagged[[2, 7]] = ~flagged[[2, 7]]
    return flagged


def verdict_of(evidence: Evidence, config: RobustConfig = CONFIG) -> float:
    found = find_robust(evidence, MEANS, config).verdict
    assert found is not None
    return found


def labels_of(evidence: Evidence, means: np.ndarray = MEANS) -> np.ndarray:
    return estimate(evidence, means, CONFIG).probability > 0.5


@pytest.mark.parametrize("failure", ["clean", "misses", "consistent", "inverted", "mixture"])
def test_what_is_tampered_is_found_whatever_the_detector_does_wrong(failure):
    assert np.array_equal(labels_of(masked(failing(failure))), TRUE & (TOTAL.sum(0) > 0))


def test_inverted_and_missing_views_are_told():
    found = find_robust(masked(failing("mixture")), MEANS, CONFIG)
    expected = np.full(VIEWS, "finds", object)
    expected[[1, 4, 9]] = "misses"
    expected[[2, 7]] = "inverted"
    assert list(found.reliability) == list(expected)


def test_a_method_that_believes_inverted_masks_finds_less_agreement():
    flagged = failing("clean")
    flagged[:5] = ~flagged[:5]
    believing = dataclasses.replace(CONFIG, inversion=False)
    believed, turned = (find_robust(masked(flagged), MEANS, c) for c in (believing, CONFIG))
    assert verdict_of(masked(flagged), believing) < 0.7 < 0.99 < verdict_of(masked(flagged))
    assert "inverted" not in believed.reliability
    assert turned.reliability[:5] == ("inverted",) * 5


def test_a_clean_mask_of_an_edit_that_fills_the_image_is_not_taken_for_inverted():
    total = TOTAL.copy()
    total[3, ~TRUE] *= 0.01
    total[3, TRUE] += 100
    evidence = masked(failing("clean"), total)
    assert evidence.tampered[3].sum() > 0.9 * evidence.total[3].sum(), "the edit fills this view"
    found = estimate(evidence, MEANS, CONFIG)
    assert found.roles is not None
    assert not found.roles.inverted.any()
    assert np.array_equal(found.probability > 0.5, TRUE)


def test_a_second_edit_that_is_detected_nearly_as_often_is_kept():
    flagged = failing("clean")
    flagged[:, KINDS == DECOY] = True
    flagged[np.ix_([2, 5], KINDS == DECOY)] = False
    assert np.array_equal(labels_of(masked(flagged)), KINDS != AUTHENTIC)


def test_the_verdict_rises_with_the_share_of_the_views_that_find_it():
    assert verdict_of(masked(failing("clean"))) > verdict_of(masked(failing("misses"))) > 0.5
    assert verdict(0.55, 10) == pytest.approx(0.5)
    decoy = failing("consistent") & (KINDS == DECOY)
    decoy[8:] = False
    untouched = find_robust(masked(decoy), MEANS, CONFIG)
    assert verdict_of(masked(decoy)) < 0.5
    assert any("perhaps nothing was tampered with" in text for text in untouched.warnings)


def test_what_few_views_flag_is_labelled_only_if_that_is_asked_for():
    flagged = np.zeros((VIEWS, COUNT), bool)
    flagged[np.ix_([2, 7], KINDS == DECOY)] = True
    few = find_robust(masked(flagged), MEANS, CONFIG)
    assert not few.labels.any()
    assert not few.tamper.any()
    assert any("None was flagged in more than 17% of those" in text for text in few.warnings)
    believing = find_robust(masked(flagged), MEANS, dataclasses.replace(CONFIG, doubt=0.0))
    assert np.array_equal(believing.labels, KINDS == DECOY)


@pytest.mark.parametrize(
    "wrong",
    [
        {"mask_rule": "all"},
        {"sample": 0},
        {"trust": 0.0},
        {"threshold": 1.0},
        {"doubt": -0.1},
        {"native": 2.0},
    ],
)
def test_a_configuration_without_meaning_is_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        RobustConfig(**wrong)


def test_nothing_flagged_and_everything_flagged_are_defined():
    nothing = find_robust(Evidence(total=TOTAL, tampered=np.zeros_like(TOTAL)), MEANS, CONFIG)
    assert not nothing.labels.any()
    assert nothing.verdict == verdict(0.0, VIEWS)
    everything = find_robust(Evidence(total=TOTAL, tampered=TOTAL), MEANS, CONFIG)
    assert np.array_equal(everything.labels, TOTAL.sum(0) > 0)


MIXED = masked(failing("mixture"))
LABELS = labels_of(MIXED)


def rows(evidence: Evidence, order) -> Evidence:
    return Evidence(total=evidence.total[order], tampered=evidence.tampered[order])


@given(st.permutations(range(VIEWS)))
def test_the_order_of_the_views_does_not_matter(order):
    assert np.array_equal(labels_of(rows(MIXED, list(order))), LABELS)


@given(st.integers(0, 2**32 - 1))
def test_the_order_of_the_gaussians_does_not_matter(seed):
    order = np.random.default_rng(seed).permutation(COUNT)
    evidence = Evidence(total=MIXED.total[:, order], tampered=MIXED.tampered[:, order])
    assert np.array_equal(labels_of(evidence, MEANS[order]), LABELS[order])


@pytest.mark.parametrize("view", range(0, VIEWS, 3))
def test_a_view_may_be_given_twice(view):
    assert np.array_equal(labels_of(rows(MIXED, [*range(VIEWS), view])), LABELS)


@pytest.mark.parametrize("sees", [True, False])
def test_a_view_that_flags_or_sees_nothing_may_be_added(sees):
    more = TOTAL[:1] if sees else np.zeros_like(TOTAL[:1])
    total = np.concatenate([TOTAL, more])
    tampered = np.concatenate([MIXED.tampered, np.zeros_like(more)])
    assert np.array_equal(labels_of(Evidence(total=total, tampered=tampered)), LABELS)


def test_complementing_all_masks_changes_nothing():
    complement = Evidence(total=TOTAL, tampered=TOTAL - MIXED.tampered)
    assert np.array_equal(labels_of(complement), LABELS)
    warnings = find_robust(complement, MEANS, CONFIG).warnings
    assert any("read the other way round" in text for text in warnings)


@pytest.mark.parametrize("scale", [1e-3, 1e3])
def test_the_unit_of_the_scene_does_not_matter(scale):
    assert np.array_equal(labels_of(MIXED, MEANS * np.float32(scale)), LABELS)


def test_two_halves_of_the_evidence_merge_to_the_whole():
    whole = [*range(1, VIEWS, 2), *range(0, VIEWS, 2)]
    assert np.array_equal(labels_of(rows(MIXED, whole)), LABELS)
    first, second = rows(MIXED, whole[: VIEWS // 2]), rows(MIXED, whole[VIEWS // 2 :])
    roles = estimate(MIXED, MEANS, CONFIG).roles
    assert roles is not None
    halves = [
        dataclasses.replace(roles, inverted=roles.inverted[some], patterns=roles.patterns[:, some])
        for some in (whole[: VIEWS // 2], whole[VIEWS // 2 :])
    ]
    parts = [
        disagreement(part, half, CONFIG.trust)
        for part, half in zip((first, second), halves, strict=True)
    ]
    np.testing.assert_allclose(sum(parts), disagreement(MIXED, roles, CONFIG.trust), atol=1e-4)


def test_the_estimate_is_the_same_to_the_bit():
    first, second = (estimate(MIXED, MEANS, CONFIG).probability for _ in range(2))
    assert first.tobytes() == second.tobytes()


WEIGHTS = st.sampled_from([0.0, 1e-30, 1e-3, 1.0, 50.0, 1e6])
SURE = st.sampled_from([0.0, 0.3, 0.6, 1.0])


def priors(count: int) -> st.SearchStrategy[Prior]:
    """What may be known of so many Gaussians."""
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
    share = data.draw(
        hnp.arrays(np.float32, (views, count), elements=st.sampled_from([0.0, 0.5, 1.0]))
    )
    means = data.draw(
        hnp.arrays(np.float32, (count, 3), elements=st.sampled_from([0.0, 1.0, 1e30, np.nan]))
    )
    prior = data.draw(st.none() | priors(count))
    with np.errstate(over="ignore"):
        found = find_robust(Evidence(total=total, tampered=total * share), means, CONFIG, prior)
    assert np.isfinite(found.tamper).all()
    assert np.isfinite(found.attribute).all()
    assert 0 <= found.tamper.min() <= found.tamper.max() <= 1
    known = (total.sum(0) > 0) | (prior is not None and prior.known & (prior.probability > 0))
    assert not found.labels[~known].any(), "what nothing saw was found tampered"
    assert found.verdict is not None
    assert 0 < found.verdict < 1


@pytest.mark.usefixtures("nan_is_an_error")
def test_no_nan_is_made_on_the_way():
    estimate(MIXED, MEANS, CONFIG)


def test_disagreement_counts_looks_that_contradict_a_pattern():
    total = np.array([[8.0, 8.0], [8.0, 0.0]], np.float32)
    evidence = Evidence(total=total, tampered=np.array([[8.0, 2.0], [0.0, 0.0]], np.float32))
    looked, flagged = looks_of(evidence, slice(None), 8.0)
    assert looked.tolist() == [[0.5, 0.5], [0.5, 0.0]]
    assert flagged.tolist() == [[0.5, 0.125], [0.0, 0.0]]
    roles = assign_roles(np.array([[0.1, 0.1], [0.9, 0.9]]), np.array([[9.0, 9.0], [1.0, 1.0]]))
    assert roles is not None
    # Authentic: what was flagged; tampered: what was not.
    expected = [[0.5, 0.5], [0.125, 0.375]]
    assert disagreement(evidence, roles, 8.0).tolist() == expected


def decoy_in(views: int) -> Evidence:
    """Masks that flag the decoy in some views: in few, as happens to authentic things, or most."""
    flagged = np.zeros((VIEWS, COUNT), bool)
    flagged[:views, KINDS == DECOY] = True
    return masked(flagged)


def knowing(verdict: float, *, exact: bool = False) -> Prior:
    """What the Gaussians say where they know the truth."""
    own, known = np.where(TRUE, 0.99, 0.0), np.ones(COUNT, bool)
    return Prior(probability=own, verdict=verdict, known=known, exact=exact)


@pytest.mark.parametrize(
    ("views", "verdict", "exact", "decoy"),
    [
        (4, 0.9999, False, False),
        (4, 0.3, False, True),
        (6, 0.95, False, False),
        (11, 0.9999, False, True),
        (11, 0.9999, True, False),
        (11, 0.9, True, True),
    ],
)
def test_the_gaussians_are_believed_as_far_as_the_masks_are_not(views, verdict, exact, decoy):
    """What few views flag is a decoy; what nearly all flag is something."""
    found = find_robust(decoy_in(views), MEANS, CONFIG, knowing(verdict, exact=exact))
    seen, expected = TOTAL.sum(axis=0) > 0, KINDS == DECOY if decoy else TRUE
    assert np.array_equal(found.labels[seen], expected[seen])
    assert np.array_equal(found.labels[~seen], TRUE[~seen] & (verdict > 0.5))
    assert found.verdict is not None
    assert found.verdict >= verdict_of(decoy_in(views))
    worth = "finds" if decoy else "misses"
    assert set(found.reliability[:views]) == {worth}, "what masks are worth in finding what is"
    overruled = "stand out" if decoy else "the masks agree on are not labelled"
    assert any(overruled in said for said in found.warnings) == (verdict > 0.5)


def test_what_no_view_flags_the_gaussians_may_name():
    nothing = masked(np.zeros((VIEWS, COUNT), bool), noise=0)
    found = find_robust(nothing, MEANS, CONFIG, knowing(0.9999))
    assert np.array_equal(found.labels, TRUE)
    assert found.warnings == [f"{NOTHING} What is labelled is what the Gaussians themselves say."]
    unsure = find_robust(nothing, MEANS, CONFIG, knowing(0.4))
    assert not unsure.labels.any()
    assert not unsure.tamper.any()


def test_what_is_labelled_without_the_masks_is_counted():
    masks = np.tile(TRUE & (np.cumsum(TRUE) % 2 == 0), (VIEWS, 1))
    unseen = TOTAL * (masks.any(axis=0) | ~TRUE)
    found = find_robust(masked(masks, unseen), MEANS, CONFIG, knowing(0.9))
    assert np.array_equal(found.labels, TRUE)
    more = (TRUE & ~masks[0]).sum()
    assert any(said.startswith(f"{more} of {TRUE.sum()} labelled") for said in found.warnings)
    assert (found.attribute[TRUE] > 0).all()


def test_a_view_that_shows_nothing_of_what_is_labelled_does_not_miss_it():
    away = TOTAL.copy()
    away[0, TRUE] = 0
    found = find_robust(masked(np.tile(TRUE, (VIEWS, 1)), away), MEANS, CONFIG, knowing(0.9))
    assert found.reliability == ("unseen", *["finds"] * (VIEWS - 1))


def test_a_prior_without_weight_has_no_say():
    config = dataclasses.replace(CONFIG, native=0.0)
    with_prior, without = (
        find_robust(decoy_in(4), MEANS, config, prior) for prior in (knowing(0.99), None)
    )
    np.testing.assert_array_equal(with_prior.tamper, without.tamper)
    assert with_prior.verdict == without.verdict


@pytest.mark.parametrize("threshold", [0.01, 0.999999])
def test_the_verdict_does_not_depend_on_where_labels_begin(threshold):
    evidence = masked(failing("mixture"))
    changed = dataclasses.replace(CONFIG, threshold=threshold)
    assert verdict_of(evidence, changed) == verdict_of(evidence)
