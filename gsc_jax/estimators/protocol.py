"""The interface of an estimator: evidence and a prior in, scores and labels out."""

import abc
import dataclasses
import typing
from collections.abc import Mapping
from typing import Any, ClassVar, Literal, Self

import numpy as np

from gsc_jax.evidence.lifting import EvidenceOfViews
from gsc_jax.evidence.masks import MaskRule
from gsc_jax.evidence.observation import Observation
from gsc_jax.scene.errors import BELOW_1, check_ranges, in_range
from gsc_jax.scene.pytree import short_repr

Reliability = Literal["reliable", "uninformative", "inverted", "unseen"]
"""Reliability of a mask: it flags most of the labelled Gaussians in the view, it does not, it flags
everything else, or the view does not show them."""
Outcome = Literal["evidence", "inconclusive", "none"]
"""What a scene probability says: there is evidence of editing, it does not decide, or none."""
EVIDENCE_FROM, NONE_BELOW = 0.65, 0.35
"""Scene probabilities from which there is evidence, about 2 to 1 odds, and below which none."""
DISAGREEMENT = "Pixels were flagged, but the views agree on no tampered Gaussian."
"""Warning of an estimator that labels nothing although masks are not empty."""
RANGES: Mapping[str, tuple[float, float]] = {
    "seed": (0, 2**32 - 1),  # the largest that both NumPy and JAX accept
    "near": (1e-9, 1e9),
    **dict.fromkeys(("threshold", "tolerance", "min_verdict"), (0.0, BELOW_1)),
    "prior_weight": (0.0, 1.0),
}
"""Smallest and largest value of the fields that every estimator has; whole numbers for integers."""
NONE_FLAGGED = "All masks are empty: no probability is above 0.5."
ALL_FLAGGED = "The masks cover everything in every view."


def outcome(verdict: float | None) -> Outcome | None:
    """What a scene probability says; None if there is none."""
    if verdict is None:
        return None
    if verdict >= EVIDENCE_FROM:
        return "evidence"
    return "none" if verdict < NONE_BELOW else "inconclusive"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Prior:
    """Probability of tampering per Gaussian that does not come from masks.

    Attributes:
        probability: Probability that a Gaussian is tampered, given that the scene was edited, shape
            (N,) in [0, 1]; needs a value also where `known` is false.
        verdict: Probability that the scene was edited.
        known: Gaussians for which the probability means something, shape (N,) bool.
        exact: Whether the prior identifies the tampered Gaussians exactly; it then keeps half of
            the weight even where masks agree.

    Raises:
        ValueError: if a value is outside its range or a shape differs.
    """

    probability: np.ndarray
    verdict: float
    known: np.ndarray
    exact: bool = False

    def __post_init__(self) -> None:
        """Check types, ranges and shapes: one NaN would spread to every Gaussian."""
        for name in ("probability", "known"):
            if not isinstance(value := getattr(self, name), np.ndarray):
                raise ValueError(f"{name} must be a NumPy array, got {type(value).__name__}")
        if self.probability.ndim != 1:
            raise ValueError(f"probability must have shape (N,), got {self.probability.shape}")
        if not in_range(self.verdict, 0.0, 1.0):
            raise ValueError(f"verdict must be in [0, 1], got {self.verdict!r}")
        within = (self.probability >= 0) & (self.probability <= 1)
        if not within.all():
            found = f"{self.probability[~within][0]} in row {np.argmin(within)}"
            raise ValueError(f"probability must be in [0, 1], got {found}")
        if self.known.dtype != bool or self.known.shape != self.probability.shape:
            raise ValueError(
                f"known must be bool and of shape {self.probability.shape} like probability, got "
                f"{self.known.dtype} {self.known.shape}"
            )

    def of(self, count: int) -> Self:
        """The prior itself; ValueError unless it is one of `count` Gaussians."""
        if len(self.known) != count:
            raise ValueError(f"the prior has {len(self.known)} Gaussians, the scene {count}")
        return self


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Finding:
    """Scores and labels of N Gaussians.

    Attributes:
        tamper: Score in [0, 1], shape (N,) float32; 0 for Gaussians without any evidence. For
            `robust`, the probability of tampering, given that the scene was edited.
        labels: Gaussians whose score is above the threshold, shape (N,) bool.
        attribute: Raw attribute r, shape (N,) float32, unbounded; log odds for `robust`.
        group_sizes: Sizes of G_h, G_m and G_l in every iteration, shape (iterations, 3).
        verdict: Scene probability: that anything was edited; None if the estimator gives none.
        reliability: Reliability of each mask, in the order of the cameras; empty if not inferred.
        rank: Share of the other parts of the scene that stand out more in the prior than what the
            masks label; None where it was not asked.
        warnings: Sentences for the user.

    Raises:
        ValueError: if a score or an attribute is not finite.
    """

    tamper: np.ndarray
    labels: np.ndarray
    attribute: np.ndarray
    group_sizes: np.ndarray = dataclasses.field(default_factory=lambda: np.zeros((0, 3), np.int32))
    verdict: float | None = None
    reliability: tuple[Reliability, ...] = ()
    rank: float | None = None
    warnings: list[str]

    __repr__ = short_repr

    def __post_init__(self) -> None:
        """Refuse NaN: a comparison with it would silently label nothing."""
        if not (np.isfinite(self.tamper).all() and np.isfinite(self.attribute).all()):
            raise ValueError("scores are not finite; are evidence, prior and weights finite?")


class Estimator(abc.ABC):
    """Interface of estimators: frozen dataclasses whose fields are their configuration.

    `RobustEstimator` documents the fields that all have; those with a value here may be left out.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]
    name: str
    threshold: float
    mask_rule: MaskRule
    near: float
    seed: int
    tolerance: float = 0.0
    min_verdict: float = 0.0
    prior_weight: float = 0.0

    @property
    def uses_prior(self) -> bool:
        """Whether a prior changes the finding."""
        return self.prior_weight > 0

    @abc.abstractmethod
    def estimate(self, observation: Observation, prior: Prior | None = None) -> Finding:
        """Compute scores and labels from V views of N Gaussians; deterministic for given fields."""

    def for_views(self, views: int) -> Self:  # noqa: ARG002
        """The estimator with defaults that depend on the number of views filled in."""
        return self

    def check_fields(self, ranges: Mapping[str, tuple[float, float]]) -> None:
        """Raise ValueError for an unknown `Literal` or switch, or a number out of its range."""
        for name, hint in typing.get_type_hints(type(self)).items():
            known, own = typing.get_args(hint) or (True, False), getattr(self, name)
            if (hint is bool or typing.get_origin(hint) is Literal) and own not in known:
                raise ValueError(f"{name} must be one of {', '.join(map(str, known))}, got {own!r}")
        check_ranges(self, {**RANGES, **ranges})


def unanimous(evidence: EvidenceOfViews) -> Finding | None:
    """Finding if all masks are empty (no labels) or full (all seen are labelled), else None."""
    seen = evidence.seen
    if evidence.none_flagged:
        labels, warning = np.zeros(len(seen), bool), NONE_FLAGGED
    elif evidence.all_flagged:
        labels, warning = seen, ALL_FLAGGED
    else:
        return None
    tamper, attribute = labels.astype(np.float32), np.zeros(len(seen), np.float32)
    return Finding(tamper=tamper, labels=labels, attribute=attribute, warnings=[warning])
