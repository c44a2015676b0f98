"""Two opinions as one: what the masks say, and what is known without them.

Neither knows of the other, and both know how sure they are: the masks by how many views agree, what
is known without them (the prior, such as the native evidence) by its own verdict on the scene.
"""

import dataclasses
import math

import numpy as np

from gsc_jax.scene import Array


@dataclasses.dataclass(frozen=True, kw_only=True)
class Prior:
    """What is known without the masks.

    Attributes:
        probability: That a Gaussian is tampered, if anything is, shape (N,) in [0, 1], also where
            nothing is known.
        verdict: Probability that anything is.
        known: Gaussians of which it says something, shape (N,) bool.
        exact: Whether it tells exactly which are tampered; then masks do not overrule it.

    Raises:
        ValueError: if that is not what they are.
    """

    probability: np.ndarray
    verdict: float
    known: np.ndarray
    exact: bool = False

    def __post_init__(self) -> None:
        """Refuse what would spoil every Gaussian."""
        if not 0 <= self.verdict <= 1:
            raise ValueError(f"verdict must be in [0, 1], got {self.verdict}")
        within = (self.probability >= 0) & (self.probability <= 1)
        if not within.all():
            row = int(np.argmin(within))
            raise ValueError(
                f"probability must be in [0, 1], got {self.probability[row]} in row {row}"
            )
        if self.known.dtype != bool or self.known.shape != self.probability.shape:
            raise ValueError(
                f"known must be bool, of the shape {self.probability.shape} of probability, got "
                f"{self.known.dtype} {self.known.shape}"
            )


def fused(
    probability: np.ndarray, shown: float, seen: np.ndarray, prior: Prior, weight: float = 1.0
) -> tuple[np.ndarray, float]:
    """The probability of each Gaussian to be tampered, and the verdict, by masks and prior.

    Either may be right or not, independently: with the probability `shown` the masks show an edit,
    with that of its verdict the prior does. Where only one is right it is believed; where both are,
    the masks, or both alike if the prior is exact; where neither is, the masks for want of better.

    The verdict counts what the prior says for an edit; an edit need not show there, so what it says
    against one is no evidence.

    Args:
        probability: What the masks say of N Gaussians, shape (N,).
        shown: Their verdict on the scene.
        seen: Gaussians that any view saw, shape (N,) bool.
        prior: What is known without them.
        weight: Of the prior, in [0, 1].

    Returns:
        The probability, shape (N,) float32, and the verdict.

    Raises:
        ValueError: if the prior speaks of another number of Gaussians.
    """
    if len(prior.probability) != len(probability):
        raise ValueError(
            f"the prior speaks of {len(prior.probability)} Gaussians, expected {len(probability)}"
        )
    alone = np.where(seen, 1 - shown, 1.0)
    beside = (1 - alone) / 2 if prior.exact else 0.0
    share = weight * prior.verdict * (alone + beside) * prior.known
    certain = both(shown, weight * max(float(log_odds_of(prior.verdict)), 0.0))
    return pooled(probability, prior.probability, share), certain


def pooled(one: np.ndarray, other: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Two opinions on each Gaussian as one, a linear pool (Stone, 1961).

    Halfway between two opinions nothing may be likely any more, although one of them names
    something. Then that one speaks alone, or of both the one that counts more.

    Args:
        one: Probabilities, shape (N,).
        other: Others, shape (N,).
        share: What the others count, in [0, 1], shape (N,).

    Returns:
        The probabilities by both, shape (N,) float32.
    """
    between = ((1 - share) * one + share * other).astype(np.float32)
    names = [bool((opinion > 0.5).any()) for opinion in (one, other)]
    if (between > 0.5).any() or not any(names):
        return between
    preferred = np.mean(share) > 0.5 if all(names) else names[1]
    return np.asarray(other if preferred else one, np.float32)


def both(certain: float, log_odds: float) -> float:
    """A probability after independent evidence of these log odds."""
    return float(certain / (certain + (1 - certain) * math.exp(-log_odds)))


def log_odds_of(probability: Array | float) -> np.ndarray:
    """Log odds of probabilities of any shape, bounded where those are 0 or 1."""
    within = np.clip(np.asarray(probability, np.float64), 1e-9, 1 - 1e-9)
    return np.log(within / (1 - within))
