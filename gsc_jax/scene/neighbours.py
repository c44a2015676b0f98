"""Nearest neighbours of points, statistics over them, and compact parts of a point set."""

import dataclasses

import numpy as np
from scipy.sparse import csr_array
from scipy.spatial import KDTree

from gsc_jax.scene.parallel import blocks, in_blocks, usable_cores, workers

OBLIQUE = np.array([[1, 0.0123, 0.0071], [0.0071, 1, 0.0123], [0.0123, 0.0071, 1]], np.float32)
"""Directions along which a point set is halved."""


def order_of_leaves(points: np.ndarray) -> np.ndarray:
    """Rows of points (N, D), those close in space together: searches and means reuse the cache."""
    return KDTree(points, balanced_tree=False).indices


def nearest_neighbours(points: np.ndarray, rows: np.ndarray, count: int) -> np.ndarray:
    """Find the nearest `count` < N other points of the rows (M,) of finite points (N, 3).

    Returns indices into `points`, nearest first, shape (M, count) int32.
    """
    tree = KDTree(points, compact_nodes=False, balanced_tree=False)

    def nearest(some: np.ndarray) -> np.ndarray:
        indices = np.asarray(tree.query(points[some], k=count + 1, workers=workers())[1])
        # A point is its own nearest neighbour. More than `count` points at the same place can crowd
        # it out of the list: the last one is dropped instead.
        others = indices != some[:, None]
        others[others.all(axis=1), -1] = False
        return indices[others].reshape(len(some), count).astype(np.int32)

    order, found = order_of_leaves(points[rows]), np.empty((len(rows), count), np.int32)
    found[order] = in_blocks(nearest, rows[order])
    return found


@dataclasses.dataclass(frozen=True, kw_only=True)
class Neighbourhoods:
    """The k nearest other points of each of N points, nearest first, indices (N, k) int32."""

    nearest: np.ndarray

    def mean(self, values: np.ndarray) -> np.ndarray:
        """Means over the neighbours of values, (N,) or (N, D); twice, over theirs, too."""
        values = np.ascontiguousarray(values)  # else each block would copy all of them
        k = self.nearest.shape[1]

        def means(nearest: np.ndarray) -> np.ndarray:
            # A sparse matrix of all rows would take as much memory again as the indices.
            weights, ends = np.full(nearest.size, 1 / k, np.float32), np.arange(len(nearest) + 1)
            entries = weights, nearest.ravel(), (k * ends).astype(np.int32)
            return csr_array(entries, shape=(len(nearest), len(values))) @ values

        return in_blocks(means, self.nearest)

    def spread(self, values: np.ndarray, means: np.ndarray) -> np.ndarray:
        """Standard deviation over the neighbours of values with these means, shape (N, D)."""
        return np.sqrt(np.maximum(self.mean(values * values) - means * means, 0.0))


def neighbourhoods(points: np.ndarray, k: int) -> tuple[Neighbourhoods, np.ndarray]:
    """The k nearest neighbours of N > k finite points (N, 3), and the distances to them, (N, k)."""
    tree, shape = KDTree(points, balanced_tree=False), (len(points), k)
    nearest, distances = np.empty(shape, np.int32), np.empty(shape, np.float32)
    for block in blocks(len(points)):  # SciPy's results take four times the memory
        found = tree.query(points[block], k=k + 1, workers=len(usable_cores()))
        far, indices = map(np.asarray, found)
        # The first is the point itself, or another one at the same place, at the same distance.
        distances[block], nearest[block] = far[:, 1:], indices[:, 1:]
    return Neighbourhoods(nearest=nearest), distances


def parts(points: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Divide N > 0 points (N, 3) into P compact parts by halving the longest side.

    Returns the rows sorted by part, (N,), and where each part of at most `size` begins, (P,).
    """
    order, starts, columns = np.arange(len(points)), np.array([0]), np.ascontiguousarray(points.T)
    while (counts := np.diff(starts, append=len(points))).max() > size:
        for count in np.unique(counts[counts > size]):  # two at most: all are halved together
            places = starts[counts == count, None] + np.arange(count)
            own = columns.take(order[places], axis=1)
            axis = (own.max(axis=2) - own.min(axis=2)).argmax(axis=0)
            # Not quite along the axis: points in a plane across it are no ties.
            along = np.einsum("pa,apc->pc", OBLIQUE[axis, : len(columns)], own)
            halved = np.roll(along.argpartition(count // 2, axis=1), -(count // 2), axis=1)
            order[places] = np.take_along_axis(order[places], halved, axis=1)
        middles = (starts + counts - counts // 2)[counts > size]
        starts = np.sort(np.concatenate([starts, middles]))
    return order, starts
