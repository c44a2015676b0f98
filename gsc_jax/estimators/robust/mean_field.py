"""Mean-field smoothing: neighbouring Gaussians are mostly tampered together or not at all.

An Ising model over nearest neighbours, solved by the mean field (Kraehenbuehl and Koltun 2011 do so
for pixels). Only Gaussians that the neighbours could move across the boundary are updated.
"""

import numpy as np

from gsc_jax.scene import Array
from gsc_jax.scene.neighbours import nearest_neighbours

ITERATIONS = 5
MARGIN = 3.0
"""Log odds beyond the reach of the neighbours from which on a Gaussian is not updated: smoothing
would change its probability by less than exp(-3)."""


def smooth(
    log_odds: np.ndarray, means: Array, seen: np.ndarray, *, strength: float, neighbours: int
) -> np.ndarray:
    """Log odds (N,) of tampering after mean-field smoothing.

    `log_odds` (N,) are those of each Gaussian alone, `means` (N, 3) centres in any unit. Gaussians
    that no view has `seen` (N,) get and send no message. `strength` is what `neighbours` add if all
    are surely tampered, and subtract if all are surely authentic.
    """
    means, smoothed = np.asarray(means), np.array(log_odds, np.float32)
    active = np.flatnonzero(seen & np.isfinite(means).all(axis=1))
    if strength == 0 or len(active) <= neighbours:
        return smoothed
    uncertain = np.flatnonzero(np.abs(smoothed[active]) < strength + MARGIN)
    nearest = active[nearest_neighbours(means[active], uncertain, neighbours)]
    rows = active[uncertain]
    alone, leaning = smoothed[rows], np.tanh(smoothed / 2)
    for _ in range(ITERATIONS):
        smoothed[rows] = alone + strength / neighbours * leaning[nearest].sum(axis=1)
        leaning[rows] = np.tanh(smoothed[rows] / 2)
    return smoothed
