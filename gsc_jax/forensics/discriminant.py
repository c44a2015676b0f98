"""Discriminant: what distinguishes the places that stand out from the rest of the scene.

The networks were trained on edits of other scenes. In the scene at hand, the places that they
and the novelty raise are a first guess; a linear discriminant (Fisher, 1936) between these and the
others weighs the statistics anew, as they differ here.
"""

import numpy as np
from scipy.special import expit

from gsc_jax.forensics.places import Places

RIDGE = 0.3
"""Added to the variances, which are about 1."""
STEEPNESS = 2.0
"""Slope of the sigmoid of the first guess, whose centre is half way from median to peak."""
MAX_DISCRIMINANT = 12.0
"""Clip the discriminant to this magnitude."""


def discriminant(places: Places, log_odds: np.ndarray) -> np.ndarray:
    """Log odds of P places by a discriminant that starts from log odds (P,), shape (P,)."""
    level = (np.median(log_odds) + log_odds.max()) / 2
    inside = expit(STEEPNESS * (log_odds - level))
    normal, offset = linear_discriminant(places.statistics, inside)
    scores = places.around.mean(places.statistics @ normal - offset)
    return np.clip(scores, -MAX_DISCRIMINANT, MAX_DISCRIMINANT)


def linear_discriminant(values: np.ndarray, inside: np.ndarray) -> tuple[np.ndarray, float]:
    """Normal n (D,) and offset d: x @ n - d is above 0 for x nearer to the inside than the outside.

    `inside` are weights in [0, 1] of values (M, D), neither all 0 nor all 1.
    """
    centers = [weights @ values / weights.sum() for weights in (inside, 1 - inside)]
    covariance = RIDGE * np.eye(values.shape[1])
    for weights, center in zip((inside, 1 - inside), centers, strict=True):
        apart = values - center
        covariance += (apart.T * weights) @ apart / len(values)
    normal = np.linalg.solve(covariance, centers[0] - centers[1])
    return normal, float((centers[0] + centers[1]) / 2 @ normal)
