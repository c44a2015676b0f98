"""Two opinions as one: what the masks say, and what the Gaussians themselves say of an edit.

Neither knows of the other, and both know how sure they are: the estimator by how many views agree,
the native evidence by its verdict on the scene.
"""

import dataclasses
import math

import numpy as np

from gsc_jax.scene import Array


@dataclasses.dataclass(frozen=True, kw_only=True)
class Prior:
    """What is known without the masks.

    Attributes:
        probability: That a Gaussian is tampered, if anything is, shape (N,) in [0, 1].
        verdict: Probability that anything is.
    """

    probability: np.ndarray
    verdict: float


def pooled(probability: np.ndarray, prior: Prior, doubt: np.ndarray) -> np.ndarray:
    """The probability of each Gaussian to be tampered by both: a linear pool (Stone, 1961).

    As far as the masks are in doubt the Gaussian is what the prior says, as far as that itself is
    sure that anything was edited.

    Args:
        probability: What the masks say of N Gaussians, shape (N,).
        prior: What is known without them.
        doubt: How likely the masks show no edit, shape (N,); 1 where no view sees a Gaussian.

    Returns:
        The probability by both, shape (N,) float32.
    """
    weight = doubt * prior.verdict
    return ((1 - weight) * probability + weight * prior.probability).astype(np.float32)


def both(certain: float, log_odds: float) -> float:
    """A probability after independent evidence of these log odds."""
    return float(certain / (certain + (1 - certain) * math.exp(-log_odds)))


def log_odds_of(probability: Array | float) -> np.ndarray:
    """Log odds of probabilities of any shape, bounded where those are 0 or 1."""
    within = np.clip(np.asarray(probability, np.float64), 1e-9, 1 - 1e-9)
    return np.log(within / (1 - within))
