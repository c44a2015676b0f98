"""Mean-field smoothing: neighbouring Gaussians mostly belong to the same class.

A Potts model over nearest neighbours, solved by the mean field (Kraehenbuehl and Koltun 2011 do so
for pixels). Only Gaussians that the neighbours could move across the boundary are updated.
"""

import numpy as np
from scipy.special import softmax

from gsc_jax.scene import Array
from gsc_jax.scene.neighbours import nearest_neighbours

ITERATIONS = 5
MARGIN = 3.0
"""Log odds beyond the reach of the neighbours from which on a Gaussian is not updated: smoothing
would change its probability by less than exp(-3)."""


def smooth(
    logits: np.ndarray,
    tampered: np.ndarray,
    means: Array,
    seen: np.ndarray,
    *,
    strength: float,
    neighbours: int,
) -> np.ndarray:
    """Class probabilities (N, C) that add up to 1, after mean-field smoothing.

    `logits` (N, C) are unnormalised log probabilities, `tampered` (C,) the classes that count as
    such, `means` (N, 3) centres in any unit. Gaussians that no view has `seen` (N,) get and send no
    message. `strength` is the log odds that `neighbours` contribute if all belong to one class.
    """
    probability, means = softmax(logits, axis=1), np.asarray(means)
    active = np.flatnonzero(seen & np.isfinite(means).all(axis=1))
    if tampered.all() or not tampered.any() or strength == 0 or len(active) <= neighbours:
        return probability
    best, other = (logits[:, kind].max(axis=1)[active] for kind in (tampered, ~tampered))
    uncertain = np.flatnonzero(np.abs(best - other) < strength + MARGIN)
    nearest = active[nearest_neighbours(means[active], uncertain, neighbours)]
    rows = active[uncertain]
    unary = logits[rows]
    for _ in range(ITERATIONS):
        message = np.zeros_like(unary)
        for neighbour in nearest.T:
            message += probability[neighbour]
        probability[rows] = softmax(unary + strength / neighbours * message, axis=1)
    return probability
