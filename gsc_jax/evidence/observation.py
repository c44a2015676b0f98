"""Observation of a scene: render every view, run the 2D detector, lift its masks to the Gaussians.

No other step renders for the optimisation. An observation holds the votes (GS-Checker, eq. 5) and
the evidence, which replaces rendering in eq. 9 and 10; any estimator, under any configuration, can
start from it.
"""

import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import numpy as np

from gsc_jax.evidence.detector import Detector, as_detector, fit_to_view
from gsc_jax.evidence.lifting import Evidence, view_evidence
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.evidence.storage import blank_evidence
from gsc_jax.render.projection import NEAR, project, project_centers
from gsc_jax.render.tiles import View, bin_view
from gsc_jax.scene import Camera, Gaussians, InputError
from gsc_jax.scene.parallel import WORKERS, bounded_map
from gsc_jax.splat import render_view
from gsc_jax.vote import Tally, cast_votes, no_votes, tally


@dataclasses.dataclass(frozen=True, kw_only=True)
class Observation:
    """A scene, V cameras, and what a 2D detector makes of the views.

    Attributes:
        gaussians: N Gaussians.
        cameras: The V cameras.
        evidence: Blending weights of the V views, shapes (V, N).
        votes: Tally of the votes of all views, shapes (N,).
        masks: Thresholded probability maps, (H, W) bool, by camera name.
        probabilities: Probability maps of the detector, (H, W) float16, by camera name.
    """

    gaussians: Gaussians
    cameras: tuple[Camera, ...]
    evidence: Evidence
    votes: Tally
    masks: dict[str, np.ndarray]
    probabilities: dict[str, np.ndarray]


def observe(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    detector: Detector | Callable[[np.ndarray], Any] | Mapping[str, Any],
    *,
    near: float = NEAR,
    evidence: Evidence | None = None,
    monitor: Monitor | None = None,
) -> Observation:
    """Render a scene from every camera, run the detector, lift its masks by voting and splatting.

    Args:
        gaussians: N Gaussians.
        cameras: V cameras, for all of which the detector has an output.
        detector: A 2D detector, a function of the image, or probability maps by camera name.
        near: Near plane in world units.
        evidence: Arrays (V, N) to write to; new ones by default.
        monitor: Records the time of each stage and the progress over views.

    Returns:
        The observation, with views in the order of the cameras.

    Raises:
        InputError: if there is no camera, two have one name, or the detector has no output for one.
        ValueError: if the detector is none.
    """
    check_cameras(cameras)
    monitor, detector = monitor or Monitor(), as_detector(detector)
    evidence = evidence or blank_evidence(len(cameras), len(gaussians))
    masks, probabilities = {}, {}

    prepare = functools.partial(_prepare, gaussians, detector.needs_image, near, monitor)

    def detect() -> Iterator[tuple[int, View]]:
        # The detector runs in this thread only, since a user's function need not be thread-safe.
        prepared = bounded_map(pool, prepare, cameras)
        for index, (camera, (view, image)) in enumerate(zip(cameras, prepared, strict=True)):
            with monitor.stage("detect"):
                probability = fit_to_view(detector(image, camera), camera)
            masks[camera.name] = probability > 0.5
            probabilities[camera.name] = probability.astype(np.float16)
            yield index, view

    def lift(job: tuple[int, View]) -> Tally:
        index, view = job
        camera, mask = cameras[index], masks[cameras[index].name]
        with monitor.stage("lift"):
            lifted = view_evidence(view, mask)
            evidence.total[index], evidence.tampered[index] = lifted.total, lifted.tampered
        with monitor.stage("vote"):
            return votes_of_view(gaussians, camera, mask)

    votes = no_votes(len(gaussians))
    monitor.progress("views", 0, len(cameras))  # shows the bar before a slow first view ends
    with ThreadPoolExecutor(WORKERS) as pool:
        for done, counts in enumerate(bounded_map(pool, lift, detect()), start=1):
            votes = votes + counts
            monitor.progress("views", done, len(cameras))
    return Observation(
        gaussians=gaussians,
        cameras=tuple(cameras),
        evidence=evidence,
        votes=votes,
        masks=masks,
        probabilities=probabilities,
    )


def _prepare(
    gaussians: Gaussians, needs_image: bool, near: float, monitor: Monitor, camera: Camera
) -> tuple[View, np.ndarray | None]:
    """Project and bin a view, and render it if the detector needs the image (H, W, 3)."""
    with monitor.stage("project"):
        splats = jax.block_until_ready(project(gaussians, camera, near=near))
    with monitor.stage("bin"):
        view = bin_view(splats, camera)
    if not needs_image:
        return view, None
    with monitor.stage("render"):
        return view, np.asarray(render_view(view, gaussians, camera)[0])


def check_cameras(cameras: Sequence[Camera]) -> None:
    """Raise an InputError if there is no camera, or two have one name."""
    names = [camera.name for camera in cameras]
    if not names:
        raise InputError("no cameras: expected at least one view of the scene")
    duplicates = sorted({name for name in names if names.count(name) > 1})
    if duplicates:
        raise InputError(
            f"Two cameras have the name {duplicates[0]!r}; masks are stored by camera name."
        )


def votes_of_view(gaussians: Gaussians, camera: Camera, mask: np.ndarray) -> Tally:
    """Votes of one view on N Gaussians by their projected centres (GS-Checker, eq. 5)."""
    centers, depths = project_centers(gaussians.means, camera.viewmat, camera.K)
    return jax.block_until_ready(tally(cast_votes(centers, depths, mask)[None]))


def joined(parts: Sequence[Observation], evidence: Evidence) -> Observation:
    """Join observations of one scene from different cameras.

    Args:
        parts: At least one observation.
        evidence: Evidence of all their views, in their order.

    Returns:
        One observation of all views.
    """
    votes = parts[0].votes
    for part in parts[1:]:
        votes = votes + part.votes
    return Observation(
        gaussians=parts[0].gaussians,
        cameras=tuple(camera for part in parts for camera in part.cameras),
        evidence=evidence,
        votes=votes,
        masks={name: mask for part in parts for name, mask in part.masks.items()},
        probabilities={k: v for part in parts for k, v in part.probabilities.items()},
    )
