"""Forensic evidence: combination of classifier and traces, and its use by `locate`."""

import dataclasses

import jax
import numpy as np
import pytest
from export import export
from forensics_cases import (
    BASE,
    PEAK,
    TRACES,
    changed,
    classified,
    evidence_of,
    peak_of,
    two_groups,
)
from scipy.special import expit, logit

from gsc_jax import locate
from gsc_jax.benchmark.metrics import auc, confusion, truth_mask
from gsc_jax.benchmark.scenes import make_room, tampered_room
from gsc_jax.forensics.calibration import LEVEL_BESIDE_TRACES, MAX_LOG_ODDS
from gsc_jax.forensics.classifier import default_classifier
from gsc_jax.forensics.evidence import (
    add_traces,
    combine,
    estimate_from_attributes,
    forensic_evidence,
)
from gsc_jax.forensics.traces import Trace

MADE = tampered_room(count=6_000, views=2, heldout=1, width=64, height=48, seed=12)
SAVED = export(MADE.gaussians, "8 bits", seed=12).gaussians
SOME = SAVED.take(np.arange(3_000))


def test_pasted_object_is_found_in_an_export_without_traces():
    evidence = forensic_evidence(SAVED)
    assert auc(evidence.log_odds, MADE.labels) > 0.9
    assert 0 <= evidence.verdict <= 1


def test_the_edge_is_moved(monkeypatch):
    """Without it, more of what surrounds the object is labelled."""
    sharp = forensic_evidence(SAVED, with_traces=False)
    monkeypatch.setattr("gsc_jax.forensics.evidence.sharpened", lambda output, *_: output)
    blurred = forensic_evidence(SAVED, with_traces=False)
    assert sharp.level == blurred.level
    labels = MADE.labels
    scores = [confusion(one.log_odds > one.level, labels).f1 for one in (sharp, blurred)]
    assert scores[0] > scores[1]


def test_traces_are_computed_unless_they_are_declined():
    assert len(forensic_evidence(SOME).traces) == len(TRACES)
    assert forensic_evidence(SOME, with_traces=False).traces == ()


@pytest.mark.parametrize("option", ["threshold", "min_verdict"])
@pytest.mark.parametrize("value", [-0.1, 1.1, np.nan])
def test_thresholds_that_are_no_probabilities_are_errors(option, value):
    with pytest.raises(ValueError, match=r"in \[0, 1\]"):
        estimate_from_attributes(evidence_of([BASE] * 40, 0.3), **{option: value})


def test_permuting_rows_permutes_log_odds():
    order = np.random.default_rng(0).permutation(len(SAVED))
    one, other = forensic_evidence(SAVED), forensic_evidence(SAVED.take(order))
    np.testing.assert_allclose(other.log_odds, one.log_odds[order], atol=0.05)


def test_invalid_rows_are_unknown_and_change_no_others():
    evidence = forensic_evidence(changed(SAVED, slice(20), means=np.nan))
    assert not evidence.known[:20].any()
    assert (evidence.log_odds[:20] == np.float32(default_classifier().base)).all()
    assert np.isfinite(evidence.log_odds).all()
    assert auc(evidence.log_odds[20:], MADE.labels[20:]) > 0.9


ODD = [
    *(SAVED.take(np.arange(count)) for count in (1, 5, 16, 17, 40)),
    changed(SOME, slice(5), log_scales=-np.inf, logit_opacities=[np.inf, -np.inf, 0, 0, 0]),
    changed(SOME, slice(None), log_scales=-3, quats=1, sh=0, logit_opacities=0),
]


@pytest.mark.parametrize("scene", ODD, ids=["1", "5", "16", "17", "40", "flat", "identical"])
def test_small_and_degenerate_scenes_give_finite_evidence(scene):
    evidence = forensic_evidence(scene)
    assert evidence.known.all() == (len(scene) > 16), "fewer have no surroundings"
    assert np.isfinite(evidence.log_odds).all()
    assert np.isfinite(evidence.verdict)


def test_trace_suffices_alone_and_raises_the_level_of_the_others():
    around = LEVEL_BESIDE_TRACES + np.array([0.1, -0.1])
    evidence = evidence_of([BASE, BASE, *around], 0.3, rows=(0,), peak=around.max())
    finding = estimate_from_attributes(evidence)
    assert finding.labels.tolist() == [True, False, True, False]
    relative = evidence.log_odds - LEVEL_BESIDE_TRACES
    np.testing.assert_allclose(finding.attribute, relative, atol=1e-5)
    np.testing.assert_array_equal(evidence.probability, finding.tamper)
    assert evidence.verdict > 0.999
    assert not evidence.exact, "either copy may be the edit"
    assert combine(evidence.classification, ()).verdict == pytest.approx(0.3)
    assert not combine(evidence.classification, ()).traces


@pytest.mark.parametrize("score", [0.0, 0.5, 0.9])
def test_scene_is_edited_if_classifier_or_strongest_trace_is_right(score):
    traces = [trace(score, 0.0), trace(0.0, score / 2)]
    combined = combine(classified([BASE, BASE], 0.3), traces)
    assert combined.verdict == pytest.approx(1 - 0.7 * (1 - score))
    assert combine(combined.classification, ()).verdict == pytest.approx(0.3)


def trace(*score: float, name: str = "quantisation") -> Trace:
    return Trace(name=name, score=np.array(score, np.float32), explanation="")


def test_thresholds_of_scores_are_exclusive_and_that_of_the_scene_is_inclusive():
    evidence = evidence_of([BASE, 0.0, PEAK], 0.5)
    score = float(evidence.probability[1])
    finding = estimate_from_attributes(evidence, threshold=score, min_verdict=evidence.verdict)
    assert finding.labels.tolist() == [False, False, True]
    assert finding.warnings == []
    above = np.nextafter(evidence.verdict, 1)
    assert not estimate_from_attributes(evidence, min_verdict=above).labels.any()


@pytest.mark.parametrize("edited", [400, 5_000])
@pytest.mark.parametrize("probability", [0.3, 0.9])
def test_labels_are_above_the_gap_however_sure_the_classifier_is(edited: int, probability: float):
    log_odds = two_groups(0, edited)
    evidence = evidence_of(log_odds, probability, peak=peak_of(log_odds))
    labels = estimate_from_attributes(evidence).labels
    assert labels[-edited:].mean() > 0.97
    assert labels[:-edited].mean() < 0.02


def test_traces_that_mark_little_above_the_level_do_not_identify_the_edit():
    log_odds = two_groups(1, 2_000)
    peak = peak_of(log_odds)
    few = estimate_from_attributes(evidence_of(log_odds, rows=(0, -1), peak=peak)).labels
    assert few[0]
    assert few[-2_000:].mean() > 0.97
    unsure = estimate_from_attributes(evidence_of(log_odds, 0.4, rows=(0, -1), peak=peak)).labels
    assert unsure.sum() < few.sum(), "the trace alone would call the scene edited"
    rows = tuple(range(-1_500, 0))
    most = estimate_from_attributes(evidence_of(log_odds, rows=rows, peak=peak)).labels
    assert most[-1_500:].all()
    assert most[-2_000:-1_500].mean() < 0.9


@pytest.mark.parametrize(("marked", "exact"), [(1_500, True), (100, False)])
def test_trace_that_marks_most_labels_makes_the_prior_exact(marked, exact):
    rows = tuple(range(-marked, 0))
    assert evidence_of(two_groups(1, 2_000), rows=rows, name="quantisation").exact == exact


@pytest.mark.parametrize(
    ("marked", "name", "exact"),
    [
        ((0.0, 0.999), "quantisation", False),
        ((0.999, 0.999), "quantisation", True),
        ((0.5, 0.5), "quantisation", False),
        ((0.999, 0.999), "copy-move", False),
    ],
)
def test_trace_must_mark_more_than_half_of_the_labels(marked, name, exact):
    combined = combine(classified([PEAK, PEAK, BASE]), [trace(*marked, 0.0, name=name)])
    assert combined.exact == exact


def test_unknown_gaussians_have_probability_0():
    output = dataclasses.replace(classified([PEAK, PEAK]), known=np.array([True, False]))
    probability = combine(output, ()).probability
    assert probability[0] > 0.5
    assert probability[1] == 0
    assert estimate_from_attributes(combine(output, ())).attribute[1] == 0


def test_nothing_is_labelled_below_the_minimum_verdict():
    evidence = evidence_of([3.0, -3.0], 0.01)
    finding = estimate_from_attributes(evidence)
    assert not finding.labels.any()
    assert not finding.tamper.any()
    assert estimate_from_attributes(evidence, min_verdict=0.0).labels.tolist() == [True, False]


def test_locate_without_a_detector_uses_the_attributes():
    result = locate(SAVED, MADE.cameras, None)
    assert set(result.masks) == {camera.name for camera in MADE.cameras}
    evidence = forensic_evidence(SAVED)
    assert result.verdict == evidence.verdict
    again = locate(SAVED, MADE.cameras, None, prior=evidence)
    np.testing.assert_array_equal(again.labels, result.labels)
    with pytest.raises(ValueError, match="detector"):
        locate(SAVED, MADE.cameras, None, prior=False)
    with pytest.raises(ValueError, match="detector"):
        locate(SAVED, MADE.cameras, None, method="paper")


def test_empty_masks_overrule_likely_evidence_but_not_certain_evidence():
    black = {camera.name: np.zeros((48, 64), np.float32) for camera in MADE.cameras}
    log_odds = np.where(MADE.labels, 9.0, -5.0)
    certain = locate(SAVED, MADE.cameras, black, prior=evidence_of(log_odds, 1 - 1e-6))
    np.testing.assert_array_equal(certain.labels, MADE.labels)
    likely = locate(SAVED, MADE.cameras, black, prior=evidence_of(log_odds, 0.4))
    assert not likely.labels.any()
    assert likely.verdict is not None
    assert likely.verdict < 0.1


def test_attributes_raise_the_verdict_of_masks_and_never_lower_it():
    masks = {c.name: truth_mask(SAVED, c, MADE.labels) for c in MADE.cameras}
    verdicts = [
        locate(SAVED, MADE.cameras, masks, prior=evidence_of(np.full(6_000, BASE), p)).verdict or 0
        for p in (0.1, 0.5, 0.9)
    ]
    assert verdicts[0] == verdicts[1] < verdicts[2]
    assert verdicts[1] == pytest.approx(locate(SAVED, MADE.cameras, masks, prior=False).verdict)


def test_scenes_of_every_size_share_their_programs(caplog):
    """A scan of a collection would collect them otherwise, and compile for every scene."""
    first, second = make_room(seed=0, count=3_000), make_room(seed=1, count=4_100)
    forensic_evidence(first)
    with jax.log_compiles(), caplog.at_level("WARNING"):
        forensic_evidence(second)
    assert not [record.message for record in caplog.records if "Compiling" in record.message]


@pytest.mark.parametrize("probability", [0.01, 0.5, 0.99])
@pytest.mark.parametrize("score", [0.0, 0.5, 0.999])
def test_log_odds_and_a_trace_are_joined_by_a_noisy_or(probability, score):
    joined = add_traces(logit(np.array([probability])), [trace(score)])
    expected = 1 - (1 - probability) * (1 - score)
    np.testing.assert_allclose(expit(joined), expected, rtol=1e-5)


def test_a_certain_trace_gives_the_largest_log_odds():
    assert add_traces(np.zeros(2), [trace(1.0, 0.0)]).tolist() == [MAX_LOG_ODDS, 0]
    assert add_traces(np.full(1, BASE), []).tolist() == [BASE]


def test_the_ends_of_the_unit_interval_are_valid_thresholds():
    evidence = evidence_of([BASE, 0.0, PEAK], 0.5)
    assert estimate_from_attributes(evidence, threshold=0.0, min_verdict=0.0).labels.any()
    assert not estimate_from_attributes(evidence, threshold=1.0).labels.any()
    assert not estimate_from_attributes(evidence, min_verdict=1.0).labels.any()


def test_too_few_gaussians_are_a_warning_and_an_outcome_is_none():
    few = forensic_evidence(SAVED.take(np.arange(5)))
    (warning,) = estimate_from_attributes(few).warnings
    assert "too few valid Gaussians" in warning
    assert not estimate_from_attributes(evidence_of([BASE] * 3, 0.5), threshold=1.0).warnings
