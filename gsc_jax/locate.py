"""The whole method: scene, cameras and a 2D detector in, the tampered Gaussians out.

`locate` reads like the paper: look at every view and let its mask vote (eq. 4 to 6), optimise the
attribute (eq. 7 to 12), normalise and threshold it, render the masks. Where the attribute says
nothing, because no mask or every mask is full, the result is defined and says so.
"""

import dataclasses
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.decide import MaskRule, normalise, view_mask
from gsc_jax.detection import Detector, as_detector, fit_to_view
from gsc_jax.errors import InputError
from gsc_jax.evidence import Evidence, stack_evidence, view_evidence
from gsc_jax.loop import LoopConfig, fit, fit_rendered, view_order
from gsc_jax.losses import official_attributes, paper_attributes, standardised_attributes
from gsc_jax.projection import NEAR, project, project_centers
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.splat import View, bin_view, make_view, shade
from gsc_jax.stages import Progress, Stages, silent
from gsc_jax.views import check_views
from gsc_jax.vote import Tally, cast_votes, official_consensus, paper_consensus, tally

Method = Literal["paper", "official"]

CONSENSUS = {"paper": paper_consensus, "official": official_consensus}
ATTRIBUTES = {
    "paper": paper_attributes,
    "official": official_attributes,
    "standardised": standardised_attributes,
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class MethodConfig:
    """All that a method leaves to choose.

    Attributes:
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

    consensus: Literal["paper", "official"] = "paper"
    attributes: Literal["paper", "official", "standardised"] = "paper"
    epochs: int = 5
    shuffle: bool = True
    loop: LoopConfig = dataclasses.field(default_factory=LoopConfig)
    threshold: float = 0.1
    mask_rule: MaskRule = "share"
    path: Literal["evidence", "rendered"] = "evidence"
    near: float = NEAR
    seed: int = 0


METHODS: Mapping[str, MethodConfig] = {
    "paper": MethodConfig(),
    "official": MethodConfig(
        consensus="official",
        attributes="official",
        epochs=1,
        shuffle=False,
        loop=LoopConfig(per_feature=True),
    ),
}
"""The paper's equations over several epochs, and the schedule and definitions of its code."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Result:
    """What was found.

    Attributes:
        tamper: Score in [0, 1], shape (N,) float32; 0 where nothing was seen.
        labels: Tampered Gaussians, shape (N,) bool.
        attribute: Raw attribute r, shape (N,) float32; unbounded.
        masks: Tampered pixels (H, W) bool of every view, by camera name.
        detections: What the 2D detector said, (H, W) float32 in [0, 1], by camera name.
        seen: Gaussians that contributed to some pixel, shape (N,) bool.
        group_sizes: Sizes of G_h, G_m and G_l in every iteration, shape (iterations, 3).
        method: Name of the method.
        config: Its resolved configuration.
        stages: Seconds and peak memory in MiB, by stage.
        warnings: What a user should know, in sentences.
    """

    tamper: np.ndarray
    labels: np.ndarray
    attribute: np.ndarray
    masks: dict[str, np.ndarray]
    detections: dict[str, np.ndarray]
    seen: np.ndarray
    group_sizes: np.ndarray
    method: str
    config: MethodConfig
    stages: dict[str, dict[str, float]]
    warnings: list[str]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Observation:
    """What all views say: the evidence of V views, their votes, and what the detector said."""

    evidence: Evidence
    votes: Tally
    detections: dict[str, np.ndarray]


def locate(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    detector: Detector | Callable[[np.ndarray], Any] | Mapping[str, Any],
    *,
    method: Method = "paper",
    config: MethodConfig | None = None,
    progress: Progress = silent,
) -> Result:
    """Find the tampered Gaussians of a scene.

    Args:
        gaussians: N Gaussians.
        cameras: The views to look from, each of another name.
        detector: A detector, a function image (H, W, 3) -> probability (any size), or
            probabilities by camera name.
        method: `paper` (the equations) or `official` (the schedule of the released code).
        config: Replaces the configuration of the method, e.g. a changed `METHODS[method]`.
        progress: Called with (stage, done, total).

    Returns:
        The result; deterministic for one configuration.

    Raises:
        InputError: if the cameras see nothing of the scene, share a name, or have no mask.
        ValueError: if the method is unknown.
    """
    if method not in METHODS:
        raise ValueError(f"method must be one of {', '.join(METHODS)}, got {method!r}")
    config = config or METHODS[method]
    stages, detector = Stages(), as_detector(detector)
    warnings = check_views(gaussians, cameras, near=config.near)
    gaussians = jax.tree.map(jnp.asarray, gaussians)
    chosen = _select(detector, cameras, warnings)

    observation = observe(
        gaussians, chosen, detector, near=config.near, stages=stages, progress=progress
    )
    with stages("optimise"):
        attribute, group_sizes = _optimise(gaussians, chosen, observation, config)
    seen = observation.evidence.seen
    tamper, labels = _decide(attribute, seen, observation.evidence, config, warnings)

    masks = {}
    for camera in cameras:
        with stages("masks"):
            masks[camera.name] = view_mask(
                gaussians,
                camera,
                attribute,
                labels,
                rule=config.mask_rule,
                threshold=config.threshold,
                near=config.near,
            )
        progress("masks", len(masks), len(cameras))
    warnings.extend(getattr(detector, "warnings", ()))
    if group_sizes.size and not group_sizes.all(axis=1).any():
        empty = [g for g, size in zip("hml", group_sizes.max(axis=0), strict=True) if not size]
        which = " and ".join(f"G_{g}" for g in empty) or "some group in every iteration"
        warnings.append(f"The 3D contrastive loss compared nothing: {which} empty.")
    return Result(
        tamper=tamper,
        labels=labels,
        attribute=attribute,
        masks=masks,
        detections=observation.detections,
        seen=seen,
        group_sizes=group_sizes,
        method=method,
        config=config,
        stages=stages.summary(),
        warnings=warnings,
    )


def observe(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    detector: Detector,
    *,
    near: float = NEAR,
    stages: Stages | None = None,
    progress: Progress = silent,
) -> Observation:
    """Look at the scene from every camera, let the detector judge, and lift what it says.

    Args:
        gaussians: N Gaussians.
        cameras: V views that the detector can judge.
        detector: The 2D detector.
        near: Near plane in world units.
        stages: Where to note the time of each stage.
        progress: Called with (stage, done, total).

    Returns:
        Evidence (V, N), the tally of the votes, and the detections by camera name.
    """
    stages = stages or Stages()
    evidence, votes, detections = [], None, {}
    for done, camera in enumerate(cameras, start=1):
        with stages("project"):
            splats = jax.block_until_ready(project(gaussians, camera, near=near))
        with stages("bin"):
            view = bin_view(splats, camera)
        image = None
        if detector.needs_image:
            with stages("render"):
                image = np.asarray(shade(view, gaussians, camera)[0])
        with stages("detect"):
            probability = fit_to_view(detector(image, camera), camera)
            mask = probability > 0.5
        with stages("lift"):
            evidence.append(jax.tree.map(np.asarray, view_evidence(view, mask)))
        with stages("vote"):
            centers, depths = project_centers(gaussians.means, camera.viewmat, camera.K)
            counts = tally(cast_votes(centers, depths, mask)[None])
            votes = counts if votes is None else votes + counts
        detections[camera.name] = probability
        progress("look", done, len(cameras))
    return Observation(
        evidence=stack_evidence(evidence), votes=typing.cast(Tally, votes), detections=detections
    )


def _select(detector: Detector, cameras: Sequence[Camera], warnings: list[str]) -> list[Camera]:
    names = [camera.name for camera in cameras]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"Two cameras are called {twice[0]!r}; masks are kept by camera name.")
    chosen = detector.select(cameras)
    if len(chosen) < len(cameras):
        without = next(name for name in names if name not in {camera.name for camera in chosen})
        warnings.append(
            f"{len(cameras) - len(chosen)} of {len(cameras)} cameras have no mask and were not "
            f"used to find anything (the first is {without!r})."
        )
    return chosen


def _optimise(
    gaussians: Gaussians, cameras: Sequence[Camera], observation: Observation, config: MethodConfig
) -> tuple[np.ndarray, np.ndarray]:
    """Raw attribute (N,) and the group sizes of all the iterations."""
    initial = CONSENSUS[config.consensus](observation.votes)
    attributes = ATTRIBUTES[config.attributes](gaussians)
    order = view_order(len(cameras), epochs=config.epochs, shuffle=config.shuffle, seed=config.seed)
    if config.path == "evidence":
        r, infos = fit(observation.evidence, initial, attributes, order, config=config.loop)
    else:

        def look(index: int) -> tuple[View, np.ndarray]:
            camera = cameras[index]
            mask = observation.detections[camera.name] > 0.5
            return make_view(gaussians, camera, near=config.near), mask

        r, infos = fit_rendered(look, initial, attributes, order, config=config.loop)
    return np.asarray(r), np.asarray(infos.group_sizes)


def _decide(
    attribute: np.ndarray,
    seen: np.ndarray,
    evidence: Evidence,
    config: MethodConfig,
    warnings: list[str],
) -> tuple[np.ndarray, np.ndarray]:
    """Scores and labels; what no optimisation can tell is decided here, and said."""
    if not np.any(evidence.tampered):
        warnings.append("No view says that anything is tampered.")
        return np.zeros_like(attribute), np.zeros_like(seen)
    if np.array_equal(evidence.tampered, evidence.total):
        warnings.append("Every view says that everything is tampered.")
        return seen.astype(np.float32), seen
    tamper = np.where(seen, np.asarray(normalise(attribute)), 0.0).astype(np.float32)
    labels = tamper > config.threshold
    if not labels.any():
        warnings.append("Some pixels were flagged, but no Gaussian is tampered in most of them.")
    return tamper, labels
