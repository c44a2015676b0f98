"""How well something was found, by the definitions of IMDL-BenCo, which the paper's tables use.

P = TP / (TP + FP + e), R = TP / (TP + FN + e), F1 = 2 P R / (P + R + e) and IoU = TP / (TP + FP +
FN + e) with e = 1e-8, for predictions and truths > 0.5, in each view; then the mean over the views
in which something is tampered. In an authentic view F1 is 0 by construction, so its measure is
the flagged area. Nothing here picks the better of a mask and its complement.

The same counts with one weight per entry serve labels of Gaussians, weighted by opacity.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gsc_jax.evidence.masks import rendered_share
from gsc_jax.render.projection import NEAR
from gsc_jax.scene import Array, Camera, Gaussians

EPSILON = 1e-8


class Confusion(NamedTuple):
    """Summed weights, or counts, of the four outcomes."""

    tp: float
    fp: float
    fn: float
    tn: float

    @property
    def precision(self) -> float:
        """The share of what was flagged that is tampered."""
        return self.tp / (self.tp + self.fp + EPSILON)

    @property
    def recall(self) -> float:
        """The share of what is tampered that was flagged."""
        return self.tp / (self.tp + self.fn + EPSILON)

    @property
    def f1(self) -> float:
        """The harmonic mean of precision and recall."""
        return 2 * self.precision * self.recall / (self.precision + self.recall + EPSILON)

    @property
    def iou(self) -> float:
        """Intersection over union of what was flagged and what is tampered."""
        return self.tp / (self.tp + self.fp + self.fn + EPSILON)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scores:
    """Means over the tampered views, and the views they come from.

    Attributes:
        f1: Mean F1; not a number if no view is tampered, as the other means.
        iou: Mean intersection over union.
        precision: Mean precision.
        recall: Mean recall.
        views: Indices of the tampered views, shape (M,).
        per_view: F1, IoU, precision and recall of these views, by name, each of shape (M,).
    """

    f1: float
    iou: float
    precision: float
    recall: float
    views: np.ndarray
    per_view: dict[str, np.ndarray]


def confusion(prediction: Array, truth: Array, *, weights: Array | None = None) -> Confusion:
    """Counts of the four outcomes, whatever the shape.

    Args:
        prediction: Bool, or numbers that are flagged where > 0.5.
        truth: Bool, or numbers that are tampered where > 0.5, same shape.
        weights: What each entry counts, for instance the opacities of Gaussians; 1 by default.

    Returns:
        Summed weights of true and false positives, false and true negatives.

    Raises:
        ValueError: if the shapes differ.
    """
    flagged, tampered = _binary(prediction), _binary(truth)
    if flagged.shape != tampered.shape:
        raise ValueError(f"prediction has shape {flagged.shape}, but truth {tampered.shape}")
    counts = np.ones(flagged.shape) if weights is None else np.asarray(weights, np.float64)
    if counts.shape != flagged.shape:
        raise ValueError(f"weights have shape {counts.shape}, expected {flagged.shape}")
    outcomes = flagged & tampered, flagged & ~tampered, ~flagged & tampered, ~flagged & ~tampered
    return Confusion(*(float(counts[outcome].sum()) for outcome in outcomes))


def f1_score(prediction: Array, truth: Array, *, weights: Array | None = None) -> float:
    """F1 of a mask, or of labels per Gaussian; see `confusion` for the arguments."""
    return confusion(prediction, truth, weights=weights).f1


def iou(prediction: Array, truth: Array, *, weights: Array | None = None) -> float:
    """Intersection over union of a mask, or of labels; see `confusion` for the arguments."""
    return confusion(prediction, truth, weights=weights).iou


def mean_over_tampered_views(predictions: Sequence[Array], truths: Sequence[Array]) -> Scores:
    """The headline: F1, IoU, precision and recall, averaged over the tampered views.

    Args:
        predictions: One mask per view, each of shape (H, W), sizes may differ between views.
        truths: The true masks, in the same order.

    Returns:
        The scores.

    Raises:
        ValueError: if the numbers of views differ, or the sizes in a view.
    """
    if len(predictions) != len(truths):
        raise ValueError(f"{len(predictions)} predictions, but {len(truths)} truths")
    views = np.array([i for i, truth in enumerate(truths) if _binary(truth).any()], int)
    counts = [confusion(predictions[view], truths[view]) for view in views]
    names = "f1", "iou", "precision", "recall"
    per_view = {name: np.array([getattr(count, name) for count in counts]) for name in names}
    # The mean of nothing is not a number; NumPy would warn, and the empty `views` say it.
    means = {name: float(v.mean()) if v.size else float("nan") for name, v in per_view.items()}
    return Scores(**means, views=views, per_view=per_view)


def false_positive_area(predictions: Sequence[Array]) -> np.ndarray:
    """The measure for authentic views: the share of their pixels that was flagged.

    Args:
        predictions: One mask per authentic view, each of shape (H, W).

    Returns:
        Shares in [0, 1], shape (V,).
    """
    return np.array([_binary(prediction).mean() for prediction in predictions], np.float64)


def auc(scores: Array, truth: Array) -> float:
    """Area under the ROC curve: the chance that a tampered entry scores above an authentic one.

    Ties count half, as in Mann and Whitney's U.

    Args:
        scores: Any numbers, larger where more tampered; not one NaN.
        truth: Bool, or numbers that are tampered where > 0.5, same shape.

    Returns:
        The area in [0, 1]; not a number if all entries are of one kind.

    Raises:
        ValueError: if the shapes differ or a score is NaN.
    """
    from scipy.stats import rankdata

    scores, tampered = np.ravel(scores), np.ravel(_binary(truth))
    if scores.shape != tampered.shape:
        raise ValueError(f"{scores.size} scores, but {tampered.size} truths")
    if np.isnan(scores).any():
        raise ValueError(f"{np.isnan(scores).sum()} of {scores.size} scores are NaN, expected none")
    positives = int(tampered.sum())
    negatives = tampered.size - positives
    if not positives or not negatives:
        return float("nan")
    wins = rankdata(scores)[tampered].sum() - positives * (positives + 1) / 2
    return float(wins / (positives * negatives))


def truth_mask(
    gaussians: Gaussians, camera: Camera, labels: Array, *, near: float = NEAR
) -> np.ndarray:
    """Where a view shows something tampered, from the labels of the Gaussians.

    Args:
        gaussians: N Gaussians.
        camera: The view.
        labels: True where tampered, shape (N,).
        near: Near plane in world units.

    Returns:
        True where more than half of what covers the pixel is tampered and it is covered at all
        (alpha > 0.1), shape (H, W) bool.
    """
    return rendered_share(gaussians, camera, labels, near=near) > 0.5


def _binary(values: Array) -> np.ndarray:
    values = np.asarray(values)
    return values if values.dtype == bool else values > 0.5
