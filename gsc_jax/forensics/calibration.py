"""Calibration: log odds of Gaussians and scenes, and the log odds above which they are labelled.

Calibrated probabilities are mostly small, since many scenes are misclassified. Given that a scene
was edited, the tampered Gaussians are those that differ most, so the level is chosen per scene.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.special import expit

from gsc_jax.forensics.classifier import Classifier
from gsc_jax.forensics.places import Places
from gsc_jax.forensics.traces import Trace, any_trace

MAX_LOG_ODDS = 12.0
"""Clip log odds to this magnitude: probabilities within 1e-5 of 0 or 1 are not calibrated."""
LEVEL = 0.5
"""Share of the way from `middle` to `top` of a scene above which Gaussians are labelled."""
MIN_TRACED_SHARE = 0.1
"""Share of the Gaussians above the level that traces must mark to count as identifying the edit."""
LEVEL_BESIDE_TRACES = 2.0
"""Log odds from which Gaussians without a trace are labelled in a file in which traces of editing
were found: the value with the highest F1 on the edited scenes of experiments/bank.py."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Classification:
    """Calibrated output of the classifier for a scene of N Gaussians.

    The log odds (N,) float32 that a Gaussian is tampered are the base rate where no features are
    `known`, (N,) bool. Before the edge was moved (`edge.py`), `middle` is the median of the others,
    at most the base rate, `peak` the highest mean around a place, and `top` the mean of all such
    means that are nearer to it than to the middle: a peak alone may be a small part of an edit.
    """

    known: np.ndarray
    log_odds: np.ndarray
    middle: float
    peak: float
    top: float
    scene_probability: float

    @property
    def span(self) -> float:
        """From the middle to the peak."""
        return max(self.peak - self.middle, 0.0)

    @property
    def level(self) -> float:
        """Log odds above which Gaussians stand out from the scene."""
        return self.middle + LEVEL * max(self.top - self.middle, 0.0)


def calibrate(raw: np.ndarray, places: Places, classifier: Classifier) -> Classification:
    """Calibrate raw log odds (N,) of Gaussians in places.

    Most of a scene is authentic. If its median is above the base rate, the scene differs from the
    training data, and all log odds are lowered until the median is at the base rate.
    """
    factor, shift = classifier.calibration
    lowered = factor * raw + shift
    lowered -= max(float(np.median(lowered)) - classifier.base, 0.0)
    log_odds = np.clip(lowered, -MAX_LOG_ODDS, MAX_LOG_ODDS).astype(np.float32)
    around = places.around.mean(places.averaged(log_odds))
    middle, peak = float(np.median(log_odds)), float(around.max())
    factor, shift = classifier.scene
    return Classification(
        known=np.ones(len(raw), bool),
        log_odds=log_odds,
        middle=middle,
        peak=peak,
        top=float(around[around >= min((middle + peak) / 2, peak)].mean()),
        scene_probability=float(expit(factor * (peak - middle) + shift)),
    )


def nothing_known(classifier: Classifier) -> Classification:
    """Classification of no Gaussians."""
    return Classification(
        known=np.zeros(0, bool),
        log_odds=np.zeros(0, np.float32),
        middle=classifier.base,
        peak=classifier.base,
        top=classifier.base,
        scene_probability=float(expit(classifier.scene[1])),
    )


def label_level(scene: Classification, traces: Sequence[Trace] = ()) -> float:
    """Log odds above which Gaussians are labelled.

    If traces are found, and the classifier alone would not call the scene edited or they mark some
    of the Gaussians above the level, they identify the edit: others need `LEVEL_BESIDE_TRACES`.
    """
    if not any(trace.found for trace in traces):
        return scene.level
    above = scene.log_odds > scene.level
    traced = above & (any_trace(traces) > 0.5)
    if scene.scene_probability > 0.5 and traced.sum() <= MIN_TRACED_SHARE * above.sum():
        return scene.level
    return max(scene.level, LEVEL_BESIDE_TRACES)
