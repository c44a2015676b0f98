"""The estimator beyond the paper: which Gaussians are tampered, when masks cannot be trusted.

It starts from the same evidence as GS-Checker and asks of every view what its mask is worth. To
which class a Gaussian belongs is decided by how well the pattern of the class, flagged or not in
each view, agrees with what the views say of the Gaussian; its neighbours have a say where they do
not. The result is a probability. Where the paper's optimisation asks a price lambda2 for the weight
outside the masks, the same for all views, here the views in which the tampered class was missed
say nothing about it, inverted ones are turned, and what is flagged only from some sides is a rival.
"""

import dataclasses
import math
import typing
from collections.abc import Iterator

import numpy as np

from gsc_jax.estimators.protocol import NOTHING, Finding, undisputed
from gsc_jax.estimators.robust.class_roles import Roles, assign_roles, verdict
from gsc_jax.estimators.robust.diagnostics import OWN, doubts, reliability_of
from gsc_jax.estimators.robust.latent_classes import Fit, fit_classes
from gsc_jax.estimators.robust.mean_field import smoothed
from gsc_jax.estimators.robust.prior_fusion import Prior, fused, log_odds_of
from gsc_jax.evidence.lifting import Evidence
from gsc_jax.evidence.masks import MaskRule
from gsc_jax.render.projection import NEAR
from gsc_jax.scene import Array

BLOCK = 2**15
"""Gaussians whose evidence is worked on at once."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobustConfig:
    """What the estimator leaves to choose; tuned on other seeds than the tables (docs/results.md).

    Attributes:
        name: What the method is called in results.
        classes: Numbers of latent classes to choose from.
        restarts: Starts of EM for each of them.
        sample: Gaussians that the classes are fitted to.
        trust: Weight in pixels at which a view is worth half a look.
        pixels: Independent pixels that a whole look is worth to EM.
        inversion: Whether masks may be inverted.
        rivals: Whether something authentic may be flagged consistently.
        certainty: Log odds of a class against another after a view that tells them apart.
        smoothing: Log odds that neighbours of one mind add; 0 asks none.
        neighbours: How many are asked.
        native: Weight in [0, 1] of what the Gaussians themselves say (`native.py`), where that is
            given.
        doubt: Nothing is labelled where the verdict on the scene is less likely than this.
        tolerance: `locate` looks from no more cameras once further views change less than this
            share of what is labelled; 0 looks from all.
        threshold: Probability above which a Gaussian is tampered.
        mask_rule: How labels become masks.
        near: Near plane in world units.
        seed: Of the starts.
    """

    name: str = "robust"
    classes: tuple[int, ...] = (4, 8)
    restarts: int = 2
    sample: int = 8192
    trust: float = 8.0
    pixels: float = 8.0
    inversion: bool = True
    rivals: bool = True
    certainty: float = 3.0
    smoothing: float = 5.0
    neighbours: int = 8
    native: float = 1.0
    doubt: float = 0.06
    tolerance: float = 0.02
    threshold: float = 0.5
    mask_rule: MaskRule = "share"
    near: float = NEAR
    seed: int = 0

    def __post_init__(self) -> None:
        """Refuse what the estimator does not understand."""
        if self.mask_rule not in typing.get_args(MaskRule):
            known = ", ".join(typing.get_args(MaskRule))
            raise ValueError(f"mask_rule must be one of {known}, got {self.mask_rule!r}")
        if not isinstance(self.classes, tuple) or not self.classes or min(self.classes) < 2:
            raise ValueError(
                f"classes must be a tuple of numbers of at least 2, got {self.classes}"
            )
        for name in ("restarts", "sample", "neighbours"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name} must be at least 1, got {getattr(self, name)}")
        for name in ("trust", "pixels", "certainty", "near"):
            if not 0 < getattr(self, name) < math.inf:
                raise ValueError(f"{name} must be above 0, got {getattr(self, name)}")
        if not 0 <= self.smoothing < math.inf:
            raise ValueError(f"smoothing must be 0 or more, got {self.smoothing}")
        if not 0 <= self.native <= 1:
            raise ValueError(f"native must be in [0, 1], got {self.native}")
        for name in ("doubt", "tolerance", "threshold"):
            if not 0 <= getattr(self, name) < 1:
                raise ValueError(f"{name} must be in [0, 1), got {getattr(self, name)}")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Estimate:
    """What the estimator makes of the evidence.

    Attributes:
        probability: That a Gaussian is tampered, if anything is, shape (N,) float32; 0 where
            nothing was seen.
        seen: Gaussians that any view saw, shape (N,) bool.
        roles: What the classes are; None where there is only one.
        classes: How many the data asked for.
        iterations: Of EM, until the likelihood no longer rose, from the start that took longest.
    """

    probability: np.ndarray
    seen: np.ndarray
    roles: Roles | None
    classes: int
    iterations: int

    @property
    def agreed(self) -> np.ndarray:
        """Gaussians that the masks agree on, shape (N,) bool."""
        return self.probability > 0.5


def find_robust(
    evidence: Evidence, means: Array, config: RobustConfig, prior: Prior | None = None
) -> Finding:
    """What the estimator finds, with a verdict on the scene and on every view.

    Args:
        evidence: What V views say of N Gaussians, shapes (V, N).
        means: Their centres, shape (N, 3); any unit.
        config: Of the estimator.
        prior: What is known of the N Gaussians without the masks; it may name what no view sees.

    Returns:
        The finding; its attribute is the log odds of the probability.

    Raises:
        ValueError: if the prior speaks of another number of Gaussians.
    """
    prior = prior if config.native > 0 else None
    clear, views = undisputed(evidence), float(np.shape(evidence.total)[0])
    if clear and (prior is None or evidence.says_everything):
        return dataclasses.replace(clear, verdict=verdict(float(clear.labels.any()), views))
    found = _nothing(evidence.seen) if clear else estimate(evidence, means, config)
    probability, known = found.probability, found.seen
    # What no Gaussian is found in speaks for nothing, however often it was flagged.
    lifted = found.roles if found.agreed.any() else None
    certain = shown = verdict(lifted.rate, lifted.views) if lifted else verdict(0.0, views)
    if prior is not None:
        probability, certain = fused(probability, shown, found.seen, prior, config.native)
        known = found.seen | prior.known
    believed = certain >= config.doubt
    labels = (probability > config.threshold) & believed
    worth = ()
    if found.roles and labels.any():
        worth = reliability_of(evidence, labels, found.roles.inverted)
    said = doubts(found.agreed, found.roles, labels, (shown, certain), prior)
    if clear:
        said = [NOTHING + OWN * bool(labels.any())]
    return Finding(
        attribute=np.where(known, log_odds_of(probability), 0.0).astype(np.float32),
        tamper=probability * believed,
        labels=labels,
        group_sizes=np.zeros((0, 3), np.int32),
        verdict=certain,
        reliability=worth,
        warnings=said,
    )


def _nothing(seen: np.ndarray) -> Estimate:
    """What there is to say where no view flags anything."""
    nothing = np.zeros(len(seen), np.float32)
    return Estimate(probability=nothing, seen=seen, roles=None, classes=0, iterations=0)


def estimate(evidence: Evidence, means: Array, config: RobustConfig) -> Estimate:
    """The probability of each Gaussian to be tampered.

    Args:
        evidence: What V views say of N Gaussians, shapes (V, N).
        means: Their centres, shape (N, 3); any unit.
        config: Of the estimator.

    Returns:
        The estimate; deterministic, and finite for any evidence.
    """
    looks, flags = _totals(evidence, config.trust)
    seen = looks > 0
    nothing = np.zeros(len(seen), np.float32)
    if not seen.any():
        return Estimate(probability=nothing, seen=seen, roles=None, classes=0, iterations=0)
    roles, fit = _classify(evidence, _sample(looks, flags, config.sample), config)
    found = Estimate(
        probability=nothing,
        seen=seen,
        roles=roles,
        classes=int(np.sum(np.asarray(fit.classes.shares) > 0)),
        iterations=int(np.max(fit.iterations)),
    )
    if roles is None:
        return found
    logits = -config.certainty * disagreement(evidence, roles, config.trust)
    belief = smoothed(
        logits,
        roles.tampered,
        means,
        seen,
        strength=config.smoothing,
        neighbours=config.neighbours,
    )
    # The best of each kind: many rivals that hardly differ must not outvote one tampered class.
    tampered, other = (belief[:, kind].max(axis=1) for kind in (roles.tampered, ~roles.tampered))
    probability = np.where(seen, tampered / (tampered + other), 0.0).astype(np.float32)
    return dataclasses.replace(found, probability=probability)


def _classify(
    evidence: Evidence,
    sample: tuple[np.ndarray, np.ndarray],
    config: RobustConfig,
) -> tuple[Roles | None, Fit]:
    """The classes of a sample of Gaussians, and what they are."""
    chosen, worth = sample
    looked, flagged = looks_of(evidence, chosen, config.trust)
    fit = fit_classes(
        config.pixels * flagged,
        config.pixels * (looked - flagged),
        counts=config.classes,
        restarts=config.restarts,
        seed=config.seed,
    )
    used = np.asarray(fit.classes.shares) > 0
    members = np.asarray(fit.belongs)[used] * worth
    return assign_roles(
        np.asarray(fit.classes.rates)[used],
        members @ looked.T,
        inversion=config.inversion,
        rivals=config.rivals,
    ), fit


def disagreement(evidence: Evidence, roles: Roles, trust: float) -> np.ndarray:
    """Number of looks in which a Gaussian is not what the pattern of a class says.

    Args:
        evidence: What V views say of N Gaussians, shapes (V, N).
        roles: The patterns of C classes.
        trust: Weight in pixels at which a view is worth half a look.

    Returns:
        Looks, at most V, shape (N, C) float32.
    """
    turned = roles.inverted[:, None]
    patterns = roles.patterns.astype(np.float32)
    found = np.empty((np.shape(evidence.total)[-1], len(patterns)), np.float32)
    for block in _blocks(len(found)):
        looked, flagged = looks_of(evidence, block, trust)
        flagged = np.where(turned, looked - flagged, flagged)
        found[block] = (looked - 2 * flagged).T @ patterns.T + flagged.sum(axis=0)[:, None]
    return found


def _blocks(count: int) -> Iterator[slice]:
    return (slice(start, start + BLOCK) for start in range(0, count, BLOCK))


def looks_of(
    evidence: Evidence, some: np.ndarray | slice, trust: float
) -> tuple[np.ndarray, np.ndarray]:
    """What each view saw of some Gaussians, in looks, and how much of it was flagged, (V, M)."""
    total = np.asarray(evidence.total)[:, some]
    tampered = np.asarray(evidence.tampered)[:, some]
    scale = 1.0 / (total + np.float32(trust))
    return total * scale, tampered * scale


def _totals(evidence: Evidence, trust: float) -> tuple[np.ndarray, np.ndarray]:
    """Looks at each Gaussian over all views, and flagged ones, shapes (N,)."""
    count = np.shape(evidence.total)[-1]
    sums = [
        [part.sum(axis=0) for part in looks_of(evidence, block, trust)] for block in _blocks(count)
    ]
    looks, flags = (np.concatenate(parts) for parts in zip(*sums, strict=True))
    return looks, flags


def _sample(looks: np.ndarray, flags: np.ndarray, size: int) -> tuple[np.ndarray, np.ndarray]:
    """Gaussians to fit to, half of them for being flagged, and how many each one stands for.

    Sampled at equal distances along the Gaussians in the order of how often they are flagged: no
    chance is involved, and their order in the file does not matter.
    """
    size = min(size, int(np.count_nonzero(looks)))
    share = flags / np.maximum(looks, 1e-30)
    visible = np.minimum(looks, 1.0)
    suspicious = visible * share
    wanted = visible / visible.sum() + suspicious / max(suspicious.sum(), 1e-30)
    order = np.argsort(share, kind="stable")
    along = np.cumsum(wanted[order], dtype=np.float64)
    steps = (np.arange(size) + 0.5) / size * along[-1]
    chosen = order[np.minimum(np.searchsorted(along, steps), len(order) - 1)]
    return chosen, 1.0 / wanted[chosen]
