"""The whole method: scene, cameras and perhaps a 2D detector in, the tampered Gaussians out."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.estimators.gschecker import CONFIGS, Config, Method, find, settled
from gsc_jax.estimators.protocol import Finding, Reliability
from gsc_jax.estimators.robust.early_stopping import Effort, observe_enough
from gsc_jax.estimators.robust.estimator import RobustConfig
from gsc_jax.evidence.detector import Detector, as_detector
from gsc_jax.evidence.masks import view_mask
from gsc_jax.evidence.monitor import Progress, Stages, silent
from gsc_jax.evidence.observation import observe
from gsc_jax.forensics.evidence import Native, find_native, native_evidence
from gsc_jax.render.visibility import check_views
from gsc_jax.scene import Camera, Gaussians, InputError, invalid_rows
from gsc_jax.scene.parallel import WORKERS, ahead

DISAGREEMENT = 0.1
"""A finding that covers less than this share of what was flagged is worth a warning."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Result:
    """What was found.

    Attributes:
        tamper: Score in [0, 1], shape (N,) float32; 0 where nothing is known of a Gaussian. Of
            `robust` it is the probability to be tampered, given an edit (`fusion.py`); all 0 where
            next to nothing speaks for one.
        labels: Tampered Gaussians, shape (N,) bool.
        attribute: Raw attribute r, shape (N,) float32; unbounded. Of `robust` the log odds.
        verdict: Probability that anything was tampered with; None of methods that cannot say.
        reliability: Of `robust`, by camera name: whether the mask finds what is tampered, misses
            it, or is inverted.
        masks: Tampered pixels (H, W) bool of every view, by camera name.
        detections: What the 2D detector said, (H, W) float16 in [0, 1], by camera name.
        seen: Gaussians that contributed to some pixel, or that could be described where no
            detector looked, shape (N,) bool.
        group_sizes: Sizes of G_h, G_m and G_l in every iteration, shape (iterations, 3).
        effort: How many views `robust` looked at, and why no more; None where all were wanted.
        native: What the Gaussians themselves said; None where they were not asked.
        method: Name of the method.
        config: Its resolved configuration.
        stages: By stage its seconds, which overlap where views are worked on in threads, and the
            peak memory of the process in MiB when it ended.
        seconds: Wall time of the whole.
        warnings: What a user should know, in sentences.
    """

    tamper: np.ndarray
    labels: np.ndarray
    attribute: np.ndarray
    verdict: float | None
    reliability: dict[str, Reliability]
    masks: dict[str, np.ndarray]
    detections: dict[str, np.ndarray]
    seen: np.ndarray
    group_sizes: np.ndarray
    effort: Effort | None
    native: Native | None
    method: str
    config: Config
    stages: dict[str, dict[str, float]]
    seconds: float
    warnings: list[str]


def locate(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    detector: Detector | Callable[[np.ndarray], Any] | Mapping[str, Any] | None,
    *,
    method: Method = "robust",
    config: Config | None = None,
    native: Native | bool = True,
    progress: Progress = silent,
) -> Result:
    """Find the tampered Gaussians of a scene.

    Args:
        gaussians: N Gaussians.
        cameras: The views to look from, each of another name.
        detector: A detector, a function image (H, W, 3) -> probability (any size), or
            probabilities by camera name. With None, `robust` asks the Gaussians alone, and the
            views only show what was found.
        method: `robust` (asks what each mask is worth), `official` (the schedule of the released
            code) or `paper` (the equations).
        config: Replaces the method, e.g. a changed `METHODS["paper"]` or a `RobustConfig`.
        native: Whether `robust` asks the Gaussians themselves, or what they said when they were.
        progress: Called with (stage, done, total).

    Returns:
        The result; deterministic for one configuration.

    Raises:
        InputError: if the cameras see nothing of the scene, share a name, or have no mask.
        ValueError: if the method is unknown, or there is nothing that it could go by.
    """
    if method not in CONFIGS:
        raise ValueError(f"method must be one of {', '.join(CONFIGS)}, got {method!r}")
    config, stages = config or CONFIGS[method], Stages()
    warnings = [*check_views(gaussians, cameras, near=config.near), *_unusable(gaussians)]
    _check_names(cameras)
    gaussians = jax.tree.map(jnp.asarray, gaussians)
    detector = None if detector is None else as_detector(detector)
    told = _asked(gaussians, native, config, stages, progress)
    look = _look(gaussians, cameras, detector, told, config, stages, progress)
    finding, config = look.finding, look.config
    masks = _masks(gaussians, cameras, finding, config, stages, progress)
    return Result(
        tamper=finding.tamper,
        labels=finding.labels,
        attribute=finding.attribute,
        verdict=finding.verdict,
        reliability={
            c.name: said for c, said in zip(look.cameras, finding.reliability, strict=False)
        },
        masks=masks,
        detections=look.detections,
        seen=look.seen,
        group_sizes=finding.group_sizes,
        effort=look.effort,
        native=told if isinstance(config, RobustConfig) else None,
        method=config.name,
        config=config,
        stages=stages.summary(),
        seconds=stages.elapsed(),
        warnings=[
            *warnings,
            *look.warnings,
            *finding.warnings,
            *([] if isinstance(config, RobustConfig) else _disagreement(look.flagged, masks)),
            *getattr(detector, "warnings", ()),
        ],
    )


def _asked(
    gaussians: Gaussians,
    native: Native | bool,
    config: Config,
    stages: Stages,
    progress: Progress,
) -> Native | None:
    """What the Gaussians themselves say, where the method has a use for it."""
    if not isinstance(native, Native | bool):
        raise ValueError(
            "native must be True, False or what native_evidence said, got "
            f"{type(native).__name__}; `method.find` takes any prior"
        )
    if native is False or (isinstance(config, RobustConfig) and config.native == 0):
        return None
    if isinstance(native, Native):
        if len(native.known) != len(gaussians):
            raise ValueError(
                f"native speaks of {len(native.known)} Gaussians, the scene has {len(gaussians)}"
            )
        return native
    if not isinstance(config, RobustConfig):
        return None
    progress("native", 0, 1)
    with stages("native"):
        told = native_evidence(gaussians)
    progress("native", 1, 1)
    return told


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Looked:
    """What was found, and from where; without the evidence, which is the largest thing there is."""

    finding: Finding
    seen: np.ndarray
    config: Config
    cameras: Sequence[Camera] = ()
    flagged: Mapping[str, np.ndarray] = dataclasses.field(default_factory=dict)
    detections: dict[str, np.ndarray] = dataclasses.field(default_factory=dict)
    effort: Effort | None = None
    warnings: Sequence[str] = ()


def _look(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    detector: Detector | None,
    native: Native | None,
    config: Config,
    stages: Stages,
    progress: Progress,
) -> _Looked:
    """Find what masks and Gaussians agree on, or what the Gaussians say alone."""
    if detector is not None:
        chosen, warnings = _select(detector, cameras)
        config = settled(config, len(chosen))
        look = _from_views(gaussians, chosen, detector, native, config, stages, progress)
        return dataclasses.replace(look, warnings=warnings)
    if native is not None and isinstance(config, RobustConfig):
        with stages("optimise"):
            finding = find_native(native, config=config)
        return _Looked(finding=finding, seen=native.known, config=config)
    raise ValueError(
        f"{config.name} has nothing to go by without a detector; give one, or let `robust` ask the "
        "Gaussians themselves (native=True)"
    )


def _from_views(
    gaussians: Gaussians,
    cameras: list[Camera],
    detector: Detector,
    native: Native | None,
    config: Config,
    stages: Stages,
    progress: Progress,
) -> _Looked:
    """Look from the cameras, as many as it takes, and find what is tampered."""
    prior = None if native is None else native.prior
    effort = None
    # Masks that are there cost nothing; a network is asked for no more than it takes.
    if isinstance(config, RobustConfig) and config.tolerance > 0 and detector.needs_image:
        cameras, observation, finding, effort = observe_enough(
            gaussians, cameras, detector, config, prior=prior, stages=stages, progress=progress
        )
    else:
        observation = observe(
            gaussians, cameras, detector, near=config.near, stages=stages, progress=progress
        )
        with stages("optimise"):
            finding = find(gaussians, cameras, observation, config, prior)
    return _Looked(
        finding=finding,
        seen=observation.evidence.seen,
        config=config,
        cameras=cameras,
        flagged=observation.masks,
        detections=observation.detections,
        effort=effort,
    )


def _masks(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    finding: Finding,
    config: Config,
    stages: Stages,
    progress: Progress,
) -> dict[str, np.ndarray]:
    """The tampered pixels of every view, by camera name."""

    def mask_of(camera: Camera) -> np.ndarray:
        with stages("masks"):
            return view_mask(
                gaussians,
                camera,
                finding.tamper,
                finding.labels,
                rule=config.mask_rule,
                threshold=config.threshold,
                near=config.near,
            )

    masks = {}
    with ThreadPoolExecutor(WORKERS) as pool:
        for camera, mask in zip(cameras, ahead(pool, mask_of, cameras), strict=True):
            masks[camera.name] = mask
            progress("masks", len(masks), len(cameras))
    return masks


def _disagreement(flagged: Mapping[str, np.ndarray], masks: Mapping[str, np.ndarray]) -> list[str]:
    """A warning where next to nothing of what the detector flagged was confirmed."""
    said = np.mean([mask.mean() for mask in flagged.values()])
    found = np.mean([masks[name].mean() for name in flagged])
    if not 0 < found < DISAGREEMENT * said:
        return []
    return [
        f"The detector flags {said:.1%} of what the views show, of which {found:.2%} was "
        "confirmed: its masks disagree. A smaller lambda2, or the method robust, asks for less."
    ]


def _unusable(gaussians: Gaussians) -> list[str]:
    """A warning that counts the rows with values that mean nothing."""
    reasons = {name: rows for name, rows in invalid_rows(gaussians).items() if rows.any()}
    if not reasons:
        return []
    count = int(np.any(list(reasons.values()), axis=0).sum())
    counted = ", ".join(f"{int(rows.sum())} {name}" for name, rows in reasons.items())
    return [
        f"{count:,} of {len(gaussians):,} Gaussians have values that mean nothing ({counted}); "
        "`load_ply` would have left them out."
    ]


def _check_names(cameras: Sequence[Camera]) -> None:
    names = [camera.name for camera in cameras]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise InputError(f"Two cameras are called {twice[0]!r}; masks are kept by camera name.")


def _select(detector: Detector, cameras: Sequence[Camera]) -> tuple[list[Camera], list[str]]:
    """The cameras that the detector can judge, and a warning where that is not all."""
    chosen = detector.select(cameras)
    if len(chosen) == len(cameras):
        return chosen, []
    judged = {camera.name for camera in chosen}
    without = next(camera.name for camera in cameras if camera.name not in judged)
    return chosen, [
        f"{len(cameras) - len(chosen)} of {len(cameras)} cameras have no mask and were not used to "
        f"find anything (the first is {without!r})."
    ]
