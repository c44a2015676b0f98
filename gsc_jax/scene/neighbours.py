"""Nearest neighbours of points, statistics over them, and compact parts of a point set."""

import dataclasses
from typing import Any

import numpy as np

from gsc_jax.scene.parallel import WORKERS, blocks, in_blocks

OBLIQUE = np.array([[1, 0.0123, 0.0071], [0.0071, 1, 0.0123], [0.0123, 0.0071, 1]], np.float32)
"""Directions along which a point set is halved."""


def tree_in_order(points: np.ndarray) -> tuple[Any, np.ndarray]:
    """KDTree of finite points (N, D) sorted by its leaves, and the rows in that order, (N,).

    Searches around its own points in this order are two to four times as fast, since they read the
    memory that the one before has read.
    """
    from scipy.spatial import KDTree

    order = KDTree(points, balanced_tree=False).indices
    return KDTree(points[order], balanced_tree=False), order


def nearest_neighbours(points: np.ndarray, rows: np.ndarray, count: int) -> np.ndarray:
    """Find the nearest `count` < N other points of the rows (M,) of finite points (N, 3).

    Returns indices into `points`, nearest first, shape (M, count) int32.
    """
    from scipy.spatial import KDTree

    tree = KDTree(points, compact_nodes=False, balanced_tree=False)

    def nearest(some: np.ndarray) -> np.ndarray:
        indices = np.asarray(tree.query(points[some], k=count + 1, workers=WORKERS)[1])
        # A point is its own nearest neighbour. More than `count` points at the same place can crowd
        # it out of the list: the last one is dropped instead.
        others = indices != some[:, None]
        others[others.all(axis=1), -1] = False
        return indices[others].reshape(len(some), count).astype(np.int32)

    return in_blocks(nearest, rows)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Neighbourhoods:
    """The k nearest neighbours of each of N points.

    Attributes:
        nearest: Indices of the k nearest other points, nearest first, shape (N, k) int32.
        distances: Distances to them, shape (N, k) float32.
        mean: Sparse matrix (N, N) that maps values to their means over the neighbours; apply it
            twice to average over the neighbours' neighbours.
    """

    nearest: np.ndarray
    distances: np.ndarray
    mean: Any

    def spread(self, values: np.ndarray, means: np.ndarray) -> np.ndarray:
        """Standard deviation over the neighbours of values with these means, shape (N, D)."""
        return np.sqrt(np.maximum(self.mean @ (values * values) - means * means, 0.0))

    def smooth(self, values: np.ndarray, steps: int) -> np.ndarray:
        """Average values (N,) repeatedly with the mean over the neighbours, shape (N,)."""
        for _ in range(steps):
            values = 0.5 * (values + self.mean @ values)
        return values


def neighbourhoods(points: np.ndarray, k: int) -> Neighbourhoods:
    """Find the k nearest neighbours of finite points, shape (N, 3) with N > k."""
    from scipy.sparse import csr_array

    tree, order = tree_in_order(points)
    nearest, distances = (
        np.empty((len(points), k), np.int32),
        np.empty((len(points), k), np.float32),
    )
    for block in blocks(len(points)):  # SciPy's results take four times the memory
        far, indices = tree.query(tree.data[block], k=k + 1, workers=WORKERS)
        # The first is the point itself, or another one at the same place, at the same distance.
        distances[order[block]], nearest[order[block]] = far[:, 1:], order[indices[:, 1:]]
    ends = np.arange(0, nearest.size + 1, k, dtype=np.int32)
    weights = np.full(nearest.size, 1 / k, np.float32)
    mean = csr_array((weights, nearest.ravel(), ends), shape=(len(points), len(points)))
    return Neighbourhoods(nearest=nearest, distances=distances, mean=mean)


def parts(points: np.ndarray, size: int) -> list[np.ndarray]:
    """Rows of compact parts of at most `size` points (N, 3), by halving the longest side."""
    pending, small = [np.arange(len(points))], []
    while pending:
        rows = pending.pop()
        if len(rows) <= size:
            small.append(rows)
            continue
        own = points[rows]
        axis = np.argmax(own.max(axis=0) - own.min(axis=0))
        # Not quite along the axis: points in a plane across it are no ties.
        order = np.argpartition(own @ OBLIQUE[axis], len(rows) // 2)
        pending += [rows[order[: len(rows) // 2]], rows[order[len(rows) // 2 :]]]
    return small
