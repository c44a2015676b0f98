"""Trace of copy-move edits: regions whose Gaussians occur again elsewhere, moved in the same way.

A single Gaussian with the attributes of another is a coincidence, frequent in quantised files.
The duplicates of a copied region keep their arrangement: neighbours have their duplicates close
together. Training clones Gaussians, too, and exports may make them identical, in place.
"""

import functools
from collections.abc import Callable

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from gsc_jax.forensics.traces import MIN_REGION, Trace, is_untrained, make_trace, region_scores
from gsc_jax.scene import Gaussians
from gsc_jax.scene.neighbours import order_of_leaves
from gsc_jax.scene.parallel import in_blocks, usable_cores
from gsc_jax.scene.statistics import principal_axes

APPEARANCE_RADIUS = 0.35
"""Distance of duplicates in `appearance`, above that of noise and 8-bit rounding."""
INVARIANT_RADIUS = 0.01
"""The same in `similarity_invariants`: smaller, since fewer numbers identify a duplicate."""
LEAF = 32
"""Points in a leaf of a tree of attributes: in many dimensions, larger leaves are faster."""
MIN_MOVED_SHARE = 0.15
"""Share of neighbours with duplicates in the same place; 0.08 in 1 of 1000 authentic scenes."""
MIN_MOVE, MAX_SPREAD = 0.5, 3.0
"""Distance to a duplicate and between those of neighbours, in distances to the last neighbour;
closer duplicates are texture of a surface."""
MIN_FAR_SHARE = 0.2
"""Share of a copied region that was moved by more than `MAX_SPREAD`, so that a common motion is no
coincidence: 0.37 to 0.75 in filled holes, 0 among the clones of an authentic scene (seal)."""


def copy_move(
    gaussians: Gaussians, neighbours: np.ndarray, duplicates: np.ndarray | None = None
) -> Trace:
    """Detect regions whose Gaussians occur again elsewhere, moved in the same way.

    Nearly all Gaussians of a filled hole have duplicates, but only a part of their source; of whole
    objects, both copies are marked. `duplicates` (N,) are those of `nearest_duplicates`, if known.
    """
    moves = np.zeros(len(gaussians))
    if neighbours.size:
        alike = nearest_duplicates(gaussians)[1] if duplicates is None else duplicates
        similar = _nearest(similarity_invariants(gaussians), INVARIANT_RADIUS)[1]
        means = np.asarray(gaussians.means, np.float64)
        moves = np.maximum(*(moved_together(means, neighbours, rows) for rows in (alike, similar)))
        moves[is_untrained(gaussians)] = 0
    scores = functools.partial(region_scores, min_share=0.6, min_outside=0.6)
    score = scores(moves > 0, neighbours)
    while moves[chance := _coincidences(score > 0.5, moves > MAX_SPREAD, neighbours)].any():
        moves[chance] = 0
        score = scores(moves > 0, neighbours)
    score[chance] = 0
    found = "occur again elsewhere; where two whole parts are alike, either may be the copy"
    return make_trace("copy-move", score, found, "No part of the scene occurs in it again.")


def moved_together(means: np.ndarray, neighbours: np.ndarray, duplicates: np.ndarray) -> np.ndarray:
    """Distances to duplicates that lie where those of the neighbours lie, else 0, shape (N,).

    They are in units of the distance to the last of K neighbours. `duplicates` are rows, or -1.
    """
    reach = np.linalg.norm(means - means[neighbours[:, -1]], axis=1)
    moves = np.linalg.norm(means[duplicates] - means, axis=1) / np.maximum(reach, 1e-12)
    has = (duplicates >= 0) & (moves > MIN_MOVE)
    # A copy may be larger or smaller than the original.
    spread = MAX_SPREAD * np.maximum(reach, reach[duplicates])

    def together(some: np.ndarray) -> np.ndarray:
        """Share of the neighbours whose duplicates lie close to the duplicate of the row."""
        near, own = neighbours[some], means[duplicates[some], None]
        close = np.linalg.norm(means[duplicates[near]] - own, axis=2) <= spread[some, None]
        return (has[near] & close).mean(axis=1)

    rows = np.flatnonzero(has)
    has[rows] = in_blocks(together, rows) >= MIN_MOVED_SHARE
    return np.where(has, moves, 0)


def _coincidences(marked: np.ndarray, far: np.ndarray, neighbours: np.ndarray) -> np.ndarray:
    """Marked Gaussians of connected parts that are small, or hardly moved, shape (N,) bool."""
    if not marked.any():
        return marked
    rows, place = np.flatnonzero(marked), np.cumsum(marked) - 1
    first, last = np.nonzero(marked[neighbours[rows]])
    edges = first, place[neighbours[rows[first], last]]
    graph = csr_array((np.ones(len(first), bool), edges), shape=(len(rows), len(rows)))
    part = connected_components(graph, directed=False)[1]
    size, moved_far = np.bincount(part), np.bincount(part, far[rows])
    chance = np.zeros(len(marked), bool)
    chance[rows] = ((size < MIN_REGION) | (moved_far < MIN_FAR_SHARE * size))[part]
    return chance


def nearest_duplicates(gaussians: Gaussians) -> tuple[np.ndarray, np.ndarray]:
    """Distances to the most similar other Gaussians in `appearance`, and their rows, both (N,).

    They are infinite and -1 beyond `APPEARANCE_RADIUS`.
    """
    return _nearest(appearance(gaussians), APPEARANCE_RADIUS)


def _nearest(described: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
    """Distances to the nearest other of the points (N, D) within a radius, and their rows."""
    # A KDTree degenerates where many points are equal: it gets one of them.
    hashes = row_hashes(described)
    order = np.argsort(hashes, kind="stable")
    new = np.append(True, np.diff(hashes[order]) != 0)
    alone, rows = new & np.roll(new, -1), np.empty(len(order), np.int32)
    rows[order] = np.where(new, np.roll(order, -1), np.roll(order, 1))
    points = order[new]
    described = described[points]  # no second copy beside the float64 of a tree
    leaves = order_of_leaves(described)
    points, described = points[leaves], described[leaves]
    tree = KDTree(described, leafsize=LEAF, balanced_tree=False)
    del described
    found = tree.query(tree.data, k=2, distance_upper_bound=radius, workers=len(usable_cores()))
    far, near = map(np.asarray, found)
    single, distances = np.isin(points, order[alone]), np.zeros(len(order))
    distances[points[single]] = far[single, 1]
    rows[points[single]] = np.append(points, -1)[near[single, 1]]
    return distances, rows


def row_hashes(rows: np.ndarray) -> np.ndarray:
    """Hash of each row (N, D) float32, equal for equal rows, shape (N,) uint64."""
    rng = np.random.default_rng(0)
    keys = rng.integers(1, 2**63, rows.shape[1], dtype=np.uint64) | np.uint64(1)

    def hashes(part: np.ndarray) -> np.ndarray:
        return (part + np.float32(0)).view(np.uint32).astype(np.uint64) @ keys  # -0 is 0

    return in_blocks(hashes, rows)


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
    basis = scale * principal_axes(sample - sample.mean(axis=0), 6)
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
