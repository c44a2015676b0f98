"""Novelty: how far the statistics of a place are from those of the most similar place elsewhere.

One training run leaves similar Gaussians all over a scene. What another one left, or an editor
trained, is similar to itself only: the places with the nearest statistics lie beside it. Nothing is
trained for this number, so that it holds for sources that no training data have.
"""

import functools
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from gsc_jax.forensics.features import NEIGHBOURS, Features, in_group
from gsc_jax.scene.neighbours import neighbourhoods, parts
from gsc_jax.scene.parallel import workers
from gsc_jax.scene.statistics import principal_axes

SHAPE, COLOUR = ("size", "anisotropy", "spacing", "opacity"), ("colour", "contrast")
COMPARED = SHAPE, (*SHAPE, *COLOUR)
"""Groups of features of each comparison. Colours or harmonics alone differ where nothing was edited
as much as where something was."""
PLACE, MAX_PLACES = 16, 2**13
"""Gaussians of a place at most, unless there are more than `MAX_PLACES` places."""
COMPONENTS = 10
"""Principal components of the statistics that are compared."""
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
    rows, starts = parts(means, max(PLACE, -(-2 * len(means) // MAX_PLACES)))
    result = np.zeros(len(means), np.float32)
    if len(starts) <= 2 * NEIGHBOURS:
        return result
    sizes = np.diff(starts, append=len(rows))

    def mean(values: np.ndarray) -> np.ndarray:
        return np.add.reduceat(values[rows], starts) / sizes[:, None]

    centers = mean(means)
    around, _ = neighbourhoods(centers.astype(np.float32), NEIGHBOURS)
    # Some columns at a time, since all of them take as much memory as the scene.
    moments = [np.stack([mean(own), mean(own * own)]) for own in features.own()]
    first, square = (around.mean(values) for values in np.concatenate(moments, axis=2))
    spread = np.sqrt(np.maximum(square - first**2, 0))
    names = features.names[: first.shape[1]]
    some = centers[:: -(-len(centers) // SAMPLE)]
    radius = np.quantile(cdist(centers, some), NEARBY_SHARE, axis=1)[:, None]
    apart = functools.partial(_novelty, centers=centers, radius=radius)
    with ThreadPoolExecutor(workers()) as pool:
        compared = list(pool.map(apart, _statistics(first, spread, names)))
    result[rows] = np.repeat(around.mean(np.mean(compared, axis=0)), sizes)
    return result


def _statistics(mean: np.ndarray, spread: np.ndarray, names: Sequence[str]) -> Iterator[np.ndarray]:
    """Yield mean and spread (P, D) of the numbers around each place by comparison, standardised."""
    for groups in COMPARED:
        columns = np.any([in_group(names, group) for group in groups], axis=0)
        values = np.column_stack([mean[:, columns], spread[:, columns]])
        yield (values - values.mean(axis=0)) / (values.std(axis=0) + 1e-3)


def _novelty(statistics: np.ndarray, centers: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Novelty of places by their statistics (P, D), centres (P, 3) and radii (P, 1), shape (P,).

    The logarithm of the distance to the most similar place elsewhere. If none of the `CANDIDATES`
    lies elsewhere, it is farther away than all of them.
    """
    described = (statistics @ principal_axes(statistics, COMPONENTS)).astype(np.float32)
    distances, candidates = KDTree(described).query(described, k=min(CANDIDATES, len(centers)))
    elsewhere = np.linalg.norm(centers[candidates] - centers[:, None], axis=2) > radius
    first = np.where(elsewhere.any(axis=1), elsewhere.argmax(axis=1), -1)
    distance = distances[np.arange(len(centers)), first]
    ratio = np.log(distance / (np.median(distance) + 1e-12) + 1e-3)
    return np.clip(ratio, -MAX_LOG_RATIO, MAX_LOG_RATIO)
