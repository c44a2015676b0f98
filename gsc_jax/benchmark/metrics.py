"""Metrics of masks and labels.

The metrics are those of IMDL-BenCo, which the paper's tables use: P = TP / (TP + FP + e), R = TP /
(TP + FN + e), F1 = 2 P R / (P + R + e) and IoU = TP / (TP + FP + FN + e) with e = 1e-8, in each
view; then the mean over the tampered views. Labels of Gaussians are counted likewise.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gsc_jax.evidence.masks import rendered_share
from gsc_jax.render.projection import NEAR
from gsc_jax.scene import Array, Camera, Gaussians
from gsc_jax.scene.statistics import superiority

EPSILON = 1e-8


class Confusion(NamedTuple):
    """Counts of the four outcomes."""

    tp: float
    fp: float
    fn: float
    tn: float

    @property
    def precision(self) -> float:
        """Tampered share of the flagged entries."""
        return self.tp / (self.tp + self.fp + EPSILON)

    @property
    def recall(self) -> float:
        """Flagged share of the tampered entries."""
        return self.tp / (self.tp + self.fn + EPSILON)

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall."""
        return 2 * self.precision * self.recall / (self.precision + self.recall + EPSILON)

    @property
    def iou(self) -> float:
        """Intersection over union of the flagged and the tampered entries."""
        return self.tp / (self.tp + self.fp + self.fn + EPSILON)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scores:
    """Mean metrics over the tampered views; NaN if no view is tampered.

    `views` (M,) are the tampered views, and `per_view` has their F1, IoU, precision, recall, (M,).
    """

    f1: float
    iou: float
    precision: float
    recall: float
    views: np.ndarray
    per_view: dict[str, np.ndarray]


def confusion(prediction: Array, truth: Array) -> Confusion:
    """Count outcomes of bools, or of numbers, true where > 0.5; ValueError for different shapes."""
    flagged, tampered = _binary(prediction), _binary(truth)
    if flagged.shape != tampered.shape:
        raise ValueError(f"prediction has shape {flagged.shape}, but truth {tampered.shape}")
    outcomes = flagged & tampered, flagged & ~tampered, ~flagged & tampered, ~flagged & ~tampered
    return Confusion(*(float(np.count_nonzero(outcome)) for outcome in outcomes))


def mean_over_tampered_views(predictions: Sequence[Array], truths: Sequence[Array]) -> Scores:
    """F1, IoU, precision and recall of masks (H, W), one per view, averaged over tampered views."""
    if len(predictions) != len(truths):
        raise ValueError(f"{len(predictions)} predictions, but {len(truths)} truths")
    views = np.array([i for i, truth in enumerate(truths) if _binary(truth).any()], int)
    counts = [confusion(predictions[view], truths[view]) for view in views]
    names = "f1", "iou", "precision", "recall"
    per_view = {name: np.array([getattr(count, name) for count in counts]) for name in names}
    # NumPy would warn about the mean of no view.
    means = {name: float(v.mean()) if v.size else float("nan") for name, v in per_view.items()}
    return Scores(**means, views=views, per_view=per_view)


def auc(scores: Array, truth: Array) -> float:
    """Probability that a tampered entry scores above an authentic one, ties counted half.

    This is the area under the ROC curve, Mann and Whitney's U by pair; NaN if all entries are
    of one kind. Other shapes than those of the truth, and NaN scores, raise ValueError.
    """
    scores, tampered = np.ravel(scores), np.ravel(_binary(truth))
    if scores.shape != tampered.shape:
        raise ValueError(f"{scores.size} scores, but {tampered.size} truths")
    if np.isnan(scores).any():
        raise ValueError(f"{np.isnan(scores).sum()} of {scores.size} scores are NaN, expected none")
    return superiority(scores, tampered)


def truth_mask(
    gaussians: Gaussians, camera: Camera, labels: Array, *, near: float = NEAR
) -> np.ndarray:
    """True mask (H, W) of a view, from the labels (N,) of the Gaussians.

    A covered pixel (alpha > 0.1) is tampered where tampered Gaussians have most of its weight.
    """
    return rendered_share(gaussians, camera, labels, near=near) > 0.5


def _binary(values: Array) -> np.ndarray:
    values = np.asarray(values)
    return values if values.dtype == bool else values > 0.5
