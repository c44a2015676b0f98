"""How labelled Gaussians differ from those around them, in properties that a person can see."""

import numpy as np
import scipy.stats

from gsc_jax.forensics.features import with_finite_scales
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Array, Gaussians

MIN_COUNT = 16
"""Gaussians, labelled and around them, below which a share of pairs says nothing."""
MARGIN = 0.5
"""Part of its own size by which the box of the labelled Gaussians is enlarged on each side."""


def contrasts(gaussians: Gaussians, labels: Array) -> dict[str, float]:
    """Share of pairs in which a labelled Gaussian has more of a property than one around it.

    This is Mann and Whitney's U by pair; 0.5 where there is no difference. Around are the other
    Gaussians in the box of the labelled ones (5th to 95th percentile), enlarged by `MARGIN`.

    Args:
        gaussians: N Gaussians.
        labels: Which are labelled, shape (N,) bool.

    Returns:
        Shares in [0, 1] by property; empty if there are too few Gaussians of one kind.
    """
    labels, means = np.asarray(labels, bool), np.asarray(gaussians.means)
    if labels.sum() < MIN_COUNT:
        return {}
    low, high = np.percentile(means[labels], (5, 95), axis=0)
    near = np.all(np.abs(means - (low + high) / 2) <= (0.5 + MARGIN) * (high - low), axis=1)
    around = near & ~labels
    if around.sum() < MIN_COUNT:
        return {}
    rows = np.flatnonzero(labels | around)
    inside, shares = labels[rows], {}
    for name, values in _properties(with_finite_scales(gaussians.take(rows))).items():
        ranks = scipy.stats.rankdata(values)
        shares[name] = float(0.5 + (ranks[inside].mean() - ranks[~inside].mean()) / len(rows))
    return shares


def _properties(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Numbers of N Gaussians by property, shapes (N,)."""
    log_scales, sh = np.sort(gaussians.log_scales, axis=1), np.asarray(gaussians.sh)
    rgb = np.clip(0.5 + Y0 * sh[:, 0], 0, 1)
    return {
        "size": log_scales.mean(axis=1),
        "flatness": log_scales[:, 1] - log_scales[:, 0],
        "opacity": np.asarray(gaussians.logit_opacities),
        "brightness": rgb.mean(axis=1),
        "saturation": np.ptp(rgb, axis=1),
        "gloss": np.square(sh[:, 1:]).sum(axis=(1, 2)),
    }
