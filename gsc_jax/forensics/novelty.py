"""Novelty: how far the statistics of a place are from those of the most similar place elsewhere.

One training run leaves similar Gaussians all over a scene. What another one left, or an editor
trained, is similar to itself only: the places with the nearest statistics lie beside it. Nothing is
trained for this number, so that it holds for sources that no training data have.
"""

import numpy as np
from scipy.spatial import KDTree
from scipy.spatial.distance import cdist

from gsc_jax.forensics.features import in_group
from gsc_jax.forensics.places import Places
from gsc_jax.scene.parallel import workers
from gsc_jax.scene.statistics import principal_axes

SHAPE, COLOUR = ("size", "anisotropy", "spacing", "opacity"), ("colour", "contrast")
COMPARED = SHAPE, (*SHAPE, *COLOUR)
"""Groups of features of each comparison. Colours or harmonics alone differ where nothing was edited
as much as where something was."""
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


def novelty(places: Places) -> np.ndarray:
    """Novelty of P places, about 0 in the middle, shape (P,)."""
    some = places.centers[:: -(-len(places.centers) // SAMPLE)]
    radius = np.quantile(cdist(places.centers, some), NEARBY_SHARE, axis=1)[:, None]
    compared = [
        _novelty(places.statistics[:, in_group(places.names, *groups)], places.centers, radius)
        for groups in COMPARED
    ]
    return places.around.mean(np.mean(compared, axis=0))


def _novelty(statistics: np.ndarray, centers: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Novelty of places by their statistics (P, D), centres (P, 3) and radii (P, 1), shape (P,).

    The logarithm of the distance to the most similar place elsewhere. If none of the `CANDIDATES`
    lies elsewhere, it is farther away than all of them.
    """
    described = (statistics @ principal_axes(statistics, COMPONENTS)).astype(np.float32)
    count = min(CANDIDATES, len(centers))
    distances, candidates = KDTree(described).query(described, count, workers=workers())
    elsewhere = np.linalg.norm(centers[candidates] - centers[:, None], axis=2) > radius
    first = np.where(elsewhere.any(axis=1), elsewhere.argmax(axis=1), -1)
    distance = distances[np.arange(len(centers)), first]
    ratio = np.log(distance / (np.median(distance) + 1e-12) + 1e-3)
    return np.clip(ratio, -MAX_LOG_RATIO, MAX_LOG_RATIO)
