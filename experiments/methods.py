"""All methods of the tables as functions of an observation: baselines, GS-Checker, `robust`."""

import dataclasses
import functools
from collections.abc import Callable, Mapping

import jax.numpy as jnp
import numpy as np
from baselines import (
    SA3D_LEVEL,
    flashsplat,
    inverse_projection,
    mode_vote,
    sa3d,
    sagd_boundary,
    sagd_vote,
)
from observations import AllRegimes, CaseObservation, Method, Prediction

from gsc_jax.benchmark.metrics import confusion
from gsc_jax.estimators import METHODS
from gsc_jax.estimators.gschecker import OFFICIAL, GSChecker
from gsc_jax.estimators.protocol import Estimator
from gsc_jax.evidence.lifting import Evidence
from gsc_jax.splat import composite


def labelled(labels: np.ndarray) -> Prediction:
    """Prediction of a method that only labels."""
    labels = np.asarray(labels)
    return Prediction(score=labels.astype(np.float32), labels=labels)


def seeded(estimator: Estimator, seed: int) -> Estimator:
    """The estimator with another seed."""
    return dataclasses.replace(estimator, seed=seed)  # type: ignore[type-var]


def predict_with(estimator: Estimator, *, own_rule: bool = False) -> Method:
    """Method of an estimator; masks are rendered from its labels, or from its score if own_rule."""

    def method(observed: CaseObservation) -> Prediction:
        finding = seeded(estimator, observed.case.seed).estimate(observed.observation)
        own = {"feature": finding.tamper, "level": estimator.threshold} if own_rule else {}
        return Prediction(score=finding.attribute, labels=finding.labels, **own)

    return method


def if_called_tampered(observed: CaseObservation) -> Prediction:
    """Labels of `robust` if its verdict calls the scene edited, else none."""
    finding = seeded(METHODS["robust"], observed.case.seed).estimate(observed.observation)
    return labelled(finding.labels & (finding.verdict is not None and finding.verdict > 0.5))


def without_3d(estimator: GSChecker) -> GSChecker:
    """GS-Checker without the 3D contrastive loss."""
    return dataclasses.replace(estimator, loop=dataclasses.replace(estimator.loop, gamma=0.0))


def _sa3d(observed: CaseObservation) -> Prediction:
    r = sa3d(observed.observation.evidence)
    return Prediction(score=r, labels=r > 0)


def _sa3d_own(observed: CaseObservation) -> Prediction:
    r = sa3d(observed.observation.evidence)
    return Prediction(score=r, labels=r > 0, feature=r, level=SA3D_LEVEL, absolute=True)


def _sa3d_gate(observed: CaseObservation) -> Prediction:
    r = _gated(observed.shared)[observed.regime]
    return Prediction(score=r, labels=r > 0)


def sa3d_gate_alone(observed: CaseObservation) -> Prediction:
    """SA3D with its gate, without the cache: for timing."""
    r = _gated.__wrapped__(observed.shared)[observed.regime]
    return Prediction(score=r, labels=r > 0)


@functools.lru_cache(maxsize=1)
def _gated(shared: AllRegimes) -> dict[str, np.ndarray]:
    """Scores of SA3D with its gate for all regimes at once, since it renders before every step."""
    observations = [observed.observation for observed in shared.by_regime.values()]
    masks = [list(observation.masks.values()) for observation in observations]

    def overlap(index: int, r: np.ndarray) -> np.ndarray:
        rendered = np.asarray(composite(shared.views[index], jnp.asarray(r.T)))
        pairs = [(rendered[..., k], own[index]) for k, own in enumerate(masks)]
        return np.array([confusion(*pair).iou for pair in pairs])

    tampered = np.stack([observation.evidence.tampered for observation in observations])
    evidence = Evidence(total=observations[0].evidence.total, tampered=tampered)
    return dict(zip(shared.by_regime, sa3d(evidence, overlap=overlap), strict=True))


def _flashsplat(observed: CaseObservation, *, gamma: float) -> Prediction:
    evidence = observed.observation.evidence
    total, tampered = (np.sum(part, axis=0) for part in (evidence.total, evidence.tampered))
    share = tampered / np.where(total > 0, total, 1)
    return Prediction(score=share, labels=flashsplat(evidence, gamma=gamma))


def _share_of_votes(observed: CaseObservation) -> np.ndarray:
    votes = observed.observation.votes
    cast = np.asarray(votes.tampered + votes.authentic)
    return np.asarray(votes.tampered) / np.maximum(cast, 1)


def _voted(rule: Callable[..., np.ndarray]) -> Method:
    def method(observed: CaseObservation) -> Prediction:
        return Prediction(score=_share_of_votes(observed), labels=rule(observed.observation.votes))

    return method


def sagd(observed: CaseObservation) -> Prediction:
    """SAGD with its boundary decomposition, applied view after view: too slow for every regime."""
    case, labels = observed.case, sagd_vote(observed.observation.votes)
    gaussians, masks = case.gaussians, observed.observation.masks
    for camera in case.scene.cameras if labels.any() else []:
        gaussians = sagd_boundary(gaussians, labels, camera, masks[camera.name])
    return Prediction(score=_share_of_votes(observed), labels=labels, gaussians=gaussians)


ALL_METHODS: Mapping[str, Method] = {
    "inverse projection": _voted(inverse_projection),
    "mode vote": _voted(mode_vote),
    "SAGD vote": _voted(sagd_vote),
    "SA3D": _sa3d,
    "SA3D, own rule": _sa3d_own,
    "SA3D, gate": _sa3d_gate,
    "FlashSplat": functools.partial(_flashsplat, gamma=0.0),
    "FlashSplat, gamma 0.4": functools.partial(_flashsplat, gamma=0.4),
    "GS-Checker official": predict_with(METHODS["official"]),
    "GS-Checker official, attribute": predict_with(METHODS["official"], own_rule=True),
    "GS-Checker official, no 3D loss": predict_with(without_3d(OFFICIAL)),
    "GS-Checker paper": predict_with(METHODS["paper"]),
    "robust": predict_with(METHODS["robust"]),
    "robust, rendered": predict_with(METHODS["robust"], own_rule=True),
}
"""Methods by their names in the tables, with masks rendered from labels unless the name says so."""
