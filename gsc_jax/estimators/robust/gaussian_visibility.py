"""Visibility of Gaussians in views, from 0 to 1, the flagged part of it, and sampling by both."""

import numpy as np

from gsc_jax.evidence.lifting import EvidenceOfViews
from gsc_jax.scene.parallel import blocks

BLOCK = 2**15
"""Gaussians whose evidence is in memory at once, 26 MB for 100 views."""


def visibility(
    evidence: EvidenceOfViews, rows: np.ndarray | slice, half_weight: float
) -> tuple[np.ndarray, np.ndarray]:
    """Visibility of M of the Gaussians in each view, and the flagged part of it, shapes (V, M).

    total / (total + half_weight) and tampered / (total + half_weight); half_weight is in pixels.
    """
    total, tampered = evidence.of(rows)
    scale = 1.0 / (total + np.float32(half_weight))
    return total * scale, tampered * scale


def summed_visibility(evidence: EvidenceOfViews, half_weight: float) -> np.ndarray:
    """Sums over the views of what `visibility` gives for all Gaussians: seen, flagged; (2, N)."""
    sums = np.empty((2, evidence.shape[1]), np.float32)
    for block in blocks(evidence.shape[1], BLOCK):
        sums[:, block] = [part.sum(axis=0) for part in visibility(evidence, block, half_weight)]
    return sums


def stratified_sample(seen: np.ndarray, flagged: np.ndarray, size: int) -> tuple[np.ndarray, ...]:
    """Sample at most `size` Gaussians, half of them in proportion to how much of them is flagged.

    Given the visibility summed over the views and the flagged part of it, both (N,). The sample is
    systematic along the Gaussians ordered by the flagged share, so that it depends neither on a
    seed nor on the order of the file. Returns rows (S,), and how many Gaussians each represents.
    """
    size = min(size, int(np.count_nonzero(seen)))
    share = flagged / np.maximum(seen, 1e-30)
    visible = np.minimum(seen, 1.0)
    flagged_part = visible * share
    density = visible / visible.sum() + flagged_part / max(flagged_part.sum(), 1e-30)
    order = np.argsort(share, kind="stable")
    cumulative = np.cumsum(density[order], dtype=np.float64)
    steps = (np.arange(size) + 0.5) / size * cumulative[-1]
    chosen = order[np.minimum(np.searchsorted(cumulative, steps), len(order) - 1)]
    return chosen, 1.0 / density[chosen]
