"""What a user should know of the labels of `robust`: in sentences, and what each mask is worth."""

import numpy as np

from gsc_jax.estimators.protocol import DISAGREE, Reliability
from gsc_jax.estimators.robust.class_roles import SEEN, Roles
from gsc_jax.estimators.robust.prior_fusion import Prior
from gsc_jax.evidence.lifting import Evidence

FEW = 0.05
"""Share of what one side names up to which it does not matter that the other does not."""
OWN = " What is labelled is what the Gaussians themselves say."


def doubts(
    agreed: np.ndarray,
    roles: Roles | None,
    labels: np.ndarray,
    verdicts: tuple[float, float],
    prior: Prior | None = None,
) -> list[str]:
    """Warnings where masks disagree, or where not they but the Gaussians say what is labelled.

    Args:
        agreed: Gaussians that the masks agree on, shape (N,) bool.
        roles: What the views are worth; None where they show one class only.
        labels: Gaussians that are labelled, shape (N,) bool.
        verdicts: Probability of an edit by the masks, and by all that is known.
        prior: What is known without the masks.

    Returns:
        Sentences.
    """
    if roles is None:
        return [DISAGREE + OWN * bool(labels.any())]
    if not (agreed.any() and labels.any()):
        often = f" None was flagged in more than {roles.rate:.0%} of those that see it."
        said = [DISAGREE + often + OWN * bool(labels.any())]
    else:
        said = [*_about_masks(roles, verdicts), *_about_both(agreed, labels, prior)]
    if roles.inverted.mean() > 0.5:
        said.append(
            f"{roles.inverted.sum()} of {len(roles.inverted)} masks flag the larger part of the "
            "scene and were read the other way round; if that part was tampered with, use another "
            "method."
        )
    return said


def _about_masks(roles: Roles, verdicts: tuple[float, float]) -> list[str]:
    """What is to be thought of what the masks agree on."""
    shown, certain = verdicts
    if shown >= 0.5:
        return []
    so = "perhaps nothing was tampered with"
    if certain >= 0.5:
        so = "that something was tampered with is said by the Gaussians themselves"
    return [
        f"What the masks agree on was flagged in {roles.rate:.0%} of the views that see it, as "
        f"often happens to authentic things: {so}."
    ]


def _about_both(agreed: np.ndarray, labels: np.ndarray, prior: Prior | None) -> list[str]:
    """Where masks and Gaussians name different things, what became of both."""
    said, own, dropped = [], labels & ~agreed, agreed & ~labels
    if own.sum() > FEW * labels.sum():
        said.append(
            f"{own.sum():,} of {labels.sum():,} labelled Gaussians are so by what they say "
            "themselves, not by the masks."
        )
    if dropped.sum() > FEW * agreed.sum():
        said.append(
            f"{dropped.sum():,} of {agreed.sum():,} Gaussians that the masks agree on are not "
            "labelled: the Gaussians themselves say otherwise."
        )
    named = prior.known & (prior.probability > 0.5) if prior and prior.verdict > 0.5 else labels
    if (named & ~labels).sum() > FEW * named.sum():
        said.append(
            f"{(named & ~labels).sum():,} of {named.sum():,} Gaussians that stand out by "
            "themselves are not labelled: the masks say otherwise."
        )
    return said


def reliability_of(
    evidence: Evidence, labels: np.ndarray, inverted: np.ndarray
) -> tuple[Reliability, ...]:
    """What the mask of each view is worth: whether it flags most of what is labelled.

    Args:
        evidence: What V views say of N Gaussians, shapes (V, N).
        labels: Gaussians that are labelled, shape (N,) bool.
        inverted: Views whose mask is to be read the other way round, shape (V,) bool.

    Returns:
        A word per view.
    """
    total, flagged = (
        np.array([row[labels].sum(dtype=np.float64) for row in np.asarray(part)])
        for part in (evidence.total, evidence.tampered)
    )
    told = np.where(2 * flagged > total, "finds", "misses")
    told = np.where(2 * total > SEEN * total.max(initial=0.0), told, "unseen")
    return tuple(np.where(inverted, "inverted", told).tolist())
