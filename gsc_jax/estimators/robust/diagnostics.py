"""Diagnostics of `robust`: the reliability of every mask, and warnings about the labels."""

import numpy as np

from gsc_jax.estimators.protocol import DISAGREEMENT, Prior, Reliability
from gsc_jax.estimators.robust.class_roles import FULL_VIEW, MIN_MASKS, Roles
from gsc_jax.evidence.lifting import EvidenceOfViews

MIN_SHARE = 0.05
"""Masks and prior may differ in this share of what one of them labels without a warning."""
FROM_PRIOR = " The labels come from the attributes of the Gaussians."


def reliability(
    evidence: EvidenceOfViews, labels: np.ndarray, roles: Roles | None
) -> tuple[Reliability, ...]:
    """Reliability of the mask of each of V views, by the evidence of labelled Gaussians, (N,) bool.

    A word per view; empty if nothing is labelled or all Gaussians belong to one class.
    """
    if roles is None or not labels.any():
        return ()
    sums = [
        [np.asarray(part)[labels].sum(dtype=np.float64) for part in (view.total, view.tampered)]
        for view in evidence.views()
    ]
    total, flagged = np.array(sums).T
    words = np.where(2 * flagged > total, "reliable", "uninformative")
    words = np.where(2 * total > FULL_VIEW * total.max(initial=0.0), words, "unseen")
    return tuple(np.where(roles.inverted, "inverted", words).tolist())


def warnings(
    roles: Roles | None,
    agreed: np.ndarray,
    labels: np.ndarray,
    verdicts: tuple[float, float],
    prior: Prior | None = None,
) -> list[str]:
    """Sentences where masks disagree with each other or with the prior.

    `roles` are None if all Gaussians belong to one class; `agreed` (N,) are the Gaussians that the
    masks alone label; `verdicts` the scene probabilities from the masks alone and with the prior.
    """
    if roles is None:
        return [DISAGREEMENT + FROM_PRIOR * bool(labels.any())]
    if agreed.any() and labels.any():
        sentences = [*_weak_masks(roles, *verdicts), *_conflicts(agreed, labels, prior)]
    else:
        rate = f" No region is flagged in more than {roles.rate:.0%} of the views that see it."
        sentences = [DISAGREEMENT + rate + FROM_PRIOR * bool(labels.any())]
    if roles.few_views and labels.any():
        sentences.append(f"False alarms often agree in fewer than {MIN_MASKS} masks; give more.")
    if roles.inverted.mean() > 0.5:
        sentences.append(
            f"{roles.inverted.sum()} of {len(roles.inverted)} masks flag the larger part of the "
            "scene and were inverted; if that part was edited, use another method."
        )
    return sentences


def _weak_masks(roles: Roles, from_masks: float, verdict: float) -> list[str]:
    """Warn if the labelled region is flagged no more often than authentic regions are."""
    if from_masks >= 0.5:
        return []
    conclusion = "perhaps nothing was edited"
    if verdict >= 0.5:
        conclusion = "the evidence for an edit comes from the attributes of the Gaussians"
    return [
        f"The labelled region is flagged in {roles.rate:.0%} of the views that see it, weighted by "
        f"how much they see, which also happens to authentic regions: {conclusion}."
    ]


def _conflicts(agreed: np.ndarray, labels: np.ndarray, prior: Prior | None) -> list[str]:
    """Report how conflicts between the masks and the prior were decided."""
    sentences, added, dropped = [], labels & ~agreed, agreed & ~labels
    if added.sum() > MIN_SHARE * labels.sum():
        sentences.append(
            f"{added.sum():,} of {labels.sum():,} labelled Gaussians are labelled because of their "
            "attributes, not because of the masks."
        )
    if dropped.sum() > MIN_SHARE * agreed.sum():
        sentences.append(
            f"{dropped.sum():,} of {agreed.sum():,} Gaussians that the masks agree on are not "
            "labelled, because their attributes contradict the masks."
        )
    if prior is None or prior.verdict <= 0.5:
        return sentences
    likely = prior.known & (prior.probability > 0.5)
    if (likely & ~labels).sum() > MIN_SHARE * likely.sum():
        sentences.append(
            f"{(likely & ~labels).sum():,} of {likely.sum():,} Gaussians that the attributes alone "
            "would label are not labelled, because the masks contradict them."
        )
    return sentences
