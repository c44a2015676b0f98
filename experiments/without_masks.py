"""Measure the evidence from the attributes of an edited scene, without masks, and read classifiers.

Used by experiments whose scenes the classifier must not have seen: `train_classifier.py` leaves one
for every scene, which was trained on the others.
"""

import dataclasses
import functools
from collections.abc import Iterator
from pathlib import Path

import numpy as np
from cases import QUICK, Case, donor_name
from observations import Prediction
from runner import Args, heldout_masks, scores
from scipy.special import expit
from tables import Row

from gsc_jax.forensics.classifier import Classifier, default_classifier, from_arrays
from gsc_jax.forensics.evidence import ForensicEvidence, combine, estimate_from_attributes
from gsc_jax.scene import InputError

WITHOUT_TRACES, WITH_TRACES = "Gaussians, no traces", "Gaussians"
NO_MASKS = "no masks"


@dataclasses.dataclass(frozen=True, kw_only=True)
class KeepArgs(Args):
    """Arguments of an experiment that needs the classifiers.

    Attributes:
        keep: Folder in which `train_classifier.py` left a classifier for every scene.
    """

    keep: Path = Path(".cues")


@functools.cache
def classifier_without(scene: str, keep: Path) -> Classifier:
    """The classifier that never saw a scene; in a quick run, that of the package."""
    if scene == QUICK:
        return default_classifier()
    return stored(keep / f"without-{scene}.npz")


def stored(path: Path) -> Classifier:
    """Read a classifier from a file that `train_classifier.py` wrote."""
    if not path.exists():
        raise InputError(f"{path}: does not exist; run experiments/train_classifier.py first")
    with np.load(path) as arrays:
        return from_arrays(arrays)


def rows_without_masks(case: Case, evidence: ForensicEvidence) -> Iterator[Row]:
    """Measure the attributes without masks."""
    pasted = donor_name(case.scene.name, case.seed) if case.edit == "incorporation" else ""
    both = {WITHOUT_TRACES: combine(evidence.classification, ()), WITH_TRACES: evidence}
    findings = {name: estimate_from_attributes(one) for name, one in both.items()}
    predictions = [Prediction(score=f.attribute, labels=f.labels) for f in findings.values()]
    masks = heldout_masks(case.gaussians, case.scene.heldout, predictions)
    for (name, own), prediction, mask in zip(both.items(), predictions, masks, strict=True):
        names = " ".join(trace.name for trace in own.traces if trace.found)
        row = {**case.key, "export": "", "regime": NO_MASKS, "method": name}
        row |= {"verdict": own.verdict, "traces": names, "donor": pasted}
        row["ece"] = calibration_error(expit(own.log_odds), case.labels)
        if case.labels.any():
            yield row | scores(case, prediction, mask)
        else:
            yield row | {"false_area": float(mask.mean())}


def calibration_error(probability: np.ndarray, labels: np.ndarray) -> float:
    """Expected calibration error over ten bins."""
    bins = np.minimum((probability * 10).astype(int), 9)
    differences = np.bincount(bins, probability - labels, minlength=10)
    return float(np.abs(differences).sum() / len(labels))
