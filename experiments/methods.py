"""Every method of the tables as a function of a look: the baselines, GS-Checker, and `robust`."""

import dataclasses
import functools
from collections.abc import Callable, Mapping

import jax.numpy as jnp
import numpy as np
from baselines import (
    SA3D_LEVEL,
    flashsplat,
    inverse,
    mode_vote,
    sa3d,
    sagd_boundary,
    sagd_vote,
)
from looks import Answer, Look, Method, Shared

from gsc_jax.benchmark.metrics import (
    iou,
)
from gsc_jax.estimators.gschecker import METHODS, Config, MethodConfig, find
from gsc_jax.estimators.robust.estimator import RobustConfig
from gsc_jax.evidence.lifting import Evidence
from gsc_jax.splat import composite


def labelled(labels: np.ndarray) -> Answer:
    """The answer of a method that only labels."""
    labels = np.asarray(labels)
    return Answer(score=labels.astype(np.float32), labels=labels)


def checker(config: Config, *, own_rule: bool = False) -> Method:
    """A method of ours under a configuration; judged by labels, or by the score that it renders."""

    def method(look: Look) -> Answer:
        seeded = dataclasses.replace(config, seed=look.case.seed)
        found = find(look.case.gaussians, look.case.scene.cameras, look.observation, seeded)
        rendered = {"feature": found.tamper, "level": config.threshold} if own_rule else {}
        return Answer(score=found.attribute, labels=found.labels, **rendered)

    return method


def if_called_tampered(look: Look) -> Answer:
    """`robust`, believed only where its verdict is that something was tampered with."""
    case, config = look.case, RobustConfig(seed=look.case.seed)
    found = find(case.gaussians, case.scene.cameras, look.observation, config)
    return labelled(found.labels & (found.verdict is not None and found.verdict > 0.5))


def without_3d(config: MethodConfig) -> MethodConfig:
    """The configuration with no 3D contrastive loss."""
    return dataclasses.replace(config, loop=dataclasses.replace(config.loop, gamma=0.0))


def _sa3d(look: Look) -> Answer:
    r = sa3d(look.observation.evidence)
    return Answer(score=r, labels=r > 0)


def _sa3d_own(look: Look) -> Answer:
    r = sa3d(look.observation.evidence)
    return Answer(score=r, labels=r > 0, feature=r, level=SA3D_LEVEL, absolute=True)


def _sa3d_gate(look: Look) -> Answer:
    r = _gated(look.shared)[look.regime]
    return Answer(score=r, labels=r > 0)


def sa3d_gate_alone(look: Look) -> Answer:
    """SA3D with its gate, nothing remembered: what it costs by itself."""
    r = _gated.__wrapped__(look.shared)[look.regime]
    return Answer(score=r, labels=r > 0)


@functools.lru_cache(maxsize=1)
def _gated(shared: Shared) -> dict[str, np.ndarray]:
    """Scores of SA3D with its gate, all regimes at once: it renders before every step."""
    observations = [look.observation for look in shared.looks.values()]
    masks = [list(observation.masks.values()) for observation in observations]

    def overlap(index: int, r: np.ndarray) -> np.ndarray:
        rendered = np.asarray(composite(shared.views[index], jnp.asarray(r.T)))
        return np.array([iou(rendered[..., k], own[index]) for k, own in enumerate(masks)])

    tampered = np.stack([observation.evidence.tampered for observation in observations])
    evidence = Evidence(total=observations[0].evidence.total, tampered=tampered)
    return dict(zip(shared.looks, sa3d(evidence, overlap=overlap), strict=True))


def _flashsplat(look: Look, *, gamma: float) -> Answer:
    evidence = look.observation.evidence
    total, tampered = (np.sum(part, axis=0) for part in (evidence.total, evidence.tampered))
    share = tampered / np.where(total > 0, total, 1)
    return Answer(score=share, labels=flashsplat(evidence, gamma=gamma))


def _share_of_votes(look: Look) -> np.ndarray:
    votes = look.observation.votes
    cast = np.asarray(votes.tampered + votes.authentic)
    return np.asarray(votes.tampered) / np.maximum(cast, 1)


def _voted(rule: Callable[..., np.ndarray]) -> Method:
    def method(look: Look) -> Answer:
        return Answer(score=_share_of_votes(look), labels=rule(look.observation.votes))

    return method


def sagd(look: Look) -> Answer:
    """SAGD with its boundary decomposition, folded over the views: too slow for every regime."""
    case, labels = look.case, sagd_vote(look.observation.votes)
    gaussians, masks = case.gaussians, look.observation.masks
    for camera in case.scene.cameras if labels.any() else []:
        gaussians = sagd_boundary(gaussians, labels, camera, masks[camera.name])
    return Answer(score=_share_of_votes(look), labels=labels, gaussians=gaussians)


ALL_METHODS: Mapping[str, Method] = {
    "inverse projection": _voted(inverse),
    "mode vote": _voted(mode_vote),
    "SAGD vote": _voted(sagd_vote),
    "SA3D": _sa3d,
    "SA3D, own rule": _sa3d_own,
    "SA3D, gate": _sa3d_gate,
    "FlashSplat": functools.partial(_flashsplat, gamma=0.0),
    "FlashSplat, gamma 0.4": functools.partial(_flashsplat, gamma=0.4),
    "GS-Checker official": checker(METHODS["official"]),
    "GS-Checker official, own rule": checker(METHODS["official"], own_rule=True),
    "GS-Checker official, no 3D loss": checker(without_3d(METHODS["official"])),
    "GS-Checker paper": checker(METHODS["paper"]),
    "robust": checker(RobustConfig()),
    "robust, rendered": checker(RobustConfig(), own_rule=True),
}
"""Every method of the tables, judged by its labels; by what it renders itself where it says so."""
