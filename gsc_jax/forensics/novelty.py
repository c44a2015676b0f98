"""Novelty: how far the statistics of a place are from those of the most similar place elsewhere.

One training run leaves similar Gaussians all over a scene. What another one left, or an editor
trained, is similar to itself only: the places with the nearest statistics lie beside it. Nothing is
trained for this number, so that it holds for sources that no training data have.
"""

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

from gsc_jax.forensics.features import NEIGHBOURS, Features, in_group
from gsc_jax.scene.neighbours import neighbourhoods, parts, tree_in_order
from gsc_jax.scene.parallel import WORKERS

GROUPS = (
    ("size", "anisotropy", "spacing", "opacity"),
    ("colour", "contrast", "shading"),
    ("harmonics",),
    ("surface", "agreement"),
)
"""Groups of features that are compared together; all of them together are a fifth comparison."""
PLACE, MAX_PLACES = 16, 2**13
"""Gaussians of a place at most, unless there are more than `MAX_PLACES` places."""
COMPONENTS = 6
"""Principal components of the statistics of a group that are compared."""
CANDIDATES = 96
"""Places with the nearest statistics, among which one elsewhere is sought."""
NEARBY_SHARE = 0.2
"""Share of the places that are around a place; the others are elsewhere."""
SAMPLE = 2**9
"""Places of which the radius around a place is estimated."""
MAX_LOG_RATIO = 3.0
"""Clip the logarithm of a distance, relative to the median of the scene, to this magnitude."""


def novelty(features: Features, means: np.ndarray) -> np.ndarray:
    """Novelty of N Gaussians with these means (N, 3), about 0 in the middle, shape (N,) float32.

    Gaussians of one place have the same; 0 where a scene has too few places to compare.
    """
    from scipy.sparse import csr_array

    places = parts(means, max(PLACE, -(-2 * len(means) // MAX_PLACES)))
    result = np.zeros(len(means), np.float32)
    if len(places) <= 2 * NEIGHBOURS:
        return result
    rows, sizes = np.concatenate(places), np.array([len(place) for place in places])
    owner = np.repeat(np.arange(len(places)), sizes)
    mean = csr_array((1 / sizes[owner], (owner, rows)), shape=(len(places), len(means)))
    centers = mean @ means
    around = neighbourhoods(centers.astype(np.float32), NEIGHBOURS)
    own = features.own
    compared = [
        _novelty(statistics, centers)
        for statistics in _statistics(around.mean @ mean, own, features.names[: own.shape[1]])
    ]
    result[rows] = (around.mean @ np.mean(compared, axis=0))[owner]
    return result


def _statistics(mean: Any, own: np.ndarray, names: Sequence[str]) -> Iterator[np.ndarray]:
    """Yield for each group mean and spread of its numbers (N, D) around each place, standardised.

    `mean` is the sparse matrix (P, N) that averages over the surroundings of a place.
    """
    first = mean @ own
    spread = np.sqrt(np.maximum(mean @ (own * own) - first**2, 0))
    for groups in (*GROUPS, sum(GROUPS, ())):
        columns = np.any([in_group(names, group) for group in groups], axis=0)
        values = np.column_stack([first[:, columns], spread[:, columns]])
        yield (values - values.mean(axis=0)) / (values.std(axis=0) + 1e-3)


def _surroundings(centers: np.ndarray) -> np.ndarray:
    """Radius around places (P, 3) that has about `NEARBY_SHARE` of all places, shape (P, 1)."""
    from scipy.spatial.distance import cdist

    some = centers[:: -(-len(centers) // SAMPLE)]
    return np.quantile(cdist(centers, some), NEARBY_SHARE, axis=1)[:, None]


def _novelty(statistics: np.ndarray, centers: np.ndarray) -> np.ndarray:
    """Novelty of places by their statistics (P, D) and centres (P, 3), shape (P,).

    The distance to the most similar place elsewhere, and how many of the `CANDIDATES` are nearby.
    """
    _, _, axes = np.linalg.svd(statistics, full_matrices=False)
    described = (statistics @ axes[:COMPONENTS].T).astype(np.float32)
    tree, order = tree_in_order(described)
    found = tree.query(tree.data, k=min(CANDIDATES, len(centers)), workers=WORKERS)
    distances, candidates = found[0][np.argsort(order)], order[found[1][np.argsort(order)]]
    apart = np.linalg.norm(centers[candidates] - centers[:, None], axis=2)
    elsewhere = apart > _surroundings(centers)
    first = np.where(elsewhere.any(axis=1), elsewhere.argmax(axis=1), -1)
    distance = distances[np.arange(len(centers)), first]
    ratio = np.log(distance / (np.median(distance) + 1e-12) + 1e-3)
    return np.clip(ratio, -MAX_LOG_RATIO, MAX_LOG_RATIO) + 1 - 2 * elsewhere.mean(axis=1)
