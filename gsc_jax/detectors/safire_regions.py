"""Forged region of an image from point-prompted masks, as in the test code of SAFIRE.

The feature of a mask is the mean embedding of the cells whose first pixel is inside it. Spherical
k-means (cosine distance, k = 2) partitions the masks. The most confident mask represents each
group, the smaller of the two is the forged region, and the probability is the mean of its mask and
of the complement of the other. If all masks are of one group, the most confident one is the region.

Differences, where the test code is unspecified or returns NaN:

- Masks without a cell and predictions that are not finite are ignored and counted.
- k-means takes the best of several seeded starts; one that gains nothing makes one group.
"""

import numpy as np
from scipy.special import expit

from gsc_jax.evidence.detector import resize_bilinear

STARTS = 16
"""Random starts of k-means; a test compares the result with all partitions of small sets."""
MAX_ITERATIONS = 100
"""Bound of Lloyd's iterations, which converge in a few; a safeguard against rounding cycles."""
MIN_GAIN = 1e-6
"""Smallest gain of cosine per mask by a second group; above the rounding of float32 embeddings."""
SATURATED_LOGIT = 80.0
"""Logits are clipped to this magnitude, at which a float32 sigmoid is 0 or 1, to interpolate."""


def point_grid(count: int, *, side: int) -> np.ndarray:
    """Centres (x, y) of count x count cells of a square image in pixels, (count^2, 2) float32."""
    centres = (np.arange(count, dtype=np.float32) + np.float32(0.5)) * np.float32(side / count)
    return np.stack(np.meshgrid(centres, centres), axis=-1).reshape(-1, 2)


def forged_region(
    logits: np.ndarray, confidences: np.ndarray, embeddings: np.ndarray, *, side: int, seed: int = 0
) -> tuple[np.ndarray, dict[str, int]]:
    """Probability of tampering from the masks of many prompts, (side, side) float32, and counts.

    The masks are logits, positive inside, shape (P, h, w), with predicted qualities (P,), and the
    embeddings of the image have shape (C, H, W). The seed is that of the starts of k-means.

    The probability is 0 if no mask is usable. Counts: "unusable" predictions, "one_source" images.
    """
    directions = mask_directions(logits, embeddings, side=side)
    usable = np.flatnonzero(np.isfinite(confidences) & np.isfinite(directions).all(axis=1))
    counts = {"unusable": len(logits) - len(usable), "one_source": 0}
    if not len(usable):
        return np.zeros((side, side), np.float32), counts
    groups = two_groups(directions[usable], seed=seed)
    if groups is None:
        counts["one_source"], groups = 1, np.zeros(len(usable), np.int64)
    best = [max(usable[groups == k], key=lambda mask: confidences[mask]) for k in np.unique(groups)]
    best.sort(key=lambda mask: ((logits[mask] > 0).sum(), confidences[mask]))
    clipped = [logits[mask].clip(-SATURATED_LOGIT, SATURATED_LOGIT) for mask in best]
    shares = [expit(resize_bilinear(mask, (side, side))) for mask in clipped]
    return (shares[0] if len(shares) == 1 else (shares[0] + 1 - shares[1]) / 2), counts


def mask_directions(logits: np.ndarray, embeddings: np.ndarray, *, side: int) -> np.ndarray:
    """Direction of the mean embedding inside each mask; see `forged_region` for the arguments.

    Unit vectors, shape (P, C) float64; NaN for an empty mask, and for NaN in mask or mean.
    """
    channels, rows, columns = embeddings.shape
    with np.errstate(all="ignore"):  # invalid results are NaN, as documented
        clipped = logits.clip(-SATURATED_LOGIT, SATURATED_LOGIT)
        sampled = _sampled(_sampled(clipped, rows, side, axis=1), columns, side, axis=2)
        inside = (sampled > 0).reshape(len(logits), -1).astype(np.float64)
        sums = inside @ embeddings.reshape(channels, -1).T.astype(np.float64)
        directions = sums / np.linalg.norm(sums, axis=1, keepdims=True)
    directions[np.isnan(logits).any(axis=(1, 2))] = np.nan
    return directions


def _sampled(logits: np.ndarray, cells: int, side: int, *, axis: int) -> np.ndarray:
    """Logits at the first pixel of each cell, interpolated as if resized to `side` pixels first."""
    count = logits.shape[axis]
    pixels = np.arange(cells) * side // cells
    places = ((pixels + 0.5) * count / side - 0.5).clip(0, count - 1)
    low = places.astype(np.int64)
    share = (places - low).reshape([-1 if k == axis else 1 for k in range(3)])
    first, second = (logits.take(k.clip(max=count - 1), axis) for k in (low, low + 1))
    return np.where(share > 0, first * (1 - share) + second * share, first)


def two_groups(directions: np.ndarray, *, seed: int = 0) -> np.ndarray | None:
    """Partition unit vectors (P, C) by spherical k-means, k = 2, with starts as in k-means++.

    The groups, 0 or 1, (P,), have the largest summed lengths of the sums of both groups; None if
    two groups explain no more than one. SciPy's k-means is Euclidean: its border is another.
    """
    rng = np.random.default_rng(seed)
    longest = np.linalg.norm(directions.sum(axis=0)) + MIN_GAIN * len(directions)
    found = None
    for _ in range(STARTS if len(directions) > 1 else 0):
        first = directions[rng.integers(len(directions))]
        distances = np.maximum(1 - directions @ first, 0)
        if not distances.sum() > 0:
            continue
        second = directions[rng.choice(len(directions), p=distances / distances.sum())]
        groups, length = _lloyd(directions, np.stack([first, second]))
        if length > longest:
            found, longest = groups, length
    return found


def _lloyd(directions: np.ndarray, centres: np.ndarray) -> tuple[np.ndarray, float]:
    """Groups after Lloyd's iteration from two centres, and the summed lengths of their sums."""
    groups, lengths = np.full(len(directions), -1), np.zeros(2)
    for _ in range(MAX_ITERATIONS):
        before, groups = groups, (directions @ centres.T).argmax(axis=1)
        sums = np.stack([directions[groups == k].sum(axis=0) for k in (0, 1)])
        lengths = np.linalg.norm(sums, axis=1)
        if (groups == before).all() or not lengths.min() > 0:
            break
        centres = sums / lengths[:, None]
    return groups, float(lengths.sum())
