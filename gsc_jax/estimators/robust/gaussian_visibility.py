"""Visibility of Gaussians in views, from 0 to 1, the flagged part of it, and sampling by both."""

import numpy as np

from gsc_jax.evidence.lifting import EvidenceOfViews
from gsc_jax.scene.neighbours import parts
from gsc_jax.scene.parallel import blocks

BLOCK = 2**15
"""Gaussians whose evidence is in memory at once, 26 MB for 100 views."""

MIN_PART, COVISIBLE = 256, 0.7
"""Gaussians of the sample in a part at least, and share of a part that is enough for a view."""
CELLS, FULL_CELL = 32, 0.2
"""Cells of a part, and the share of the best view of a cell from which on it is seen in full."""


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
    systematic along the Gaussians ordered by the flagged share, then by how much of them is seen,
    so it depends neither on a seed nor on the order of the file. Returns rows (S,), and how many
    Gaussians each represents.
    """
    size = min(size, int(np.count_nonzero(seen)))
    share = flagged / np.maximum(seen, 1e-30)
    visible = np.minimum(seen, 1.0)
    flagged_part = visible * share
    density = visible / visible.sum() + flagged_part / max(flagged_part.sum(), 1e-30)
    order = np.lexsort((seen, share))
    cumulative = np.cumsum(density[order], dtype=np.float64)
    steps = (np.arange(size) + 0.5) / size * cumulative[-1]
    chosen = order[np.minimum(np.searchsorted(cumulative, steps), len(order) - 1)]
    return chosen, 1.0 / density[chosen]


def covisible_parts(
    seen: np.ndarray, represents: np.ndarray, means: np.ndarray, least: float
) -> list[np.ndarray]:
    """Divide a sample of S Gaussians into compact parts that views show together: their rows.

    Each view of a flight over a city, or from the middle of a room, shows little of the scene. The
    few classes of the whole scene would join what masks flag in one place with what they flag in
    another. It is one part if a typical view shows at least the share `least` of it. Given the
    `visibility` in V views (V, S), how many Gaussians each represents (S,), and means (S, D).
    """
    size, means = len(represents), np.nan_to_num(means[:, :3], posinf=0, neginf=0).clip(-1e30, 1e30)
    while True:
        order, starts = parts(means, size)
        # Of equal sizes, which share compiled code; sorted, since the order is that of the CPU.
        found = [np.sort(rows)[: len(order) // len(starts)] for rows in np.split(order, starts[1:])]
        share = np.mean([_covisibility(seen[:, p], represents[p], means[p]) for p in found])
        if not share < (least if len(found) == 1 else COVISIBLE) - 1e-6 or size < 2 * MIN_PART:
            return found
        size = -(-size // 2)


def _covisibility(seen: np.ndarray, represents: np.ndarray, means: np.ndarray) -> float:
    """Share of the scene that is seen where a random part of it is.

    In cells: the back of what a view shows is not another part of the scene.
    """
    order, starts = parts(means, max(1, len(means) // CELLS))
    weights = seen * represents, represents
    shown, size = (np.add.reduceat(each[..., order], starts, axis=-1) for each in weights)
    by_view = np.minimum(1, shown / shown.max(axis=0) / FULL_CELL) @ size
    return float(by_view @ by_view / (by_view.sum() * size.sum()))
