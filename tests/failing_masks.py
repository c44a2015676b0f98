"""Made evidence of a scene with an edit, from masks with the failures of a 2D detector.

The decoy is an authentic region that masks may flag, too.
"""

import numpy as np

from gsc_jax.estimators import Finding, Prior, RobustEstimator
from gsc_jax.evidence.lifting import Evidence

VIEWS, COUNT = 12, 400
ESTIMATOR = RobustEstimator(sample=512)
AUTHENTIC, TAMPERED, DECOY = 0, 1, 2


def world(seed: int = 0) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Kinds (N,), centres (N, 3) in three clusters, and weights (V, N)."""
    rng = np.random.default_rng(seed)
    kinds = rng.choice([AUTHENTIC, TAMPERED, DECOY], COUNT, p=[0.7, 0.15, 0.15])
    means = rng.normal(size=(COUNT, 3)) + 20 * np.eye(3)[kinds]
    total = rng.exponential(20, (VIEWS, COUNT)) * (rng.random((VIEWS, COUNT)) < 0.8)
    return kinds, means.astype(np.float32), total.astype(np.float32)


KINDS, MEANS, TOTAL = world()
TRUE = KINDS == TAMPERED


def masked(flagged: np.ndarray, total: np.ndarray = TOTAL, noise: float = 0.05) -> Evidence:
    """Evidence of masks that flag these Gaussians in these views (V, N), up to noise."""
    rng = np.random.default_rng(1)
    rate = np.where(flagged, 1 - noise * rng.random(total.shape), noise * rng.random(total.shape))
    return Evidence(total=total, tampered=(total * rate).astype(np.float32))


def failing(failure: str) -> np.ndarray:
    """Flagged Gaussians, shape (V, N), of a detector with one kind of failure."""
    flagged = np.tile(TRUE, (VIEWS, 1))
    if failure in ("misses", "mixture"):
        flagged[[1, 4, 9]] = False
    if failure in ("consistent", "mixture"):
        flagged[np.ix_([0, 1, 3, 6, 8], KINDS == DECOY)] = True
    if failure in ("inverted", "mixture"):
        flagged[[2, 7]] = ~flagged[[2, 7]]
    return flagged


def estimate(
    evidence: Evidence, estimator: RobustEstimator = ESTIMATOR, prior: Prior | None = None
) -> Finding:
    return estimator.estimate_from_evidence(evidence, MEANS, prior)


def verdict_of(evidence: Evidence, estimator: RobustEstimator = ESTIMATOR) -> float:
    verdict = estimate(evidence, estimator).verdict
    assert verdict is not None
    return verdict


def labels_of(evidence: Evidence, means: np.ndarray = MEANS) -> np.ndarray:
    return ESTIMATOR.from_masks(evidence, means).probability > 0.5
