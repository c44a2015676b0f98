"""GS-Checker (Han et al., AAAI 2026): vote, optimise, decide.

The paper leaves details open, and its released code differs from its equations. Both are
configurations of one estimator: which vote gives the initial attribute (eq. 5 and 6), which
attributes the 3D loss compares (eq. 7 and 8), the schedule (eq. 9 to 12), and the threshold.
"""

import dataclasses
from typing import Literal

import numpy as np

from gsc_jax.estimators.protocol import DISAGREEMENT, Estimator, Finding, Prior, unanimous
from gsc_jax.evidence.masks import MaskRule, normalise
from gsc_jax.evidence.observation import Observation
from gsc_jax.loop import LoopConfig, fit, fit_rendered, resolved, view_order
from gsc_jax.losses import official_attributes, paper_attributes, standardised_attributes
from gsc_jax.render.projection import NEAR
from gsc_jax.render.tiles import View, make_view
from gsc_jax.scene import Array
from gsc_jax.vote import official_consensus, paper_consensus

CONSENSUS = {"paper": paper_consensus, "official": official_consensus}
ATTRIBUTES = {
    "paper": paper_attributes,
    "official": official_attributes,
    "standardised": standardised_attributes,
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class GSChecker(Estimator):
    """GS-Checker; the defaults follow the equations of the paper.

    Attributes:
        name: Name of the method in results.
        consensus: How votes become the initial attribute.
        attributes: Attributes that the 3D loss compares.
        epochs: Number of optimisation steps per view.
        shuffle: Whether each epoch visits the views in a new order.
        loop: Weights and schedule of the optimisation.
        threshold: Score above which a Gaussian is labelled.
        mask_rule: How labels become the mask of a view.
        path: `evidence`, or `rendered`: render the attribute in every step (eq. 9), slower.
        near: Near plane in world units.
        seed: Seed of the order of the views.

    Raises:
        ValueError: if a value is not one of the options or out of its range.
    """

    name: str = "paper"
    consensus: Literal["paper", "official"] = "paper"
    attributes: Literal["paper", "official", "standardised"] = "paper"
    epochs: int = 5
    shuffle: bool = True
    loop: LoopConfig = dataclasses.field(default_factory=LoopConfig)
    threshold: float = 0.1
    mask_rule: MaskRule = "attribute"
    path: Literal["evidence", "rendered"] = "evidence"
    near: float = NEAR
    seed: int = 0

    def __post_init__(self) -> None:
        self.check_fields({"epochs": (1, 1000)})

    def for_views(self, views: int) -> "GSChecker":
        """Fill in the iteration at which the 3D loss joins."""
        return dataclasses.replace(self, loop=resolved(self.loop, self.epochs * views))

    def estimate(self, observation: Observation, prior: Prior | None = None) -> Finding:
        """Vote, optimise the attribute, normalise and threshold it.

        The prior is ignored, with a warning. Masks may be empty or full.
        """
        r = self.initial_attribute(observation)  # eq. 6, from the votes of eq. 5
        F = ATTRIBUTES[self.attributes](observation.gaussians)  # what eq. 7 compares
        attribute, group_sizes = self._optimise(observation, r, F)  # eq. 7 to 12
        evidence = observation.evidence
        finding = unanimous(evidence) or self._decide(attribute, group_sizes, evidence.seen)
        warnings = list(finding.warnings)
        if prior is not None:
            warnings.append(f"The prior was not used: {self.name} uses masks only.")
        optimised = {"attribute": attribute, "group_sizes": group_sizes}
        return dataclasses.replace(finding, **optimised, warnings=warnings)

    def initial_attribute(self, observation: Observation) -> np.ndarray:
        """Initial attribute of N Gaussians from the votes (eq. 6), shape (N,) float32.

        The vote ignores occlusion. Gaussians that no view sees get 0: without evidence the
        optimisation would never change their votes, and they would set the scale for all others.
        """
        seen = observation.evidence.seen
        return np.where(seen, CONSENSUS[self.consensus](observation.votes), np.float32(0))

    def _optimise(self, observation: Observation, r: Array, F: Array) -> tuple[np.ndarray, ...]:
        """Raw attribute (N,), and group sizes of all iterations."""
        cameras = observation.cameras
        order = view_order(len(cameras), epochs=self.epochs, shuffle=self.shuffle, seed=self.seed)

        def view_of(index: int) -> tuple[View, np.ndarray]:
            view = make_view(observation.gaussians, cameras[index], near=self.near)
            return view, observation.masks[cameras[index].name]

        if self.path == "evidence":
            r, infos = fit(observation.evidence, r, F, order, config=self.loop)
        else:
            r, infos = fit_rendered(view_of, r, F, order, config=self.loop)
        return np.asarray(r), np.asarray(infos.group_sizes)

    def _decide(self, attribute: np.ndarray, group_sizes: np.ndarray, seen: np.ndarray) -> Finding:
        """Normalise the attribute of the seen Gaussians and apply the threshold."""
        tamper = np.asarray(normalise(np.where(seen, attribute, 0.0)), np.float32)
        labels = tamper > self.threshold
        warnings = self._empty_groups(group_sizes) if labels.any() else [DISAGREEMENT]
        return Finding(tamper=tamper, labels=labels, attribute=attribute, warnings=warnings)

    def _empty_groups(self, group_sizes: np.ndarray) -> list[str]:
        """Warn if a group was empty, and the 3D loss therefore 0, in every iteration."""
        contrasted = group_sizes[resolved(self.loop, len(group_sizes)).contrastive_start :]
        if not len(contrasted) or contrasted.all(axis=1).any():
            return []
        empty = [f"G_{g}" for g, n in zip("hml", contrasted.max(axis=0), strict=True) if not n]
        return [
            "The 3D contrastive loss had no groups to compare "
            f"({', '.join(empty) or 'always one of them'} empty); the result uses the 2D loss only."
        ]


PAPER = GSChecker()
"""The equations of the paper, over five epochs."""
OFFICIAL = GSChecker(
    name="official",
    consensus="official",
    attributes="official",
    epochs=1,
    shuffle=False,
    loop=LoopConfig(per_feature=True),
    mask_rule="per-view",
)
"""The schedule and the definitions of the released code. Two things differ: centres are cut to the
pixel that contains them, where it rounds them, and Gaussians that no view sees start at 0, where it
keeps their votes. `experiments/departures.py` measures what each is worth."""
