"""The naive baseline that the demo and the experiments compare with."""

import numpy as np

from gsc_jax.vote import Tally


def inverse_projection(votes: Tally) -> np.ndarray:
    """Label by back-projecting the masks and uniting them (GS-Checker, table 1).

    Args:
        votes: Votes on N Gaussians.

    Returns:
        True where the projected centre lies in the mask of at least one view, shape (N,) bool.
    """
    return np.asarray(votes.tampered) > 0
