"""Neighbouring Gaussians are mostly of one kind: mean-field smoothing over the nearest neighbours.

Each Gaussian's class is drawn towards the mean of its neighbours' (a Potts model, solved by the
mean field; Kraehenbuehl and Koltun 2011 do the same for pixels). Of which kind a
Gaussian is may be told by the views more clearly than neighbours can weigh: those stay as they are,
and only the doubtful ones are looked at.
"""

import numpy as np

from gsc_jax.scene import Array
from gsc_jax.scene.neighbours import nearest_neighbours

ITERATIONS = 5
MARGIN = 3.0
"""Log odds beyond the reach of the neighbours from which on a Gaussian is left out."""


def smoothed(
    logits: np.ndarray,
    kinds: np.ndarray,
    means: Array,
    seen: np.ndarray,
    *,
    strength: float,
    neighbours: int,
) -> np.ndarray:
    """Class probabilities of Gaussians that look at their neighbours.

    Args:
        logits: Unnormalised log probability of each class, shape (N, C).
        kinds: Which of the classes are of one kind, the others being of the other, shape (C,) bool.
        means: Centres, world units of any scale, shape (N, 3).
        seen: Gaussians that any view has seen; only they speak, shape (N,) bool.
        strength: Log odds that neighbours of one mind add.
        neighbours: How many are asked.

    Returns:
        Probabilities that add up to 1, shape (N, C).
    """
    probability = softmax(logits)
    means = np.asarray(means)
    speaking = np.flatnonzero(seen & np.isfinite(means).all(axis=1))
    if kinds.all() or not kinds.any() or strength == 0 or len(speaking) <= neighbours:
        return probability
    one, other = (logits[:, kind].max(axis=1)[speaking] for kind in (kinds, ~kinds))
    doubtful = np.flatnonzero(np.abs(one - other) < strength + MARGIN)
    asked = speaking[nearest_neighbours(means[speaking], doubtful, neighbours)]
    those = speaking[doubtful]
    own = logits[those]
    for _ in range(ITERATIONS):
        opinion = np.zeros_like(own)
        for neighbour in asked.T:
            opinion += probability[neighbour]
        probability[those] = softmax(own + strength / neighbours * opinion)
    return probability


def softmax(logits: np.ndarray) -> np.ndarray:
    """Probabilities over the last axis, which add up to 1."""
    weights = np.exp(logits - logits.max(axis=-1, keepdims=True))
    return weights / weights.sum(axis=-1, keepdims=True)
