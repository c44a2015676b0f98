"""What a method finds, and what there is to find where the views leave nothing to weigh."""

import dataclasses
from typing import Literal

import numpy as np

from gsc_jax.evidence.lifting import Evidence

Reliability = Literal["finds", "misses", "inverted", "unseen"]
"""Whether a mask flags what is tampered; an inverted one flags everything else, and a view may not
show it at all."""
DISAGREE = "Pixels were flagged, but the views agree on no tampered Gaussian."
"""The warning of a method that finds nothing in masks that are not empty."""
NOTHING = "No view says that anything is tampered."
"""The warning where all masks are empty."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Finding:
    """What a method makes of an observation.

    Attributes:
        attribute: Raw attribute r, shape (N,) float32; unbounded. Of `robust` the log odds.
        tamper: Score in [0, 1], shape (N,) float32; 0 where nothing is known of a Gaussian.
        labels: Tampered Gaussians, shape (N,) bool.
        group_sizes: Sizes of G_h, G_m and G_l in every iteration, shape (iterations, 3).
        verdict: Probability that anything was tampered with; None of methods that cannot say.
        reliability: What the mask of each view is worth, of `robust` where views disagree.
        warnings: What a user should know, in sentences.
    """

    attribute: np.ndarray
    tamper: np.ndarray
    labels: np.ndarray
    group_sizes: np.ndarray
    verdict: float | None = None
    reliability: tuple[Reliability, ...] = ()
    warnings: list[str]


def undisputed(evidence: Evidence) -> Finding | None:
    """What there is to find where the views leave nothing to weigh.

    Args:
        evidence: What V views say of N Gaussians, shapes (V, N).

    Returns:
        Nothing tampered where no view flags anything, all that is seen where every view flags
        everything; None where methods have to weigh.
    """
    seen = evidence.seen
    if evidence.says_nothing:
        labels, said = np.zeros(len(seen), bool), NOTHING
    elif evidence.says_everything:
        labels, said = seen, "Every view says that everything is tampered."
    else:
        return None
    return Finding(
        attribute=np.zeros(len(seen), np.float32),
        tamper=labels.astype(np.float32),
        labels=labels,
        group_sizes=np.zeros((0, 3), np.int32),
        warnings=[said],
    )
