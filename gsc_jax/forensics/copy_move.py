"""Twins: Gaussians whose attributes occur again elsewhere, and regions of them that moved alike.

A single twin is chance, above all in quantised files. Those of a copied region lie where those of
its neighbours lie, which chance does not bring about in attributes that do not hold the position.
"""

import numpy as np

from gsc_jax.scene import Gaussians
from gsc_jax.scene.neighbours import nearest_neighbours
from gsc_jax.scene.parallel import WORKERS

RADIUS = 0.35
"""Distance of twins in whitened attributes: noise and 8 bits stay below, strangers mostly not."""
TIGHT = 0.01
"""The same in what a similarity leaves alone, where fewer numbers have to tell more."""
NEIGHBOURS = 12
"""Neighbours whose twins are looked at."""
SAMPLE = 12_000
"""Rows whose twins are looked for first; around those that are in step all are looked at."""
IN_STEP = 0.15
"""Share of neighbours whose twins lie together too; authentic scenes reach 0.08 in 1 of 1000."""
NEXT = 0.5
"""A twin within this many distances to the last neighbour is the texture of a surface."""
STRIDE = 3.0
"""Twins lie together within this many distances to the last neighbour."""


def moved_alike(
    means: np.ndarray, reach: np.ndarray, space: np.ndarray, radius: float
) -> np.ndarray:
    """Which rows have a twin that lies where those of their neighbours do.

    Args:
        means: Centres, shape (N, 3).
        reach: Distance to the last neighbour, shape (N,).
        space: Attributes in which twins are close, shape (N, D).
        radius: How close they are.

    Returns:
        Shape (N,) bool.
    """
    from scipy.spatial import KDTree

    tree = KDTree(space, compact_nodes=False, balanced_tree=False)
    some = np.arange(len(means))
    if len(some) > SAMPLE:
        some = np.sort(np.random.default_rng(0).choice(len(some), SAMPLE, replace=False))
        # Neighbours within a sample are further apart, as on surfaces.
        wide = np.sqrt(len(means) / SAMPLE)
        near, hits = _in_step(means, reach, some, _twins(tree, some, radius), wide=wide)
        some = _around(means, some[hits & (hits[near].mean(axis=1) >= IN_STEP)], wide * reach)
    result = np.zeros(len(means), bool)
    if len(some) > NEIGHBOURS:
        result[some] = _in_step(means, reach, some, _twins(tree, some, radius))[1]
    return result


def _around(means: np.ndarray, hits: np.ndarray, reach: np.ndarray) -> np.ndarray:
    """The rows that lie about some of them, twice as far as these reach, sorted."""
    from scipy.spatial import KDTree

    if not len(hits):
        return hits
    far = 2 * reach[hits]
    bound = {"distance_upper_bound": far.max(), "workers": WORKERS}
    gaps, which = KDTree(means[hits]).query(means, **bound)
    # Where nothing is within the bound, the gap is infinite and the index one too many.
    return np.flatnonzero(gaps <= np.append(far, 0)[which])


def _in_step(
    means: np.ndarray, reach: np.ndarray, some: np.ndarray, twins: np.ndarray, *, wide: float = 1.0
) -> tuple[np.ndarray, np.ndarray]:
    """Neighbours among some rows, (S, K), and which have twins near the twins of theirs, (S,)."""
    near = nearest_neighbours(means[some], np.arange(len(some)), NEIGHBOURS)
    moved = np.linalg.norm(means[twins] - means[some], axis=1)
    has = (twins >= 0) & (moved > NEXT * reach[some])
    gaps = np.linalg.norm(means[twins[near]] - means[twins][:, None], axis=2)
    # A copy may be larger or smaller than what it was copied from.
    together = gaps <= wide * STRIDE * np.maximum(reach[some], reach[twins])[:, None]
    return near, has & ((has[near] & together).mean(axis=1) >= IN_STEP)


def _twins(tree, some: np.ndarray, radius: float) -> np.ndarray:
    """The nearest other row in a tree within a radius, or -1, shape (S,)."""
    bound = {"distance_upper_bound": radius, "workers": WORKERS}
    found = tree.query(tree.data[some], k=2, **bound)[1]
    # With exact copies, the first that is found may be the other one.
    other = np.where(found[:, 0] == some, found[:, 1], found[:, 0])
    return np.where(other < tree.n, other, -1)


def appearance(gaussians: Gaussians) -> np.ndarray:
    """All attributes but the position, whitened so that copies are close, shape (N, D)."""
    quats = np.asarray(gaussians.quats)
    quats = quats / np.maximum(np.linalg.norm(quats, axis=1, keepdims=True), 1e-20)
    bands = np.asarray(gaussians.sh[:, 1:]).reshape(len(gaussians), -1)
    columns = [
        2 * quats * np.where(quats[:, :1] < 0, -1, 1),
        np.clip(np.asarray(gaussians.logit_opacities)[:, None], -6, 6) / 2,
        np.maximum(np.asarray(gaussians.log_scales), -30),
        np.asarray(gaussians.sh)[:, 0],
    ]
    if bands.shape[1]:
        bands = bands * (0.7 / (bands.std() + 1e-6))
        some = bands[:: -(-len(bands) // 4096)]
        columns.append(bands @ np.linalg.svd(some - some.mean(axis=0))[2][:6].T)
    return np.concatenate(columns, axis=1, dtype=np.float32)


def invariants(gaussians: Gaussians) -> np.ndarray:
    """What a similarity does not change: shape, opacity, colour and energies of the bands."""
    sh = np.asarray(gaussians.sh)
    bands = [slice(n**2, (n + 1) ** 2) for n in range(1, round(sh.shape[1] ** 0.5))]
    columns = [
        np.diff(np.sort(np.maximum(np.asarray(gaussians.log_scales), -30), axis=1), axis=1),
        np.clip(np.asarray(gaussians.logit_opacities)[:, None], -6, 6) / 2,
        sh[:, 0],
        *[np.linalg.norm(sh[:, band], axis=1) for band in bands],
    ]
    return np.concatenate(columns, axis=1, dtype=np.float32)
