"""Log odds of the classifier as evidence, without running it."""

import numpy as np

from gsc_jax.forensics.calibration import Classification
from gsc_jax.forensics.evidence import ForensicEvidence, combine
from gsc_jax.forensics.traces import Trace

BASE, PEAK = -3.0, 7.0


def classified(log_odds, probability: float = 0.9, peak: float = PEAK) -> Classification:
    """Output of the classifier for Gaussians that are all known."""
    log_odds = np.asarray(log_odds, np.float32)
    return Classification(
        known=np.ones(len(log_odds), bool),
        log_odds=log_odds,
        base=BASE,
        peak=peak,
        scene_probability=probability,
    )


def evidence_of(
    log_odds, probability: float = 0.9, *, rows: tuple[int, ...] = (), name: str = "copy-move"
) -> ForensicEvidence:
    """Evidence of the classifier, and of a trace that marks some rows."""
    score = np.zeros(len(log_odds), np.float32)
    score[list(rows)] = 0.999
    traces = [Trace(name=name, score=score, explanation="")] if rows else []
    return combine(classified(log_odds, probability), traces)


def two_groups(seed: int, edited: int) -> np.ndarray:
    """Log odds of 20,000 Gaussians, of which the last ones are higher."""
    rng = np.random.default_rng(seed)
    return np.append(rng.normal(-4, 0.6, 20_000 - edited), rng.normal(1.5, 1, edited))
