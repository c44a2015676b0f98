"""What a user should know before believing the labels of `robust`, in sentences."""

import numpy as np

from gsc_jax.finding import DISAGREE, Reliability
from gsc_jax.roles import Roles

ADDED = 0.05
"""Share of the labels above which it is said that they are not from the masks."""
OWN = " What is labelled is what the Gaussians themselves say."


def doubts(
    agreed: np.ndarray, roles: Roles | None, labels: np.ndarray, shown: float, certain: float
) -> list[str]:
    """Warnings where masks disagree, or where not they but the Gaussians say what is labelled.

    Args:
        agreed: Gaussians that the masks agree on, shape (N,) bool.
        roles: What the views are worth; None where they show one class only.
        labels: Gaussians that are labelled, shape (N,) bool.
        shown: Probability of an edit by the masks.
        certain: And by all that is known.

    Returns:
        Sentences.
    """
    if roles is None:
        return [DISAGREE + OWN * bool(labels.any())]
    said = [_about_masks(agreed, roles, labels, shown, certain)]
    own = labels & ~agreed
    if agreed.any() and own.sum() > ADDED * labels.sum():
        said.append(
            f"{own.sum():,} of {labels.sum():,} labelled Gaussians are so by what they say "
            "themselves, not by the masks."
        )
    if roles.inverted.mean() > 0.5:
        said.append(
            f"{roles.inverted.sum()} of {len(roles.inverted)} masks flag the larger part of the "
            "scene and were read the other way round; if that part was tampered with, use another "
            "method."
        )
    return [sentence for sentence in said if sentence]


def _about_masks(
    agreed: np.ndarray, roles: Roles, labels: np.ndarray, shown: float, certain: float
) -> str:
    """What became of what the masks agree on; nothing to say where they do, and are believed."""
    rate = f"was flagged in {roles.rate:.0%} of the views that see it"
    if not (agreed.any() and labels.any()):
        often = f" None was flagged in more than {roles.rate:.0%} of those that see it."
        return DISAGREE + often + OWN * bool(labels.any())
    if not (agreed & labels).any():
        return f"What the masks agree on {rate}, and is not labelled.{OWN}"
    if shown >= 0.5:
        return ""
    so = "perhaps nothing was tampered with"
    if certain >= 0.5:
        so = "that something was tampered with is said by the Gaussians themselves"
    return f"What the masks agree on {rate}, as often happens to authentic things: {so}."


def reliability_of(roles: Roles) -> tuple[Reliability, ...]:
    """What the mask of each view is worth."""
    told = np.where(roles.finds, "finds", "misses")
    told = np.where(roles.sees, told, "unseen")
    return tuple(np.where(roles.inverted, "inverted", told).tolist())
