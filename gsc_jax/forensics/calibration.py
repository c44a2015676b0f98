"""Calibration: log odds of Gaussians and scenes, and the log odds above which they are labelled.

Calibrated probabilities are mostly small, since many scenes are misclassified. Given that a scene
was edited, the tampered Gaussians are those that differ most, so the level is chosen per scene.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.special import expit

from gsc_jax.forensics.classifier import Classifier
from gsc_jax.forensics.traces import Trace, any_trace
from gsc_jax.scene.neighbours import parts

MAX_LOG_ODDS = 12.0
"""Clip log odds to this magnitude: probabilities within 1e-5 of 0 or 1 are not calibrated."""
PART = 64
"""Gaussians in a part of a scene; the part with the highest mean log odds represents the scene."""
LEVEL = 0.42
"""Level of labelling, from the median of a scene (0) to its peak (1), chosen by F1 on cases of
experiments/bank.py by classifiers that never saw their hosts."""
MIN_TRACED_SHARE = 0.1
"""Share of the Gaussians above the level that traces must mark to count as identifying the edit."""
LEVEL_BESIDE_TRACES = 1.0
"""Log odds from which Gaussians without a trace are labelled beside traces."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Classification:
    """Calibrated output of the classifier for a scene of N Gaussians.

    The log odds (N,) float32 that a Gaussian is tampered are `base` where no features are `known`,
    (N,) bool; `peak` is their mean in the part of the scene where it is highest.
    """

    known: np.ndarray
    log_odds: np.ndarray
    base: float
    peak: float
    scene_probability: float


def calibrate(
    raw: np.ndarray, means: np.ndarray, known: np.ndarray, classifier: Classifier
) -> Classification:
    """Calibrate smoothed raw log odds (M,) of the Gaussians with these means (M, 3).

    `known` is the mask of these M among all N Gaussians, shape (N,).
    """
    base = peak = middle = classifier.base
    log_odds = np.full(len(known), base, np.float32)
    if len(raw):
        factor, shift = scene_calibration(raw, classifier)
        calibrated = np.clip(factor * raw + shift, -MAX_LOG_ODDS, MAX_LOG_ODDS)
        log_odds[known] = calibrated
        peak, middle = peak_log_odds(calibrated, means), float(np.median(calibrated))
    factor, shift = classifier.scene
    probability = float(expit(factor * (peak - middle) + shift))
    return Classification(
        known=known, log_odds=log_odds, base=base, peak=peak, scene_probability=probability
    )


def scene_calibration(raw: np.ndarray, classifier: Classifier) -> tuple[float, float]:
    """Factor and shift from raw to calibrated log odds of the Gaussians of one scene.

    Most of a scene is authentic. If its median is above the base rate, the scene differs from the
    training data, and the shift is lowered until the median is at the base rate.
    """
    factor, shift = classifier.calibration
    excess = factor * float(np.median(raw)) + shift - classifier.base
    return factor, shift - max(excess, 0.0)


def peak_log_odds(log_odds: np.ndarray, means: np.ndarray) -> float:
    """Mean log odds of the compact part of a scene where it is highest."""
    order, starts = parts(means, PART)
    sums = np.add.reduceat(log_odds[order], starts, dtype=float)
    return float((sums / np.diff(starts, append=len(order))).max())


def label_level(scene: Classification, traces: Sequence[Trace] = ()) -> float:
    """Log odds above which Gaussians are labelled.

    If traces are found, and the classifier alone would not call the scene edited or they mark some
    of the Gaussians above the level, they identify the edit: others need `LEVEL_BESIDE_TRACES`.
    """
    known = scene.log_odds[scene.known]
    middle = min(float(np.median(known)), scene.base) if len(known) else scene.base
    level = middle + LEVEL * max(scene.peak - middle, 0.0)
    if not any(trace.found for trace in traces):
        return level
    above = scene.log_odds > level
    traced = above & (any_trace(traces) > 0.5)
    if scene.scene_probability > 0.5 and traced.sum() <= MIN_TRACED_SHARE * above.sum():
        return level
    return max(level, LEVEL_BESIDE_TRACES)
