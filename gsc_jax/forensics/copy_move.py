"""Trace of copy-move edits: regions whose Gaussians occur again elsewhere, moved in the same way.

A single Gaussian with the attributes of another is a coincidence, frequent in quantised files.
The duplicates of a copied region keep their arrangement: neighbours have their duplicates close
together, although the compared attributes do not hold the position. Training clones Gaussians, too,
and an export may make them identical, but such clones stay where they were made.
"""

from collections.abc import Callable

import numpy as np

from gsc_jax.forensics.traces import Trace, make_trace, region_scores
from gsc_jax.scene import Gaussians
from gsc_jax.scene.neighbours import nearest_neighbours
from gsc_jax.scene.parallel import in_blocks

APPEARANCE_RADIUS = 0.35
"""Distance of duplicates in `appearance`, above that of noise and 8-bit rounding."""
INVARIANT_RADIUS = 0.01
"""The same in `similarity_invariants`: smaller, since fewer numbers identify a duplicate."""
NEIGHBOURS = 12
"""Neighbours whose duplicates are compared."""
SAMPLE = 12_000
"""Gaussians searched first; around those that pass, all are searched."""
MIN_MOVED_SHARE = 0.15
"""Share of neighbours with duplicates in the same place; 0.08 in 1 of 1000 authentic scenes."""
MIN_MOVE, MAX_SPREAD = 0.5, 3.0
"""Distance to a duplicate and between those of neighbours, in distances to the last neighbour;
closer duplicates are texture of a surface."""
MIN_FAR_SHARE = 0.2
"""Share of a copied region that was moved by more than `MAX_SPREAD`, so that a common motion is no
coincidence: 0.37 to 0.75 in filled holes, 0 among the clones of an authentic scene (seal)."""


def copy_move(gaussians: Gaussians, neighbours: np.ndarray) -> Trace:
    """Detect regions whose Gaussians occur again elsewhere, moved in the same way.

    Nearly all Gaussians of a filled hole have duplicates, but only a part of the region they were
    copied from; of an object that was copied as a whole, both copies are marked.
    """
    moves = np.zeros(len(gaussians))
    if len(gaussians) > 2 * NEIGHBOURS:
        means = np.asarray(gaussians.means, np.float64)
        reach = np.linalg.norm(means - means[neighbours[:, -1]], axis=1)
        alike = moved_together(means, reach, appearance(gaussians), APPEARANCE_RADIUS)
        similar = moved_together(means, reach, similarity_invariants(gaussians), INVARIANT_RADIUS)
        moves = np.maximum(alike, similar)
    score = _region_scores(moves > 0, neighbours)
    moves[_clones(score > 0.5, moves > MAX_SPREAD, neighbours)] = 0
    score = _region_scores(moves > 0, neighbours)
    found = "occur again elsewhere; where two whole parts are alike, either may be the copy"
    return make_trace("copy-move", score, found, "No part of the scene occurs in it again.")


def _region_scores(marked: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    return region_scores(marked, neighbours, min_share=0.6, min_outside=0.6)


def moved_together(
    means: np.ndarray, reach: np.ndarray, attributes: np.ndarray, radius: float
) -> np.ndarray:
    """Distances to duplicates that lie where those of the neighbours lie, else 0, shape (N,).

    They are in units of `reach`, the distance to the last neighbour, shape (N,). Duplicates are
    closer than the radius in the attributes (N, D).
    """
    from scipy.spatial import KDTree

    tree = KDTree(attributes, balanced_tree=False)
    rows = np.arange(len(means))
    if len(rows) > SAMPLE:
        rows = np.sort(np.random.default_rng(0).choice(len(rows), SAMPLE, replace=False))
        # Neighbours within a sample are further apart, in proportion on a surface.
        widening = np.sqrt(len(means) / SAMPLE)
        near, moves = _arranged(means, reach, rows, _duplicates(tree, rows, radius), widening)
        hits = moves > 0
        seeds = rows[hits & (hits[near].mean(axis=1) >= MIN_MOVED_SHARE)]
        rows = _close_to(means, seeds, 2 * widening * reach[seeds])
    result = np.zeros(len(means))
    if len(rows) > NEIGHBOURS:
        result[rows] = _arranged(means, reach, rows, _duplicates(tree, rows, radius))[1]
    return result


def _duplicates(tree, rows: np.ndarray, radius: float) -> np.ndarray:
    """Nearest other point of a tree within a radius, or -1, shape (M,)."""
    found = tree.query(tree.data[rows], k=2, distance_upper_bound=radius, workers=-1)[1]
    # Of exact copies, the first result may be the other one.
    other = np.where(found[:, 0] == rows, found[:, 1], found[:, 0])
    return np.where(other < tree.n, other, -1)


def _arranged(
    means: np.ndarray, reach: np.ndarray, rows: np.ndarray, duplicates: np.ndarray, widening=1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours among the rows, (M, K), and moves to duplicates next to those of theirs, (M,)."""
    near = nearest_neighbours(means[rows], np.arange(len(rows)), NEIGHBOURS)
    moves = np.linalg.norm(means[duplicates] - means[rows], axis=1) / np.maximum(reach[rows], 1e-12)
    has = (duplicates >= 0) & (moves > MIN_MOVE)
    # A copy may be larger or smaller than the original.
    spread = widening * MAX_SPREAD * np.maximum(reach[rows], reach[duplicates])

    def together(some: np.ndarray) -> np.ndarray:
        """Share of the neighbours whose duplicates lie close to the duplicate of the row."""
        own, others = means[duplicates[some]], means[duplicates[near[some]]]
        close = np.linalg.norm(others - own[:, None], axis=2) <= spread[some, None]
        return (has[near[some]] & close).mean(axis=1)

    found = has & (in_blocks(together, np.arange(len(rows))) >= MIN_MOVED_SHARE)
    return near, np.where(found, moves, 0)


def _clones(marked: np.ndarray, far: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    """Marked Gaussians of connected parts of which too few were moved far, shape (N,) bool."""
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    if not marked.any():
        return marked
    rows, place = np.flatnonzero(marked), np.cumsum(marked) - 1
    first, last = np.nonzero(marked[neighbours[rows]])
    edges = first, place[neighbours[rows[first], last]]
    graph = csr_array((np.ones(len(first), bool), edges), shape=(len(rows), len(rows)))
    part = connected_components(graph, directed=False)[1]
    share = np.bincount(part, far[rows]) / np.maximum(np.bincount(part), 1)
    clones = np.zeros(len(marked), bool)
    clones[rows] = share[part] < MIN_FAR_SHARE
    return clones


def _close_to(means: np.ndarray, seeds: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Sorted rows of the points within the radius of their nearest seed."""
    from scipy.spatial import KDTree

    if not len(seeds):
        return seeds
    gaps, which = KDTree(means[seeds]).query(means, distance_upper_bound=radius.max(), workers=-1)
    # Where no seed is within the bound, the gap is infinite and the index one too many.
    return np.flatnonzero(gaps <= np.append(radius, 0)[which])


def appearance(gaussians: Gaussians) -> np.ndarray:
    """All attributes but the position, scaled so that noisy copies stay close, shape (N, D)."""
    quats = np.asarray(gaussians.quats)
    quats = quats / np.maximum(np.linalg.norm(quats, axis=1, keepdims=True), 1e-20)
    sh = np.asarray(gaussians.sh)
    columns = [
        2 * quats * np.where(quats[:, :1] < 0, -1, 1),
        np.clip(np.asarray(gaussians.logit_opacities)[:, None], -6, 6) / 2,
        np.asarray(gaussians.log_scales),
        sh[:, 0],
    ]
    if sh.shape[1] > 1:
        columns.append(in_blocks(_projection(sh[:, 1:]), sh[:, 1:]))
    return np.concatenate(columns, axis=1, dtype=np.float32)


def _projection(rest: np.ndarray) -> Callable[[np.ndarray], np.ndarray]:
    """Function from bands above 0, (M, K, 3), to six principal components of all, (N, K, 3)."""

    def sums(part: np.ndarray) -> np.ndarray:
        return np.array([[part.sum(dtype=float), np.square(part).sum(dtype=float)]])

    mean, square = in_blocks(sums, rest).sum(axis=0) / max(rest.size, 1)
    scale = np.float32(0.7 / (np.sqrt(max(square - mean * mean, 0.0)) + 1e-6))
    sample = rest[:: -(-len(rest) // 4096)].reshape(-1, 3 * rest.shape[1]) * scale
    basis = scale * np.linalg.svd(sample - sample.mean(axis=0))[2][:6].T
    return lambda part: part.reshape(len(part), -1) @ basis


def similarity_invariants(gaussians: Gaussians) -> np.ndarray:
    """Attributes that a similarity keeps: shape, opacity, colour, energy per degree, (N, D)."""
    sh = np.asarray(gaussians.sh)
    bands = [slice(n**2, (n + 1) ** 2) for n in range(1, gaussians.sh_degree + 1)]
    columns = [
        np.diff(np.sort(np.asarray(gaussians.log_scales), axis=1), axis=1),
        np.clip(np.asarray(gaussians.logit_opacities)[:, None], -6, 6) / 2,
        sh[:, 0],
        *[np.linalg.norm(sh[:, band], axis=1) for band in bands],
    ]
    return np.concatenate(columns, axis=1, dtype=np.float32)
