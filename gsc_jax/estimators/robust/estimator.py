"""`robust`, the estimator beyond the paper, for masks of unknown reliability.

GS-Checker weights all that is outside the masks by the same lambda2 in every view; `robust` infers
the reliability of each mask from the same evidence:

1. latent classes: Gaussians with the same pattern of flagged views (`latent_classes`);
2. roles: authentic, tampered or distractor classes, and views that are inverted (`class_roles`);
3. the probability of each Gaussian, by how well its evidence agrees with each pattern, in the
   median of several fits, smoothed over its neighbours (`mean_field`);
4. fusion with a prior that does not come from masks (`prior_fusion`).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.special import expit

from gsc_jax.estimators.protocol import NONE_FLAGGED, Estimator, Finding, Prior, unanimous
from gsc_jax.estimators.robust import class_roles, diagnostics, gaussian_visibility, prior_fusion
from gsc_jax.estimators.robust.class_roles import Roles, assign_roles, scene_probability
from gsc_jax.estimators.robust.latent_classes import fit_classes, nearest_classes
from gsc_jax.estimators.robust.mean_field import smooth
from gsc_jax.estimators.robust.pattern_errors import (
    authentic_flag_share,
    error_weight,
    pattern_errors,
)
from gsc_jax.evidence.lifting import EvidenceOfViews
from gsc_jax.evidence.masks import MaskRule
from gsc_jax.evidence.observation import Observation
from gsc_jax.render.projection import NEAR
from gsc_jax.scene import Array
from gsc_jax.scene.parallel import blocks

RANGES: dict[str, tuple[float, float]] = {
    "sample": (1, 10**9),
    # The fits of all starts are kept: memory grows with their number, and that of the neighbours.
    **dict.fromkeys(("restarts", "neighbours"), (1, 1000)),
    **dict.fromkeys(("half_weight", "effective_pixels", "class_log_odds"), (1e-9, 1e9)),
    "smoothing": (0.0, 1e9),
    "covisibility": (0.0, 1.0),
}
"""Smallest and largest value of further numeric fields; whole numbers where the field is one."""
MIN_FLAGGED_SHARE = 0.6
"""Share of all flags from which a region is labelled, even if most masks miss it."""
TIE = 1e-3
"""Log odds against tampering where the views of a Gaussian do not tell classes apart."""
MAX_CLASSES = 100
"""Largest candidate number of classes; ten times what any scene of the tables has."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class RobustEstimator(Estimator):
    """Latent classes of Gaussians, with the reliability of every mask inferred.

    The defaults were chosen on seeds 10 and 11; the tables in docs/results.md use 0 to 2.

    Attributes:
        name: Name of the method in results.
        classes: Candidate numbers of latent classes.
        restarts: EM starts for each candidate; the better half of all fits decides.
        sample: Number of Gaussians for the classes and the weight of a flag.
        half_weight: Weight in pixels at which a view counts one half.
        covisibility: Share of the scene in a typical view below which parts of it have their own
            classes; 0 never divides it.
        effective_pixels: Number of independent pixels that a full view counts in EM.
        inversion: Whether masks may be inverted, if there is more than one.
        distractors: Whether authentic regions may be flagged consistently in some views.
        class_log_odds: Log odds between two classes from one full view that separates them.
        smoothing: Log odds from neighbours that are all tampered for sure; 0 disables smoothing.
        neighbours: Number of neighbours for smoothing.
        prior_weight: Weight of the prior, in [0, 1]; 0 ignores it, and below 0.5 it does not
            decide between regions that masks label.
        min_verdict: Nothing is labelled if the scene probability is lower, with and without prior,
            unless at least three masks flag what would be labelled, and little else.
        tolerance: With a network as detector, views are added until they change less than this
            share of the labelled weight; 0 uses all views.
        threshold: Probability above which a Gaussian is labelled.
        mask_rule: How labels become the mask of a view.
        near: Near plane in world units.
        seed: Seed of the EM starts.

    Raises:
        ValueError: if a value is out of its range.
    """

    name: str = "robust"
    classes: tuple[int, ...] = (4, 8)
    restarts: int = 8
    sample: int = 8192
    half_weight: float = 8.0
    covisibility: float = 0.45
    effective_pixels: float = 8.0
    inversion: bool = True
    distractors: bool = True
    class_log_odds: float = 3.0
    smoothing: float = 3.0
    neighbours: int = 8
    prior_weight: float = 1.0
    min_verdict: float = 0.06
    tolerance: float = 0.02
    threshold: float = 0.5
    mask_rule: MaskRule = "share"
    near: float = NEAR
    seed: int = 0

    def __post_init__(self) -> None:
        self.check_fields(RANGES)
        valid = isinstance(self.classes, tuple) and self.classes
        if not valid or not all(count in range(2, MAX_CLASSES + 1) for count in self.classes):
            raise ValueError(
                f"classes must be a tuple of integers from 2 to {MAX_CLASSES}, got {self.classes}"
            )

    def estimate(self, observation: Observation, prior: Prior | None = None) -> Finding:
        """Compute scores, labels, the scene probability and the reliability of every mask.

        The attribute of the finding is the log odds of the probability. A prior may label Gaussians
        that no view sees; one of another number of Gaussians raises ValueError.
        """
        return self.estimate_from_evidence(observation.evidence, observation.gaussians.means, prior)

    def estimate_from_evidence(
        self, evidence: EvidenceOfViews, means: Array, prior: Prior | None = None
    ) -> Finding:
        """As `estimate`, for evidence (V, N) and positions (N, D), of which a prior needs three."""
        prior = None if prior is None else prior.of(len(means))
        prior = prior if self.uses_prior else None
        trivial, views = unanimous(evidence), float(evidence.shape[0])
        if trivial and (prior is None or evidence.all_flagged):
            # Masks that cover everything tell no edit from the rest.
            verdict = 0.5 if evidence.all_flagged else scene_probability(0.0, views)
            if prior is not None:
                known, weight = trivial.labels, self.prior_weight
                verdict = prior_fusion.fuse(trivial.tamper, verdict, known, prior, weight)[1]
            return dataclasses.replace(trivial, verdict=verdict)
        lifted = self.from_masks(evidence, means, flagged=not trivial)
        agreed = lifted.probability > 0.5
        roles = lifted.roles if agreed.any() else None
        from_masks = roles.scene_probability if roles else scene_probability(0.0, views)
        probability, verdict, known, rank = lifted.probability, from_masks, lifted.seen, None
        if prior is not None:
            if roles and from_masks < prior_fusion.SURE and self.prior_weight >= 0.5:
                dropped = prior_fusion.refuted(roles.tampered, lifted.region, prior, means)
                roles = dataclasses.replace(roles, tampered=roles.tampered & ~dropped)
                from_masks = roles.scene_probability
                probability = np.where(dropped[lifted.region], np.float32(0), probability)
            if not prior.exact and from_masks >= prior_fusion.MIN_MASK_VERDICT:
                rank = prior_fusion.rank_in_scene(prior, probability > 0.5, means)
            both = prior_fusion.fuse(probability, from_masks, known, prior, self.prior_weight, rank)
            (probability, verdict), known = both, known | prior.known
        edited = lifted.distinct or max(verdict, from_masks) >= self.min_verdict
        labels = (probability > self.threshold) & edited
        return Finding(
            tamper=probability * edited,
            labels=labels,
            attribute=np.where(known, prior_fusion.log_odds_of(probability), 0).astype(np.float32),
            verdict=verdict,
            reliability=diagnostics.reliability(evidence, labels, lifted.roles),
            rank=rank,
            warnings=[NONE_FLAGGED + diagnostics.FROM_PRIOR * bool(labels.any())]
            if trivial
            else diagnostics.warnings(
                roles or lifted.roles, agreed, labels, (from_masks, verdict), prior
            ),
        )

    def from_masks(
        self, evidence: EvidenceOfViews, means: Array, *, flagged: bool = True
    ) -> "MaskEstimate":
        """Estimate the probability of each Gaussian from the masks alone.

        The positions (N, D) only serve to find neighbours and parts of the scene. If no mask covers
        anything, not `flagged`, all probabilities are 0. They are deterministic, and finite for any
        evidence.
        """
        sums = gaussian_visibility.summed_visibility(evidence, self.half_weight)
        seen = sums[0] > 0
        nothing = MaskEstimate(np.zeros(len(seen), np.float32), seen, np.zeros(len(seen), np.int32))
        if not (flagged and seen.any()):
            return nothing
        rows, represents = gaussian_visibility.stratified_sample(sums[0], sums[1], self.sample)
        sample = *gaussian_visibility.visibility(evidence, rows, self.half_weight), represents
        covisible, places = gaussian_visibility.covisible_parts, np.asarray(means)[rows]
        parts = covisible(sample[0], represents, places, self.covisibility)
        if not (fits := self._roles_by_fit(*sample, parts)):
            return nothing
        # The criteria of several fits are nearly equal: rounding would choose the best one.
        by_fit, nearest = self._log_odds(evidence, fits, sample)
        median = np.median(by_fit, axis=0)
        agreeing = np.argmin(np.sum(((by_fit > 0) != (median > 0))[:, seen], axis=1))
        median = smooth(median, means, seen, strength=self.smoothing, neighbours=self.neighbours)
        probability = np.where(seen, expit(median), 0.0).astype(np.float32)
        region, roles = np.where(probability > 0.5, *nearest[agreeing]), fits[agreeing]
        shown, flags, represents = sample
        flags = np.where(roles.inverted[:, None], shown - flags, flags).sum(axis=0) * represents
        several = roles.patterns[roles.tampered].any(axis=0).sum() >= class_roles.MIN_MASKS
        distinct = several and flags @ (probability[rows] > 0.5) > MIN_FLAGGED_SHARE * flags.sum()
        return MaskEstimate(probability, seen, region, roles, bool(distinct))

    def _roles_by_fit(
        self,
        seen: np.ndarray,
        flagged: np.ndarray,
        represents: np.ndarray,
        parts: Sequence[np.ndarray],
    ) -> list[Roles]:
        """Roles of the classes in the better half, an odd number, of EM fits to a sample.

        Given their `visibility` (V, S), how many each represents (S,), and the rows of each part.
        """
        by_part = [self._classes_by_fit(seen[:, p], flagged[:, p], represents[p]) for p in parts]
        fits = []
        for classes in zip(*by_part, strict=True):
            rates, weights = map(np.concatenate, zip(*classes, strict=True))
            fits.append(
                assign_roles(
                    rates,
                    weights,
                    np.repeat(np.arange(len(parts)), [len(own) for own, _ in classes]),
                    inversion=self.inversion and len(seen) > 1,  # one alone differs from no other
                    distractors=self.distractors,
                )
            )
        fits = [roles for roles in fits if roles is not None]  # those of one class have no edit
        return fits[: len(fits) // 2 | 1]

    def _classes_by_fit(
        self, seen: np.ndarray, flagged: np.ndarray, represents: np.ndarray
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Flag rates of classes, and their weight by view, both (K, V), by fit, best first."""
        fit = fit_classes(
            self.effective_pixels * flagged,
            self.effective_pixels * (seen - flagged),
            counts=self.classes,
            restarts=self.restarts,
            seed=self.seed,
        )
        found, fitted = [], (fit.classes.rates, fit.classes.shares, fit.responsibilities)
        for rates, shares, members in zip(*map(np.asarray, fitted), strict=True):
            classes, nearest = nearest_classes(members, shares, represents)
            found.append((rates[classes], (nearest * represents) @ seen.T))
        return found

    def _log_odds(
        self, evidence: EvidenceOfViews, fits: Sequence[Roles], sample: tuple[np.ndarray, ...]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Log odds of tampering by F fits, (F, N); nearest tampered and other class, (F, 2, N)."""
        shares = [(authentic_flag_share(roles, *sample), roles.missed) for roles in fits]
        weights = [[error_weight(self.class_log_odds, one) for one in both] for both in shares]
        log_odds = np.empty((len(fits), evidence.shape[1]), np.float32)
        nearest = np.empty((len(fits), 2, evidence.shape[1]), np.int32)
        # In blocks: arrays of all Gaussians, views and classes would take gigabytes.
        for block in blocks(evidence.shape[1], gaussian_visibility.BLOCK):
            seen, flagged = gaussian_visibility.visibility(evidence, block, self.half_weight)
            for i, roles in enumerate(fits):
                errors = pattern_errors(roles, seen, flagged)
                costs = weights[i][0] * errors[0] + weights[i][1] * errors[1]
                # Only the nearest class of each kind counts: similar distractors must not add up.
                kinds = [np.flatnonzero(kind) for kind in (roles.tampered, ~roles.tampered)]
                best = np.stack([kind[costs[kind].argmin(axis=0)] for kind in kinds])
                tampered, other = np.take_along_axis(costs, best, axis=0)
                log_odds[i, block], nearest[i, :, block] = other - tampered - TIE, best
        return log_odds, nearest


@dataclasses.dataclass(frozen=True)
class MaskEstimate:
    """Estimate from the masks alone.

    Attributes:
        probability: Probability of tampering, given an edit, shape (N,) float32; 0 if unseen.
        seen: Mask of the Gaussians visible in at least one view, shape (N,) bool.
        region: Nearest class of the roles, a tampered one where labelled, shape (N,) int32.
        roles: Roles by the fit whose labels agree best; None if every fit has one class only.
        distinct: Whether at least three masks flag what would be labelled, and little else.
    """

    probability: np.ndarray
    seen: np.ndarray
    region: np.ndarray
    roles: Roles | None = None
    distinct: bool = False
