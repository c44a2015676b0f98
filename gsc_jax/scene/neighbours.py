"""Around a Gaussian: its nearest neighbours and theirs; and the compact parts of a scene.

Statistics over a neighbourhood are products with a sparse matrix that has 1 / k where somebody is
a neighbour, so that means over the neighbours' neighbours are that product twice.
"""

import dataclasses
from typing import Any

import numpy as np

from gsc_jax.scene.parallel import WORKERS


@dataclasses.dataclass(frozen=True, kw_only=True)
class Neighbourhoods:
    """Who is near whom, of N points.

    Attributes:
        nearest: Indices of the k nearest others, nearest first, shape (N, k).
        distances: How far they are, shape (N, k) float32.
        mean: Sparse matrix (N, N) that takes values to their means over the k nearest.
    """

    nearest: np.ndarray
    distances: np.ndarray
    mean: Any

    def spread(self, values: np.ndarray, means: np.ndarray) -> np.ndarray:
        """Standard deviation over the k nearest, of values with these means, shape (N, D)."""
        return np.sqrt(np.maximum(self.mean @ (values * values) - means * means, 0.0))


def neighbourhoods(points: np.ndarray, k: int) -> Neighbourhoods:
    """The k nearest others of every point.

    Args:
        points: Finite, shape (N, 3) with N > k.
        k: How many.

    Returns:
        The neighbourhoods.
    """
    from scipy.sparse import csr_array
    from scipy.spatial import KDTree

    tree = KDTree(points, compact_nodes=False, balanced_tree=False)
    distances, nearest = tree.query(points, k=k + 1, workers=WORKERS)
    # The first is the point itself, or one that lies on it, which is as good.
    distances = distances[:, 1:].astype(np.float32)
    nearest = np.asarray(nearest)[:, 1:].astype(np.int32)
    ends = np.arange(0, nearest.size + 1, k, dtype=np.int32)
    weights = np.full(nearest.size, 1 / k, np.float32)
    mean = csr_array((weights, nearest.ravel(), ends), shape=(len(points), len(points)))
    return Neighbourhoods(nearest=nearest, distances=distances, mean=mean)


def parts(points: np.ndarray, size: int) -> list[np.ndarray]:
    """Divide points into compact parts, halving them again and again across their longest side.

    Args:
        points: Shape (N, 3).
        size: Points in a part, at most.

    Returns:
        The rows of each part. Their order does not matter, unless coordinates are equal.
    """
    whole, found = [np.arange(len(points))], []
    while whole:
        rows = whole.pop()
        if len(rows) <= size:
            found.append(rows)
            continue
        own = points[rows]
        axis = np.argmax(own.max(axis=0) - own.min(axis=0))
        order = np.argpartition(own[:, axis], len(rows) // 2)
        whole += [rows[order[: len(rows) // 2]], rows[order[len(rows) // 2 :]]]
    return found


def nearest_neighbours(points: np.ndarray, rows: np.ndarray, count: int) -> np.ndarray:
    """Nearest other points of some of the points.

    Args:
        points: Shape (N, 3).
        rows: Indices of the points whose neighbours are wanted, shape (M,).
        count: How many, fewer than N.

    Returns:
        Indices, nearest first, shape (M, count).
    """
    from scipy.spatial import KDTree

    tree = KDTree(points, compact_nodes=False, balanced_tree=False)
    found = np.asarray(tree.query(points[rows], k=count + 1, workers=WORKERS)[1])
    # A point is its own nearest, unless others lie on it: then one of them is left out instead.
    others = found != rows[:, None]
    others[others.all(axis=1), -1] = False
    return found[others].reshape(len(rows), count)
