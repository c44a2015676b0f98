"""Warnings of `robust`, and the reliability of a mask."""

import dataclasses

import numpy as np
import pytest

from gsc_jax.estimators import Prior
from gsc_jax.estimators.protocol import DISAGREEMENT
from gsc_jax.estimators.robust import diagnostics
from gsc_jax.estimators.robust.class_roles import Roles
from gsc_jax.evidence.lifting import Evidence

HALF = np.arange(40) < 20
SOME_ROLES = Roles(
    inverted=np.zeros(4, bool),
    patterns=np.zeros((2, 4), bool),
    unseen=np.zeros((2, 4), bool),
    tampered=np.array([False, True]),
    rates=np.full(2, 0.5),
    seen=np.full(2, 4.0),
    missed=0.0,
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
