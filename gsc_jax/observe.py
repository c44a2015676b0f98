"""Look at a scene from every camera: render, let the 2D detector judge, lift what it says.

This is the only stage that renders for the optimisation (eq. 4 to 6 of the paper, and the evidence
that stands for eq. 9 and 10). Its result can be optimised under any number of configurations.
"""

import dataclasses
import typing
from collections.abc import Sequence

import jax
import numpy as np

from gsc_jax.detection import Detector, fit_to_view
from gsc_jax.evidence import Evidence, stack_evidence, view_evidence
from gsc_jax.projection import NEAR, project, project_centers
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.splat import shade
from gsc_jax.stages import Progress, Stages, silent
from gsc_jax.tiles import bin_view
from gsc_jax.vote import Tally, cast_votes, tally


@dataclasses.dataclass(frozen=True, kw_only=True)
class Observation:
    """What all views say: the evidence of V views, their votes, and what the detector said."""

    evidence: Evidence
    votes: Tally
    detections: dict[str, np.ndarray]


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
