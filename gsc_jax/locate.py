"""The whole method: Gaussians, cameras and a 2D detector in, tampered Gaussians out.

The steps, in the terms of GS-Checker (section 3), and where each is:

1. render every view (eq. 4), run the 2D detector on it, cast the votes of its mask (eq. 5) and lift
   the mask to evidence, which replaces rendering in eq. 9 and 10: `evidence.observation.observe`;
2. compute the initial attribute from these votes (eq. 6), optimise it with the 2D and the 3D loss
   (eq. 7 to 12), apply the threshold: `GSChecker.estimate`, with `vote`, `losses` and `loop`.
   `RobustEstimator.estimate` infers the reliability of every mask instead, and fuses the masks with
   the evidence from the attributes (`forensics.evidence`); without a detector, that evidence
   decides alone;
3. render the mask of every view from the labels: `evidence.masks.view_mask`.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.estimators import Estimator, Finding, Method, Prior, configured
from gsc_jax.estimators.protocol import Outcome, Reliability, outcome
from gsc_jax.estimators.robust.early_stopping import EarlyStopping, observe_until_stable
from gsc_jax.evidence.detector import Detector, as_detector
from gsc_jax.evidence.mask_checks import doubts
from gsc_jax.evidence.masks import filled_scores, pictures, stored_masks, view_mask
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.evidence.observation import EVIDENCE, Observation, check_cameras, observe
from gsc_jax.evidence.storage import ArrayStore
from gsc_jax.forensics.evidence import ForensicEvidence, estimate_from_attributes, forensic_evidence
from gsc_jax.render.visibility import check_views
from gsc_jax.scene import Camera, Gaussians, invalid_rows
from gsc_jax.scene.gaussians import filled_up
from gsc_jax.scene.pytree import short_repr


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Result(Finding):
    """Tampered Gaussians and pixels, and how they were found.

    With these attributes besides those of `Finding`, such as tamper, labels and verdict.

    Attributes:
        reliability: Reliability of each mask by camera name; empty if the method infers none.
        masks: Tampered pixels of every view, (H, W) bool, by camera name.
        probabilities: Probability maps of the 2D detector, (H, W) float16, by camera name.
        seen: Gaussians visible in a view, or without detector with usable attributes, (N,) bool.
        early_stopping: How many views were used and why; None if all were used regardless.
        prior: Prior of the method; None if it used none.
        estimator: The estimator with its configuration.
        stages: Seconds and peak memory in MiB by stage; stages that run in threads overlap.
        seconds: Wall time since the monitor was made.
    """

    reliability: dict[str, Reliability] = dataclasses.field(default_factory=dict)  # pyright: ignore
    masks: Mapping[str, np.ndarray]
    probabilities: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    seen: np.ndarray
    early_stopping: EarlyStopping | None = None
    prior: Prior | None
    estimator: Estimator
    stages: dict[str, dict[str, float]]
    seconds: float

    def __repr__(self) -> str:
        return short_repr(self).replace("(", f"(outcome={self.outcome!r}, ", 1)

    @property
    def outcome(self) -> Outcome | None:
        """What the scene probability says; None for a method without one."""
        return outcome(self.verdict)

    @property
    def method(self) -> str:
        """Name of the method."""
        return self.estimator.name


def locate(
    gaussians: Gaussians,
    cameras: Iterable[Camera],
    detector: Detector | Callable[[np.ndarray], Any] | Mapping[str, Any] | Iterable[Any] | None,
    *,
    method: Method | None = None,
    config: Estimator | None = None,
    prior: Prior | bool = True,
    monitor: Monitor | None = None,
    store: ArrayStore | None = None,
) -> Result:
    """Find the tampered Gaussians of a scene.

    Args:
        gaussians: N Gaussians.
        cameras: The views, each with another name; none, (), if there is no detector either.
        detector: A 2D detector, a function from an image (H, W, 3) to a probability map of any
            size, or probability maps: by camera name, or in the order of the cameras. With None,
            `robust` uses the attributes of the Gaussians alone, and the views only show the result.
        method: `robust` (infers the reliability of every mask), `official` (the released code of
            GS-Checker) or `paper` (its equations); by default that of `config`, or else `robust`.
        config: Replaces the default configuration of the method, e.g. a `RobustEstimator`.
        prior: True for the evidence from the attributes if the method uses it, False, or a prior.
        monitor: Records time, memory and progress.
        store: Where the arrays of the views are kept, also their renders in 8 bit; those of an
            interrupted run of the same input are used. By default in memory, beyond a bound in
            temporary files, and without renders.

    Returns:
        The result; deterministic for one configuration.

    Raises:
        InputError: if the cameras see nothing of the scene, share a name, or have no mask.
        ValueError: if the method is unknown, not the configured one, or has no evidence.
    """
    estimator, monitor = configured(method, config), monitor or Monitor()
    given, store = store, store or ArrayStore()
    cameras = check_cameras(cameras, least=int(detector is not None))
    detector = None if detector is None else as_detector(detector, cameras)
    gaussians, warnings = _usable(gaussians)
    if cameras:
        warnings = [*check_views(gaussians, cameras, near=estimator.near), *warnings]
    gaussians = jax.tree.map(jnp.asarray, gaussians)
    known = _prior(gaussians, estimator, prior, monitor)  # attributes -> prior
    if detector is None:  # prior -> decide
        finding, found = _from_attributes(estimator, known, monitor)
    else:  # cameras -> render -> detect -> vote and lift -> optimise -> decide
        settings = {"near": estimator.near, "store": store, "monitor": monitor}
        observed = functools.partial(observe, gaussians, detector=detector, **settings)
        finding, found = _from_views(observed, cameras, detector, estimator, known, monitor)
    estimator, warnings = found["estimator"], [*warnings, *found["warnings"], *finding.warnings]
    if given is None:
        store.release(EVIDENCE)  # the result keeps the store for its masks
    settings = {"threshold": estimator.threshold, "near": estimator.near}
    settings |= {"rule": estimator.mask_rule, "scored": filled_scores(finding)}
    mask_of = view_mask if given is None else pictures
    compute = functools.partial(mask_of, filled_up(gaussians), **settings)
    masks = stored_masks(compute, cameras, store, monitor, gaussians=len(gaussians))
    fields: dict[str, Any] = {f.name: getattr(finding, f.name) for f in dataclasses.fields(Finding)}
    fields |= {"reliability": {}, **found, "warnings": warnings, "masks": masks}
    times = {"stages": monitor.summary(), "seconds": monitor.elapsed()}
    return Result(**fields, **times, prior=known if estimator.uses_prior else None)


def _prior(
    gaussians: Gaussians, estimator: Estimator, prior: Prior | bool, monitor: Monitor
) -> Prior | None:
    """The given prior, or the evidence from the attributes where the estimator uses one."""
    if isinstance(prior, Prior):
        return prior.of(len(gaussians))
    if not isinstance(prior, bool):
        raise ValueError(f"prior must be True, False or a Prior, got {type(prior).__name__}")
    if not (prior and estimator.uses_prior):
        return None
    monitor.progress("attributes", 0, 1)
    with monitor.stage("attributes"):
        evidence = forensic_evidence(gaussians)
    monitor.progress("attributes", 1, 1)
    return evidence


def _from_views(
    observed: Callable[[Sequence[Camera]], Observation],
    cameras: Sequence[Camera],
    detector: Detector,
    estimator: Estimator,
    prior: Prior | None,
    monitor: Monitor,
) -> tuple[Finding, dict[str, Any]]:
    """Observe the views and estimate; return the finding, and other fields of the `Result`."""
    used = detector.select(cameras)
    estimator, stop = estimator.for_views(len(used)), None
    # Masks from files cost nothing; each view of a network takes seconds.
    if estimator.tolerance > 0 and detector.needs_image:
        observation, finding, stop = observe_until_stable(observed, used, estimator, prior, monitor)
    else:
        observation = observed(used)
        with monitor.stage("optimise"):
            finding = estimator.estimate(observation, prior)
    with monitor.stage("optimise"):
        reasons = doubts(observation, finding.labels, near=estimator.near)
    if reasons and estimator.uses_prior and isinstance(prior, ForensicEvidence):
        finding, _ = _from_attributes(estimator, prior, monitor)
    elif reasons and finding.verdict is not None:
        verdict = min(finding.verdict, 0.5 if prior is None else prior.verdict)
        edited = verdict >= estimator.min_verdict
        kept = {"labels": finding.labels & edited, "tamper": finding.tamper * np.float32(edited)}
        finding = dataclasses.replace(finding, verdict=verdict, **kept)
    views = [camera.name for camera in observation.cameras]
    return finding, {
        "seen": observation.evidence.seen,
        "estimator": estimator,
        "reliability": dict(zip(views, finding.reliability, strict=bool(finding.reliability))),
        "probabilities": observation.probabilities,
        "early_stopping": stop,
        "warnings": [*reasons, *_without_mask(cameras, used), *getattr(detector, "warnings", ())],
    }


def _from_attributes(
    estimator: Estimator, prior: Prior | None, monitor: Monitor
) -> tuple[Finding, dict[str, Any]]:
    if not (estimator.uses_prior and isinstance(prior, ForensicEvidence)):
        raise ValueError(
            f"{estimator.name} needs a detector; without one, use method robust with prior=True or "
            "with a ForensicEvidence"
        )
    with monitor.stage("optimise"):
        finding = estimate_from_attributes(
            prior, threshold=estimator.threshold, min_verdict=estimator.min_verdict
        )
    return finding, {"seen": prior.known, "estimator": estimator, "warnings": []}


def _usable(gaussians: Gaussians) -> tuple[Gaussians, list[str]]:
    """Set the positions of invalid rows to NaN, so that no view sees them, and count them."""
    reasons = {name: rows for name, rows in invalid_rows(gaussians).items() if rows.any()}
    if not reasons:
        return gaussians, []
    invalid = np.any(list(reasons.values()), axis=0)
    counted = ", ".join(f"{int(rows.sum())} {name}" for name, rows in reasons.items())
    means = np.where(invalid[:, None], np.float32(np.nan), gaussians.means)
    return dataclasses.replace(gaussians, means=means), [
        f"{int(invalid.sum()):,} of {len(gaussians):,} Gaussians have invalid values ({counted}) "
        "and are ignored; `load_ply` leaves them out."
    ]


def _without_mask(cameras: Sequence[Camera], chosen: Sequence[Camera]) -> list[str]:
    """Warn about cameras for which the detector has no output."""
    names = {camera.name for camera in chosen}
    missing = [camera.name for camera in cameras if camera.name not in names]
    text = f"{len(missing)} of {len(cameras)} cameras have no mask and were not used"
    return [f"{text} (the first is {missing[0]!r})."] if missing else []
