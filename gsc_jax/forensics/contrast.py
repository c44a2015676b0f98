"""How labelled Gaussians differ from those around them, in properties that a person can see."""

import jax
import numpy as np

from gsc_jax.forensics.features import with_finite_scales
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Array, Gaussians
from gsc_jax.scene.gaussians import usable_rows
from gsc_jax.scene.statistics import median_and_mad, superiority

MIN_COUNT, MAX_COUNT = 64, 100_000
"""Limits of labelled Gaussians, and of others: 64 alike ones seldom differ (0.1 %, by hand)."""
REACH = 3.6
"""Half the side of the box in robust standard deviations of the labelled centres: 2.7 times that of
a cube which labels fill evenly. A few stray labels hardly enlarge it."""


def contrasts(gaussians: Gaussians, labels: Array) -> dict[str, float]:
    """Probability that a labelled Gaussian has more of a property than one around it.

    The U of Mann and Whitney by pair; 0.5 means no difference. Others count if they are in a box
    around the labelled Gaussians, and rows that cannot be rendered are left out.

    Args:
        gaussians: N Gaussians.
        labels: Which are labelled, shape (N,) bool.

    Returns:
        Numbers in [0, 1] by property; empty with fewer than `MIN_COUNT` Gaussians of a kind.
    """
    host, usable = jax.tree.map(np.asarray, gaussians), usable_rows(gaussians)
    labels, means = np.asarray(labels, bool) & usable, host.means
    if labels.sum() < MIN_COUNT:
        return {}
    median, mad = median_and_mad(means[labels])
    around = np.all(np.abs(means - median) <= REACH * mad, axis=1) & usable & ~labels
    if around.sum() < MIN_COUNT:
        return {}
    rows = np.concatenate([_some(labels), _some(around)])
    properties = _properties(with_finite_scales(host.take(rows)))
    return {name: superiority(values, labels[rows]) for name, values in properties.items()}


def _some(chosen: np.ndarray) -> np.ndarray:
    """At most `MAX_COUNT` of the rows, evenly spaced."""
    rows = np.flatnonzero(chosen)
    return rows[:: -(-len(rows) // MAX_COUNT)]


def _properties(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Numbers of N Gaussians by property, shapes (N,)."""
    log_scales, sh = np.sort(gaussians.log_scales, axis=1), np.asarray(gaussians.sh)
    rgb = np.clip(0.5 + Y0 * sh[:, 0], 0, 1)
    found = {
        "size": log_scales.mean(axis=1),
        "flatness": log_scales[:, 1] - log_scales[:, 0],
        "opacity": np.asarray(gaussians.logit_opacities),
        "brightness": rgb.mean(axis=1),
        "saturation": np.ptp(rgb, axis=1),
    }
    if sh.shape[1] > 1:
        found["view dependence"] = np.abs(sh[:, 1:]).mean(axis=(1, 2))
    return found
