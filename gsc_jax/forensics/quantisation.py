"""Lattices of quantised values, and which rows are off the one that the scene was stored on.

A component of a compressed file takes a few hundred values, uniform or a codebook. What is pasted
or changed afterwards is off them in one of two ways: by rare values between the common ones, or,
where it is quantised too, by a second lattice that is interleaved with the first. No step or offset
is assumed; values are compared bit by bit.
"""

from typing import Any

import numpy as np

COMMON = 8
"""Occurrences that make a value one of a lattice; free floats occur once or twice."""
LATTICE = 0.5
"""Share of rows with common values that makes a lattice; the rest may be pasted."""
FREE = 2
"""Median occurrences up to which a component is free floats, and common values are what is odd."""
VALUES = 1024
"""A lattice of more values than this is too fine for its blocks to be told from chance."""
GAP = 4.0
"""A value between two of the lattice that are further apart than this many typical steps is in
a tail, where a lattice has holes."""
BIN = 8
"""Adjacent values of a lattice that would be interchangeable if they had one origin."""
BLOCKS = 4
"""Blocks of values that are looked for beside the largest."""
APART = 0.7
"""Correlation of neighbours' exact values, given their bins, above which there are two lattices:
0.56 at most in authentic objects of one codebook, 0.77 to 0.98 for what was edited."""
LOOSELY: dict[str, Any] = {"tol": 1e-2}
"""How well the eigenvectors are solved for; they only have to part values."""
STRAY = 2.0
"""How many times as near to the scene's values as to a block's a value of the scene is."""
TILE = 0.2
"""A part of this share with its own lattice is a tile of the export, not an edit."""
LOYAL = 0.75
"""Share of neighbours of the same lattice within a block of values."""


def off_lattice(
    column: np.ndarray, usable: np.ndarray, neighbours: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which rows have a value that is not on the lattice of one component.

    Where hardly any value is shared, those that are shared are the odd ones.

    Args:
        column: The component of each row, shape (N,).
        usable: Rows that count, the others being at least no one's neighbours, shape (N,) bool.
        neighbours: Nearest others of each row in space, shape (N, K).

    Returns:
        Rows without the lattice and rows with another one, both of shape (N,) bool; all False if
        the component is neither on a lattice nor free of any.
    """
    nothing = np.zeros(len(column), bool)
    if not usable.any():
        return nothing, nothing
    column = np.where(usable, column, column[np.argmax(usable)])
    values, codes, counts = np.unique(column, return_inverse=True, return_counts=True)
    common = counts >= COMMON
    shared = common[codes]
    if common.sum() < 2 * BIN:
        return nothing, nothing
    if np.median(counts[codes[usable]]) <= FREE:
        return shared, nothing
    if shared[usable].mean() < LATTICE:
        return nothing, nothing
    level = np.where(shared, np.cumsum(common)[codes] - 1, -1)
    return ~shared & _within(values, common)[codes], _block(level, common.sum(), neighbours)


def _within(values: np.ndarray, common: np.ndarray) -> np.ndarray:
    """Which values lie between common ones that are no further apart than usual there, (V,)."""
    from scipy.ndimage import median_filter

    known = values[common].astype(np.float64)
    gaps = np.diff(known)
    usual = gaps <= GAP * median_filter(gaps, 2 * BIN + 1, mode="nearest")
    after = np.searchsorted(known, values)
    between = (after > 0) & (after < len(known))
    return between & usual[np.clip(after - 1, 0, len(gaps) - 1)]


def _block(codes: np.ndarray, count: int, neighbours: np.ndarray) -> np.ndarray:
    """Which rows have values that form a small lattice of their own, shape (N,) bool.

    Neighbours of one origin take any of the adjacent values of a lattice; where two lattices are
    interleaved, they keep to one of them. That is an eigenvector, of an eigenvalue near 1, of how
    often neighbours have each pair of values less how often they have that pair of bins.
    """
    none = np.zeros(len(codes), bool)
    if count > VALUES:
        return none
    bins = np.arange(0, count, BIN)
    surprise, degrees = _surprise(_pairs(codes, count, neighbours), bins)
    places = _directions(surprise) / np.sqrt(degrees)[:, None]
    if not places.size:
        return none
    seeds = _farthest(places, degrees)
    gaps = np.linalg.norm(places[:, None] - seeds, axis=2)
    # The values of the scene lie close together, those of an edit stray towards them.
    gaps[:, 0] *= STRAY
    blocks = np.argmin(gaps, axis=1)
    shares = np.bincount(blocks[codes[codes >= 0]], minlength=len(seeds)) / len(codes)
    odd = (shares <= TILE)[blocks]
    # Where all values of a bin are odd nothing is interleaved: extremes neighbour only each other.
    odd &= ~np.repeat(np.logical_and.reduceat(odd, bins), BIN)[:count]
    foreign = (codes >= 0) & odd[codes]
    loyal = foreign[neighbours][foreign].mean() if foreign.any() else 0
    return foreign if loyal >= LOYAL and foreign.mean() <= TILE else none


def _surprise(pairs: np.ndarray, bins: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """How much oftener pairs of values are neighbours than their bins, (V, V), and degrees, (V,).

    Divided by the degrees of both, so that eigenvalues are at most about 1: all neighbours of a
    part are of that part.
    """
    degrees = np.maximum(pairs.sum(axis=1), 1.0)
    member = np.arange(len(pairs)) // BIN
    binned = np.add.reduceat(np.add.reduceat(pairs, bins, axis=0), bins, axis=1)
    within = degrees / np.maximum(np.add.reduceat(degrees, bins)[member], 1.0)
    expected = binned[np.ix_(member, member)] * np.outer(within, within)
    return (pairs - expected) / np.sqrt(np.outer(degrees, degrees)), degrees


def _directions(surprise: np.ndarray) -> np.ndarray:
    """Eigenvectors whose eigenvalues tell of two lattices, shape (V, at most `BLOCKS`)."""
    from scipy.sparse.linalg import ArpackNoConvergence, eigsh

    if not surprise.any():
        return surprise[:, :0]
    start = np.random.default_rng(0).normal(size=len(surprise))
    try:
        size, vectors = eigsh(surprise, k=BLOCKS, which="LA", v0=start, **LOOSELY)
    except ArpackNoConvergence as trouble:
        size, vectors = trouble.eigenvalues, trouble.eigenvectors
    return vectors[:, size > APART]


def _pairs(codes: np.ndarray, count: int, neighbours: np.ndarray) -> np.ndarray:
    """How often neighbours have each pair of values, symmetric, shape (V, V)."""
    near = neighbours[:, :4]
    one = np.repeat(codes, near.shape[1])
    other = codes[near].ravel()
    both = (one >= 0) & (other >= 0)
    pairs = np.bincount(one[both] * count + other[both], minlength=count**2)
    pairs = pairs.reshape(count, count).astype(np.float64)
    return pairs + pairs.T


def _farthest(places: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """One more point than dimensions, each far from those before; light ones do not count."""
    order = np.argsort(places[:, 0])
    middle = np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)
    chosen = [int(order[middle])]
    heavy = weights >= 8 * COMMON
    for _ in range(places.shape[1]):
        gaps = np.linalg.norm(places[:, None] - places[chosen], axis=2).min(axis=1)
        chosen.append(int(np.argmax(np.where(heavy, gaps, -1))))
    return places[chosen]
