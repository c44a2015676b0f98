"""Trace of quantisation: values that are not on the levels that the scene was quantised to.

A component of a compressed file takes a few hundred values, uniform or from a codebook. Values
pasted or changed afterwards are rare values between the common ones or, where they are quantised
too, a second set of levels interleaved with the first. Values are compared bit by bit. Exporters
split large scenes into tiles with a codebook each, so a large part with its own levels is no edit.
"""

import numpy as np
import scipy  # whose submodules load when they are first used

from gsc_jax.forensics.traces import Trace, is_black, is_untrained, make_trace, region_scores
from gsc_jax.scene import Gaussians

MIN_REPEATS, MAX_FREE_REPEATS = 8, 2
"""Occurrences that make a value a level; median up to which a component is not quantised, since
float32 values occur once or twice."""
MAX_LEVELS = 1024
"""More levels than this are too fine to distinguish interleaved sets from chance."""
MAX_GAP_RATIO = 4.0
"""Gap between levels, in typical gaps nearby, above which the levels are in a sparse tail."""
BIN = 8
"""Adjacent levels that neighbours of one origin would use interchangeably."""
MIN_EIGENVALUE = 0.7
"""Correlation of the exact levels of neighbours, given their bins, above which there are two sets:
at most 0.56 in authentic objects with one codebook, 0.77 to 0.98 in edits."""
MAX_SINGLE_SHARE = 0.3
"""Share of unique values in a region above which its other values are equal by chance: 0.40 in a
scene where an exporter had merged similar Gaussians, at most 0.04 in pasted objects (by hand)."""
MAX_EQUAL_SHARE = 0.05
"""Share of rare values that equal one of a neighbour, above which each chunk of a file has its own
levels: at least 0.08 in scenes from a compressed.ply, at most 0.03 in others (by hand)."""
SCENE_FACTOR = 2.0
"""Weight of distances to the levels of the scene, since those of an edit scatter towards them."""
MAX_BLOCK_SHARE = 0.2
"""Share of the Gaussians above which a set of levels is a tile of the export."""
MIN_SAME_SET = 0.75
"""Share of neighbours on the same set of levels."""


def quantisation(gaussians: Gaussians, neighbours: np.ndarray) -> Trace:
    """Detect regions off the quantisation levels of scales or colours.

    Positions are left out, since their levels are so fine that sparse parts seem unquantised, and
    so are rotations, which some exporters normalise after rounding.
    """
    groups = {"scales": gaussians.log_scales, "colours": gaussians.sh[:, 0]}
    marks = {
        name: np.array([off_levels(column, neighbours) for column in np.asarray(values).T])
        for name, values in groups.items()
    }
    # A tile has its own levels in all groups; an edit changes one, or has values off all levels.
    tile = np.all([mark[:, 1].mean(axis=0) > 0.5 for mark in marks.values()], axis=0)
    marks["colours"] &= ~is_black(gaussians.sh).T[:, None]
    score, names = np.zeros(len(gaussians), np.float32), []
    for name, mark in marks.items():
        odd = (mark[:, 0] | mark[:, 1] & ~tile) & ~is_untrained(gaussians)
        one = region_scores(odd.mean(axis=0) > 0.5, neighbours)
        score = 1 - (1 - score) * (1 - one)
        names += [name] * bool((one > 0.5).any())
    found = f"have {' and '.join(names)} off the grid of values that the others share"
    return make_trace("quantisation", score, found, "No part has quantisation levels of its own.")


def off_levels(column: np.ndarray, neighbours: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mark values of one component that are not on its levels.

    Where hardly any value is shared, the component is not quantised and shared values are marked.
    Returns Gaussians off all levels and Gaussians on another set of levels, both (N,) bool.
    """
    nothing = np.zeros(len(column), bool)
    values, codes, counts = np.unique(column, return_inverse=True, return_counts=True)
    common = counts >= MIN_REPEATS
    shared = common[codes]
    if common.sum() < 2 * BIN:  # too few levels to distinguish two sets
        return nothing, nothing
    if np.median(counts[codes]) <= MAX_FREE_REPEATS:
        once = (counts == 1)[codes[neighbours[region_scores(shared, neighbours) > 0.5]]]
        merged = once.any() and once.mean() > MAX_SINGLE_SHARE
        equal = (codes[neighbours] == codes[:, None]).any(axis=1)[~shared].mean()
        return nothing if merged or equal > MAX_EQUAL_SHARE else shared, nothing
    if shared.mean() < 0.5:  # neither quantised, with some values pasted, nor free
        return nothing, nothing
    level = np.where(shared, np.cumsum(common)[codes] - 1, -1)
    between = _between_levels(values, common)[codes]
    return ~shared & between, _second_set(level, int(common.sum()), neighbours)


def _between_levels(values: np.ndarray, common: np.ndarray) -> np.ndarray:
    """Mask of values between two levels whose gap is typical there, shape (V,)."""
    levels = values[common].astype(np.float64)
    gaps = np.diff(levels)
    typical = gaps <= MAX_GAP_RATIO * scipy.ndimage.median_filter(gaps, 2 * BIN + 1, mode="nearest")
    after = np.searchsorted(levels, values)
    between = (after > 0) & (after < len(levels))
    return between & typical[np.clip(after - 1, 0, len(gaps) - 1)]


def _second_set(codes: np.ndarray, count: int, neighbours: np.ndarray) -> np.ndarray:
    """Mask of values on a small set of levels that is interleaved with the others, shape (N,).

    Neighbours of one origin take any of the adjacent levels; with two interleaved sets, they keep
    to one of them. A set is then an eigenvector of `_excess` with an eigenvalue near 1.
    """
    none = np.zeros(len(codes), bool)
    if count > MAX_LEVELS:
        return none
    bins = np.arange(0, count, BIN)
    excess, degrees = _excess(_pair_counts(codes, count, neighbours), bins)
    places = _leading_vectors(excess) / np.sqrt(degrees)[:, None]
    if not places.size:
        return none
    centres = _farthest_points(places, degrees)
    distances = np.linalg.norm(places[:, None] - centres, axis=2)
    distances[:, 0] *= SCENE_FACTOR
    sets = np.argmin(distances, axis=1)
    shares = np.bincount(sets[codes[codes >= 0]], minlength=len(centres)) / len(codes)
    other = (shares <= MAX_BLOCK_SHARE)[sets]
    # A bin with only such levels is not interleaved: extreme values neighbour only each other.
    other &= ~np.repeat(np.logical_and.reduceat(other, bins), BIN)[:count]
    marked = (codes >= 0) & other[codes]
    same_set = marked[neighbours][marked].mean() if marked.any() else 0
    return marked if same_set >= MIN_SAME_SET and marked.mean() <= MAX_BLOCK_SHARE else none


def _pair_counts(codes: np.ndarray, count: int, neighbours: np.ndarray) -> np.ndarray:
    """How often neighbours have each pair of levels, symmetric, shape (L, L)."""
    near = neighbours[:, :4]
    one, other = np.repeat(codes, near.shape[1]), codes[near].ravel()
    both = (one >= 0) & (other >= 0)
    pairs = np.bincount(one[both] * count + other[both], minlength=count**2)
    pairs = pairs.reshape(count, count).astype(np.float64)
    return pairs + pairs.T


def _excess(pairs: np.ndarray, bins: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pair counts less those expected from the bins, normalised, (L, L), and degrees, (L,)."""
    degrees = np.maximum(pairs.sum(axis=1), 1.0)
    member = np.arange(len(pairs)) // BIN
    binned = np.add.reduceat(np.add.reduceat(pairs, bins, axis=0), bins, axis=1)
    within = degrees / np.maximum(np.add.reduceat(degrees, bins)[member], 1.0)
    expected = binned[np.ix_(member, member)] * np.outer(within, within)
    return (pairs - expected) / np.sqrt(np.outer(degrees, degrees)), degrees


def _leading_vectors(excess: np.ndarray) -> np.ndarray:
    """Eigenvectors of at most four eigenvalues that indicate further sets, shape (L, D)."""
    start = np.random.default_rng(0).normal(size=len(excess))
    # Of a matrix of zeros, ARPACK finds no vectors, of the identity it does.
    shifted = excess + np.eye(len(excess))
    values, vectors = scipy.sparse.linalg.eigsh(shifted, 4, which="LA", v0=start)
    return vectors[:, np.argsort(values)][:, np.sort(values) > 1 + MIN_EIGENVALUE]


def _farthest_points(places: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """The weighted median of the first axis, then D points far from those before, (D + 1, D)."""
    order = np.argsort(places[:, 0])
    middle = np.searchsorted(np.cumsum(weights[order]), weights.sum() / 2)
    chosen = [int(order[middle])]
    frequent = weights >= 8 * MIN_REPEATS  # levels of few Gaussians have unreliable places
    for _ in range(places.shape[1]):
        gaps = np.linalg.norm(places[:, None] - places[chosen], axis=2).min(axis=1)
        chosen.append(int(np.argmax(np.where(frequent, gaps, -1))))
    return places[chosen]
