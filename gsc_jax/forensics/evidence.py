"""Forensic evidence: how likely each Gaussian is tampered, from the attributes of the scene alone.

Combines classifier and traces to a prior of `robust`, or the only evidence where no masks exist.
"""

import dataclasses
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np
from scipy.special import expit

from gsc_jax.estimators.protocol import Finding, Prior
from gsc_jax.forensics import calibration, features
from gsc_jax.forensics.calibration import MAX_LOG_ODDS, Classification
from gsc_jax.forensics.classifier import Classifier, combined_log_odds, default_classifier
from gsc_jax.forensics.copy_move import copy_move
from gsc_jax.forensics.edge import sharpened
from gsc_jax.forensics.places import find_places
from gsc_jax.forensics.quantisation import quantisation
from gsc_jax.forensics.row_order import row_order
from gsc_jax.forensics.traces import NEIGHBOURS, Trace, any_trace, quaternion_convention, sh_degree
from gsc_jax.scene import Gaussians
from gsc_jax.scene.errors import in_range
from gsc_jax.scene.gaussians import usable_rows
from gsc_jax.scene.neighbours import order_of_leaves
from gsc_jax.scene.pytree import short_repr

TOO_FEW = "There are too few valid Gaussians for forensic features; none is scored."
LOCAL_TRACES = quantisation, sh_degree, quaternion_convention
"""Traces that are functions of N Gaussians with finite values and of their neighbours (N, K)."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class ForensicEvidence(Prior):
    """Evidence from the attributes of N Gaussians, with these attributes besides those of `Prior`.

    Attributes:
        log_odds: Calibrated log odds that a Gaussian is tampered, by classifier and traces, shape
            (N,) float32; the base rate where nothing is known.
        level: Log odds above which Gaussians are labelled; `probability` is 0.5 there.
        traces: All traces, also those that were not found; empty if they were not computed.
        classification: Output of the classifier.
    """

    log_odds: np.ndarray
    level: float
    traces: tuple[Trace, ...]
    classification: Classification

    __repr__ = short_repr


def forensic_evidence(
    gaussians: Gaussians, *, classifier: Classifier | None = None, with_traces: bool = True
) -> ForensicEvidence:
    """Compute the evidence of tampering in the attributes of Gaussians.

    Args:
        gaussians: N Gaussians; rows that cannot be rendered are left out.
        classifier: Replaces the one that comes with the package.
        with_traces: Whether to compute the traces, too, which a re-export of the file may remove.

    Returns:
        The evidence. It depends on the order of the rows only in the trace "row-order".
    """
    classifier = classifier or default_classifier()
    host = jax.tree.map(np.asarray, gaussians)
    rows = np.flatnonzero(usable_rows(host))
    enough = len(rows) > features.NEIGHBOURS  # fewer have no surroundings
    # Neighbours in space are close in memory, which is faster.
    rows = rows[order_of_leaves(host.means[rows])] if enough else rows[:0]
    sound = features.with_finite_scales(host.take(rows))
    computed = features.compute_features(sound) if enough else None
    with ThreadPoolExecutor(1) as beside:
        found = beside.submit(_traces, sound, computed, np.argsort(rows)) if with_traces else None
        output = calibration.nothing_known(classifier)
        if computed:
            places = find_places(computed, np.asarray(sound.means, np.float32))
            raw = combined_log_odds(computed, places, classifier)
            output = sharpened(calibration.calibrate(raw, places, classifier), computed, places)
    place = np.full(len(host), -1)  # of each Gaussian of the file in the rows
    place[rows] = np.arange(len(rows))
    log_odds = np.append(output.log_odds, np.float32(classifier.base))[place]
    output = dataclasses.replace(output, known=place >= 0, log_odds=log_odds)
    traces = [
        dataclasses.replace(trace, score=np.append(trace.score, np.float32(0))[place])
        for trace in (found.result() if found else ())
    ]
    return combine(output, traces)


def _traces(sound: Gaussians, computed: features.Features | None, order: np.ndarray) -> list[Trace]:
    """All traces, given the order of the Gaussians in the file; none if there are no features."""
    near = (computed.neighbourhoods.nearest if computed else np.zeros((0, 0), int))[:, :NEIGHBOURS]
    duplicates = computed.duplicates if computed else None
    local = [trace(sound, near) for trace in LOCAL_TRACES]
    return [copy_move(sound, near, duplicates), *local, row_order(sound, order)]


def combine(output: Classification, traces: Sequence[Trace]) -> ForensicEvidence:
    """Combine the calibrated output of the classifier with the traces of the same Gaussians."""
    log_odds = add_traces(output.log_odds, traces)
    level = calibration.label_level(output, traces)
    probability = np.where(output.known, expit(log_odds - level), 0).astype(np.float32)
    scene = output.scene_probability if output.known.any() else 0.5  # nothing was scored
    strongest = max((float(trace.score.max(initial=0)) for trace in traces), default=0.0)
    return ForensicEvidence(
        probability=probability,
        verdict=1 - (1 - scene) * (1 - strongest),
        known=output.known,
        exact=_identified(probability > 0.5, traces),
        log_odds=log_odds,
        level=level,
        traces=tuple(traces),
        classification=output,
    )


def add_traces(log_odds: np.ndarray, traces: Sequence[Trace]) -> np.ndarray:
    """Log odds of the noisy-or of log odds (N,) and traces: either alone is sufficient."""
    if not traces:
        return log_odds
    score = np.minimum(any_trace(traces), 1 - 1e-6)
    with np.errstate(divide="ignore"):  # a score of 0 leaves the log odds as they are
        return np.minimum(np.logaddexp(log_odds, np.log(score)) - np.log1p(-score), MAX_LOG_ODDS)


def _identified(labels: np.ndarray, traces: Sequence[Trace]) -> bool:
    """Whether traces mark most labels; copy-move does not count, either copy may be the edit."""
    found = [trace for trace in traces if trace.found and trace.name != "copy-move"]
    return bool(found) and bool(2 * (labels & (any_trace(found) > 0.5)).sum() > labels.sum())


def estimate_from_attributes(
    evidence: ForensicEvidence, *, threshold: float = 0.5, min_verdict: float = 0.06
) -> Finding:
    """Estimate the tampered Gaussians without masks.

    Args:
        evidence: Forensic evidence of N Gaussians.
        threshold: Score above which a Gaussian is labelled.
        min_verdict: Scene probability below which nothing is labelled.

    Returns:
        The finding. Its attribute is the log odds above `level`, and 0 where nothing is known.

    Raises:
        ValueError: if the threshold or the least scene probability is outside of [0, 1].
    """
    if not (in_range(threshold, 0.0, 1.0) and in_range(min_verdict, 0.0, 1.0)):
        raise ValueError(
            f"threshold and min_verdict must be in [0, 1], got {threshold} and {min_verdict}"
        )
    edited = evidence.verdict >= min_verdict
    labels = (evidence.probability > threshold) & edited
    relative = np.where(evidence.known, evidence.log_odds - evidence.level, 0)
    return Finding(
        tamper=evidence.probability * edited,
        labels=labels,
        attribute=relative.astype(np.float32),
        verdict=evidence.verdict,
        warnings=[] if evidence.known.any() else [TOO_FEW],
    )
