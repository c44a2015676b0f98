"""Which part of an image comes from another source, from masks that were each prompted by a point.

This is how SAFIRE (Kwon et al., AAAI 2025) is read, as in its test code for binary localisation:
the feature of a mask is the mean of the embeddings that it covers; k-means with k = 2 and cosine
distance parts the masks by feature; of each group the mask of the highest confidence counts, the
smaller of these two is the forged region, and the probability is the mean of what it says and of
what the larger one leaves.

Ours are the following, since its test code says nothing of them or ends in NaN there:

- Embeddings are weighted by how much of a cell the mask covers. There, cells are sampled, and a
  mask that meets no sample has the mean of nothing as its feature.
- Masks that cover nothing, and predictions that are not finite, are left out and counted.
- k-means takes the best of several seeded starts. Where a second group explains nothing, the image
  has one source, and nothing is flagged.
- Nothing is flagged where one of the two confidences is not above 0.5. The confidence is trained
  towards the share of pixels that are right, so the network itself trusts such a mask less than
  its complement.
"""

import numpy as np

MIN_CONFIDENCE = 0.5
"""What both of the chosen masks have to exceed."""

STARTS = 16
ITERATIONS = 100

MIN_GAIN = 1e-6
"""Cosine that a second group has to gain per mask; below it is the rounding of the embeddings."""

SATURATED = 80.0
"""A logit at which a sigmoid is 0 or 1 in float32; larger ones could not be interpolated."""


def point_grid(count: int, *, side: int) -> np.ndarray:
    """Points in the centres of a regular grid, row by row, as SAM prompts a whole image.

    Args:
        count: Points per side of the image.
        side: Pixels per side of the image.

    Returns:
        x and y in pixels, shape (count^2, 2) float32.
    """
    centres = (np.arange(count, dtype=np.float32) + np.float32(0.5)) * np.float32(side / count)
    x, y = np.meshgrid(centres, centres)
    return np.stack([x.ravel(), y.ravel()], axis=-1)


def forged_region(
    logits: np.ndarray,
    confidences: np.ndarray,
    embeddings: np.ndarray,
    *,
    side: int,
    seed: int = 0,
) -> tuple[np.ndarray, dict[str, int]]:
    """The probability of being forged, from the masks of many prompts.

    Args:
        logits: The masks, inside where positive, shape (P, h, w).
        confidences: How right the network expects each of them to be, shape (P,).
        embeddings: Of the image, shape (C, H, W); H divides h, W divides w.
        side: Pixels per side of the result.
        seed: Of the starts of k-means.

    Returns:
        Probability, shape (side, side) float32, 0 everywhere where nothing is flagged; and counts:
        `unusable` predictions, and whether the image has `one_source` or its masks are `unsure`.
    """
    directions = mask_directions(logits, embeddings)
    usable = np.isfinite(confidences) & np.isfinite(directions).all(axis=1)
    note = {"unusable": int((~usable).sum()), "one_source": 0, "unsure": 0}
    nothing = np.zeros((side, side), np.float32)
    places = np.flatnonzero(usable)
    groups = two_groups(directions[places], seed=seed)
    if groups is None:
        return nothing, note | {"one_source": 1}
    best = [max(places[groups == k], key=lambda place: confidences[place]) for k in (0, 1)]
    if not confidences[best].min() > MIN_CONFIDENCE:
        return nothing, note | {"unsure": 1}
    forged, rest = sorted(best, key=lambda place: ((logits[place] > 0).sum(), confidences[place]))
    return (_sigmoid(logits[forged], side) + 1 - _sigmoid(logits[rest], side)) / 2, note


def mask_directions(logits: np.ndarray, embeddings: np.ndarray) -> np.ndarray:
    """The mean embedding inside each mask, as a direction.

    Args:
        logits: Inside where positive, shape (P, h, w).
        embeddings: Shape (C, H, W); H divides h, W divides w.

    Returns:
        Unit vectors, shape (P, C) float64; NaN where a mask is empty or not a number, or where the
        mean is not finite or zero.
    """
    count, height, width = logits.shape
    channels, rows, columns = embeddings.shape
    cells = (count, rows, height // rows, columns, width // columns)
    covered = (logits > 0).reshape(cells).mean(axis=(2, 4)).reshape(count, -1)
    with np.errstate(all="ignore"):  # whatever is not finite in the end is NaN
        sums = covered @ embeddings.reshape(channels, -1).T.astype(np.float64)
        directions = sums / np.linalg.norm(sums, axis=1, keepdims=True)
    directions[np.isnan(logits).any(axis=(1, 2))] = np.nan
    return directions


def two_groups(directions: np.ndarray, *, seed: int = 0) -> np.ndarray | None:
    """Spherical k-means with k = 2: the two groups whose sums are longest together.

    Written out because the k-means of SciPy is Euclidean: its centres shrink with the spread of
    their group, which moves the border towards the narrower one.

    Args:
        directions: Unit vectors, shape (P, C).
        seed: Of the starts, drawn as in k-means++.

    Returns:
        0 or 1 for each, shape (P,); None if there are not two, or two explain no more than one.
    """
    rng = np.random.default_rng(seed)
    least = np.linalg.norm(directions.sum(axis=0)) + MIN_GAIN * len(directions)
    found = None
    for _ in range(STARTS if len(directions) > 1 else 0):
        first = directions[rng.integers(len(directions))]
        distances = np.maximum(1 - directions @ first, 0)
        if not distances.sum() > 0:
            continue
        second = directions[rng.choice(len(directions), p=distances / distances.sum())]
        groups, length = _settle(directions, np.stack([first, second]))
        if length > least:
            found, least = groups, length
    return found


def _settle(directions: np.ndarray, centres: np.ndarray) -> tuple[np.ndarray, float]:
    """Lloyd's iteration from two centres: the groups, and how long their sums are together."""
    groups, lengths = np.full(len(directions), -1), np.zeros(2)
    for _ in range(ITERATIONS):
        before, groups = groups, (directions @ centres.T).argmax(axis=1)
        sums = np.stack([directions[groups == k].sum(axis=0) for k in (0, 1)])
        lengths = np.linalg.norm(sums, axis=1)
        if (groups == before).all() or not lengths.min() > 0:
            break
        centres = sums / lengths[:, None]
    return groups, float(lengths.sum())


def _sigmoid(logits: np.ndarray, side: int) -> np.ndarray:
    """The probability of a mask at the size of the image: logits are interpolated, as there."""
    from scipy.special import expit
    from skimage.transform import resize

    bounded = np.clip(logits, -SATURATED, SATURATED)
    return expit(np.asarray(resize(bounded, (side, side), order=1), np.float32))
