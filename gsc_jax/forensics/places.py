"""Places: small parts of a scene, and the statistics of the Gaussians around each."""

import dataclasses

import numpy as np

from gsc_jax.forensics.features import NEIGHBOURS, Features
from gsc_jax.scene.neighbours import Neighbourhoods, neighbourhoods, parts

PLACE, MAX_PLACES = 16, 2**13
"""Gaussians of a place at most, unless there are more than `MAX_PLACES` places."""


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Places:
    """P places of a scene of N Gaussians.

    Attributes:
        rows: The Gaussians by place, shape (N,).
        starts: Where each place begins in `rows`, shape (P,).
        centers: Mean positions, shape (P, 3).
        around: The places around each.
        statistics: Standardised mean and deviation of F numbers around each place, shape (P, 2 F).
        names: Names of the numbers, as in `Features`, of each column.
    """

    rows: np.ndarray
    starts: np.ndarray
    centers: np.ndarray
    around: Neighbourhoods
    statistics: np.ndarray
    names: tuple[str, ...]

    def averaged(self, values: np.ndarray) -> np.ndarray:
        """Means over the Gaussians of each place, (N, ...) to (P, ...)."""
        return _averaged(values, self.rows, self.starts)

    def spread_out(self, values: np.ndarray) -> np.ndarray:
        """Values of the places (P,) for their Gaussians, shape (N,) float32."""
        result = np.empty(len(self.rows), np.float32)
        result[self.rows] = np.repeat(values, np.diff(self.starts, append=len(self.rows)))
        return result


def find_places(features: Features, means: np.ndarray) -> Places:
    """Divide N > `PLACE` Gaussians with these means (N, 3) into places."""
    rows, starts = parts(means, max(PLACE, -(-2 * len(means) // MAX_PLACES)))
    centers = _averaged(means, rows, starts)
    around, _ = neighbourhoods(centers.astype(np.float32), min(NEIGHBOURS, len(starts) - 1))
    # Some columns at a time, since all of them take as much memory as the scene.
    moments = [
        np.stack([_averaged(own, rows, starts), _averaged(own * own, rows, starts)])
        for own in features.own()
    ]
    first, square = (around.mean(values) for values in np.concatenate(moments, axis=2))
    values = np.column_stack([first, np.sqrt(np.maximum(square - first**2, 0))])
    return Places(
        rows=rows,
        starts=starts,
        centers=centers,
        around=around,
        statistics=(values - values.mean(axis=0)) / (values.std(axis=0) + 1e-3),
        names=2 * features.names[: first.shape[1]],
    )


def _averaged(values: np.ndarray, rows: np.ndarray, starts: np.ndarray) -> np.ndarray:
    sums = np.add.reduceat(values[rows], starts)
    return (sums.T / np.diff(starts, append=len(rows))).T
