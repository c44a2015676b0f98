"""Look at a scene from every camera: render, let the 2D detector judge, lift what it says.

This is the only stage that renders for the optimisation (eq. 4 to 6 of the paper, and the evidence
that stands for eq. 9 and 10). Its result can be optimised under any number of configurations.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import jax
import numpy as np

from gsc_jax.evidence.detector import Detector, fit_to_view
from gsc_jax.evidence.lifting import Evidence, view_evidence
from gsc_jax.evidence.monitor import Progress, Stages, silent
from gsc_jax.evidence.storage import blank_evidence
from gsc_jax.render.projection import NEAR, project, project_centers
from gsc_jax.render.tiles import View, bin_view
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.parallel import WORKERS, ahead
from gsc_jax.splat import shade
from gsc_jax.vote import Tally, cast_votes, no_votes, tally


@dataclasses.dataclass(frozen=True, kw_only=True)
class Observation:
    """What all views say.

    Attributes:
        evidence: Of V views, shapes (V, N).
        votes: The tally of the votes on N Gaussians.
        masks: What the detector flagged, (H, W) bool, by camera name.
        detections: The probabilities behind it, (H, W) float16, for people to look at.
    """

    evidence: Evidence
    votes: Tally
    masks: dict[str, np.ndarray]
    detections: dict[str, np.ndarray]


def observe(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    detector: Detector,
    *,
    near: float = NEAR,
    evidence: Evidence | None = None,
    stages: Stages | None = None,
    progress: Progress = silent,
) -> Observation:
    """Look at the scene from every camera, let the detector judge, and lift what it says.

    Args:
        gaussians: N Gaussians.
        cameras: V views that the detector can judge.
        detector: The 2D detector.
        near: Near plane in world units.
        evidence: Arrays (V, N) to fill, by default new ones.
        stages: Where to note the time of each stage.
        progress: Called with (stage, done, total).

    Returns:
        The observation, its views in the order of the cameras.
    """
    stages = stages or Stages()
    if evidence is None:
        evidence = blank_evidence(len(cameras), len(gaussians))
    masks, detections = {}, {}

    def prepare(camera: Camera) -> tuple[View, np.ndarray | None]:
        with stages("project"):
            splats = jax.block_until_ready(project(gaussians, camera, near=near))
        with stages("bin"):
            view = bin_view(splats, camera)
        if not detector.needs_image:
            return view, None
        with stages("render"):
            return view, np.asarray(shade(view, gaussians, camera)[0])

    def judged() -> Iterator[tuple[int, View]]:
        # Detectors run here, in the calling thread: nobody promised that they share.
        prepared = ahead(pool, prepare, cameras)
        for index, (camera, (view, image)) in enumerate(zip(cameras, prepared, strict=True)):
            with stages("detect"):
                probability = fit_to_view(detector(image, camera), camera)
            masks[camera.name] = probability > 0.5
            detections[camera.name] = probability.astype(np.float16)
            yield index, view

    def lift(job: tuple[int, View]) -> Tally:
        index, view = job
        camera, mask = cameras[index], masks[cameras[index].name]
        with stages("lift"):
            one = view_evidence(view, mask)
            evidence.total[index], evidence.tampered[index] = one.total, one.tampered
        with stages("vote"):
            return _votes(gaussians, camera, mask)

    votes = no_votes(len(gaussians))
    progress("look", 0, len(cameras))  # the first view may take a network half a minute
    with ThreadPoolExecutor(WORKERS) as pool:
        for done, counts in enumerate(ahead(pool, lift, judged()), start=1):
            votes = votes + counts
            progress("look", done, len(cameras))
    return Observation(evidence=evidence, votes=votes, masks=masks, detections=detections)


def _votes(gaussians: Gaussians, camera: Camera, mask: np.ndarray) -> Tally:
    centers, depths = project_centers(gaussians.means, camera.viewmat, camera.K)
    return jax.block_until_ready(tally(cast_votes(centers, depths, mask)[None]))
