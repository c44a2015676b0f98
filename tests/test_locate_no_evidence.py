"""Results where masks are no evidence of an edit: full, the same in every view, or too few."""

import dataclasses

import numpy as np
import pytest
from test_locate import SCENE, TRUTH, cameras, everywhere, truths

from gsc_jax import Prior, estimate_from_attributes, forensic_evidence, locate


def test_masks_that_cover_everything_are_no_evidence_of_an_edit():
    assert locate(SCENE, cameras(), everywhere(1.0), prior=False).verdict == 0.5


def test_nothing_is_labelled_where_masks_are_no_evidence_and_the_prior_sees_no_edit():
    masks = dict.fromkeys(truths(), truths()["view_0"])  # the same pixels in every view
    chance = np.full(len(TRUTH), 0.5)
    prior = Prior(probability=chance, verdict=0.01, known=np.ones(len(TRUTH), bool))
    result = locate(SCENE, cameras(), masks, prior=prior)
    assert any("They are no evidence of an edit" in text for text in result.warnings)
    assert result.verdict == 0.01
    assert not result.labels.any()
    assert not result.tamper.any()


@pytest.mark.parametrize("verdict", [0.01, 0.3, 0.97])
def test_where_masks_are_no_evidence_the_result_is_that_of_the_attributes(verdict):
    masks = dict.fromkeys(truths(), truths()["view_0"])
    evidence = dataclasses.replace(forensic_evidence(SCENE), verdict=verdict)
    result = locate(SCENE, cameras(), masks, prior=evidence)
    alone = estimate_from_attributes(evidence)
    assert result.verdict == verdict
    assert np.array_equal(result.labels, alone.labels)
    assert np.array_equal(result.tamper, alone.tamper)
    assert any("They are no evidence of an edit" in text for text in result.warnings)


@pytest.mark.parametrize(("verdict", "expected"), [(0.01, 0.5), (0.97, 0.97)])
def test_full_masks_say_nothing_against_the_attributes(verdict, expected):
    evidence = dataclasses.replace(forensic_evidence(SCENE), verdict=verdict)
    result = locate(SCENE, cameras(), everywhere(1.0), prior=evidence)
    assert result.verdict == pytest.approx(expected)


OUTCOMES_OF_FEW = [(1, "inconclusive"), (2, "inconclusive"), (3, "evidence")]


@pytest.mark.parametrize(("count", "outcome"), OUTCOMES_OF_FEW)
def test_fewer_than_three_masks_alone_are_no_evidence(count, outcome):
    """False alarms agree in so few: a random rectangle in a single view is one region as well."""
    chosen = dict(list(truths().items())[:count])
    result = locate(SCENE, cameras(), chosen, prior=False)
    assert result.outcome == outcome
    assert result.labels.any(), "what the masks flag is a candidate"
    warned = any("agree in fewer than 3 masks" in text for text in result.warnings)
    assert warned == (outcome == "inconclusive")


def test_a_single_mask_is_never_taken_for_inverted():
    masks = {"view_0": truths()["view_0"] > 0.5}
    masks["view_0"][:, 12:] = True  # more than half of what is visible
    result = locate(SCENE, cameras(1), masks, prior=False)
    assert "inverted" not in result.reliability.values()


def test_without_views_the_attributes_decide():
    alone = estimate_from_attributes(forensic_evidence(SCENE))
    for nothing in ((), np.array([], object), iter(())):
        result = locate(SCENE, nothing, None)
        assert np.array_equal(result.labels, alone.labels)
        assert result.verdict == alone.verdict
        assert not result.masks
