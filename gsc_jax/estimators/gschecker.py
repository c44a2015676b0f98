"""The methods: from what was observed to a score and a label per Gaussian.

`robust` is the estimator of `gsc_jax.estimators.robust.estimator`. GS-Checker is a configuration: which vote gives the
initial attribute (eq. 5 and 6), which attributes the 3D loss compares (eq. 7 and 8), the schedule
of the optimisation (eq. 10 to 12), the threshold.
"""

import dataclasses
import functools
import threading
import typing
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Literal

import numpy as np

from gsc_jax.estimators.protocol import DISAGREE, Finding, undisputed
from gsc_jax.estimators.robust.estimator import RobustConfig, find_robust
from gsc_jax.estimators.robust.prior_fusion import Prior
from gsc_jax.evidence.lifting import Evidence
from gsc_jax.evidence.masks import MaskRule, normalise
from gsc_jax.evidence.observation import Observation
from gsc_jax.loop import LoopConfig, fit, fit_rendered, resolved, view_order
from gsc_jax.losses import official_attributes, paper_attributes, standardised_attributes
from gsc_jax.render.projection import NEAR
from gsc_jax.render.tiles import View, make_view
from gsc_jax.scene import Array, Camera, Gaussians
from gsc_jax.scene.parallel import WORKERS, ahead
from gsc_jax.vote import official_consensus, paper_consensus

Method = Literal["robust", "paper", "official"]

CONSENSUS = {"paper": paper_consensus, "official": official_consensus}
ATTRIBUTES = {
    "paper": paper_attributes,
    "official": official_attributes,
    "standardised": standardised_attributes,
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class MethodConfig:
    """All that GS-Checker leaves to choose.

    Attributes:
        name: What the method is called in results.
        consensus: How votes become the initial attribute.
        attributes: What the 3D loss compares.
        epochs: How often the optimisation looks at each view.
        shuffle: Draw a new order of the views for each epoch.
        loop: Weights and schedule of the optimisation.
        threshold: Normalised attribute above which a Gaussian is tampered.
        mask_rule: How labels become masks.
        path: `evidence`, or `rendered`: the definition, slower, for comparison.
        near: Near plane in world units.
        seed: Of the order of the views.
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
        """Refuse what no method understands."""
        for option, known in (
            ("consensus", tuple(CONSENSUS)),
            ("attributes", tuple(ATTRIBUTES)),
            ("mask_rule", typing.get_args(MaskRule)),
            ("path", ("evidence", "rendered")),
        ):
            if getattr(self, option) not in known:
                found = getattr(self, option)
                raise ValueError(f"{option} must be one of {', '.join(known)}, got {found!r}")
        if not (self.epochs >= 1 and 0 <= self.threshold < 1 and self.near > 0):
            raise ValueError(
                "expected epochs >= 1, 0 <= threshold < 1 and near > 0, got "
                f"{self.epochs}, {self.threshold} and {self.near}"
            )


METHODS: Mapping[str, MethodConfig] = {
    "paper": MethodConfig(),
    "official": MethodConfig(
        name="official",
        consensus="official",
        attributes="official",
        epochs=1,
        shuffle=False,
        loop=LoopConfig(per_feature=True),
    ),
}
"""The paper's equations over several epochs, and the schedule and definitions of its code."""

Config = MethodConfig | RobustConfig
CONFIGS: Mapping[str, Config] = {"robust": RobustConfig(), **METHODS}
"""Every method as it is by default."""


def settled(config: Config, views: int) -> Config:
    """The configuration with what it leaves to the number of views filled in."""
    if isinstance(config, RobustConfig):
        return config
    loop = resolved(config.loop, config.epochs * views)
    return dataclasses.replace(config, loop=loop)


def find(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    observation: Observation,
    config: Config,
    prior: Prior | None = None,
) -> Finding:
    """From what was observed to the tampered Gaussians: by voting and optimising, or `robust`.

    Args:
        gaussians: N Gaussians.
        cameras: The cameras of the observation, in its order.
        observation: What they saw, from `observe`.
        config: Of the method.
        prior: What is known without the masks; only `robust` has a use for it, and the
            warnings of the others say so.

    Returns:
        The finding. Where the attribute can say nothing, because no mask or every mask is full, it
        is defined and says so.
    """
    finding = _find(Given(gaussians, cameras, observation, prior), config)
    if prior is None or isinstance(config, RobustConfig):
        return finding
    unused = f"What is known without the masks was not used: {config.name} goes by them alone."
    return dataclasses.replace(finding, warnings=[*finding.warnings, unused])


def sweep(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    observation: Observation,
    configs: Iterable[Config],
) -> Iterator[Finding]:
    """`find` under many configurations; what does not depend on them is computed once.

    Args:
        gaussians: N Gaussians.
        cameras: The cameras of the observation, in its order.
        observation: What they saw, from `observe`.
        configs: Of the methods; two are worked on at once.

    Yields:
        A finding per configuration, in their order.
    """
    given = Given(gaussians, cameras, observation)
    with ThreadPoolExecutor(WORKERS) as pool:
        yield from ahead(pool, functools.partial(_find, given), configs)


class Given:
    """What all configurations start from, each part made when it is first asked for."""

    def __init__(
        self,
        gaussians: Gaussians,
        cameras: Sequence[Camera],
        observation: Observation,
        prior: Prior | None = None,
    ):
        self.gaussians, self.cameras, self.observation = gaussians, cameras, observation
        self.prior = prior
        self.attributes = _once(lambda name: ATTRIBUTES[name](gaussians))
        self.initial = _once(self._initial)

    def _initial(self, consensus: str) -> np.ndarray:
        # The vote knows no occlusion; a Gaussian that no view sees has no evidence to be moved by,
        # and would keep its votes and set the scale for all others.
        seen = self.observation.evidence.seen
        return np.where(seen, CONSENSUS[consensus](self.observation.votes), np.float32(0))


def _once(function: Callable[[str], Array]) -> Callable[[str], Array]:
    """The function, which is called once for each argument, also by several threads."""
    cached, lock = functools.cache(function), threading.Lock()

    def call(argument: str) -> Array:
        with lock:
            return cached(argument)

    return call


def _find(given: Given, config: Config) -> Finding:
    evidence = given.observation.evidence
    if isinstance(config, RobustConfig):
        return find_robust(evidence, given.gaussians.means, config, given.prior)
    attribute, group_sizes = _optimise(given, config)
    clear = undisputed(evidence)
    if clear:
        return dataclasses.replace(clear, attribute=attribute, group_sizes=group_sizes)
    tamper, labels, warnings = _decide(attribute, evidence, config.threshold)
    contrasted = group_sizes[resolved(config.loop, len(group_sizes)).contrastive_start :]
    if labels.any() and len(contrasted) and not contrasted.all(axis=1).any():
        empty = [f"G_{g}" for g, n in zip("hml", contrasted.max(axis=0), strict=True) if not n]
        which = ", ".join(empty) or "always one of them"
        warnings.append(
            f"The 3D contrastive loss had no groups to compare ({which} empty); the result rests "
            "on the masks alone."
        )
    return Finding(
        attribute=attribute,
        tamper=tamper,
        labels=labels,
        group_sizes=group_sizes,
        warnings=warnings,
    )


def _optimise(given: Given, config: MethodConfig) -> tuple[np.ndarray, np.ndarray]:
    """Raw attribute (N,) and the group sizes of all the iterations."""
    start = given.initial(config.consensus), given.attributes(config.attributes)
    cameras, observation = given.cameras, given.observation
    order = view_order(len(cameras), epochs=config.epochs, shuffle=config.shuffle, seed=config.seed)
    if config.path == "evidence":
        r, infos = fit(observation.evidence, *start, order, config=config.loop)
    else:

        def look(index: int) -> tuple[View, np.ndarray]:
            camera = cameras[index]
            view = make_view(given.gaussians, camera, near=config.near)
            return view, observation.masks[camera.name]

        r, infos = fit_rendered(look, *start, order, config=config.loop)
    return np.asarray(r), np.asarray(infos.group_sizes)


def _decide(
    attribute: np.ndarray, evidence: Evidence, threshold: float
) -> tuple[np.ndarray, np.ndarray, list[str]]:
    """Scores, labels and warnings."""
    tamper = np.asarray(normalise(np.where(evidence.seen, attribute, 0.0)), np.float32)
    labels = tamper > threshold
    return tamper, labels, [] if labels.any() else [DISAGREE]
