"""Collects what the page of `gsc-jax view` shows: Gaussians, cameras, and sentences about them."""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from gsc_jax.cli.report import wording
from gsc_jax.cli.results import Results
from gsc_jax.cli.viewer.splats import Splats, by_importance, splats
from gsc_jax.forensics.evidence import forensic_evidence
from gsc_jax.render.orbit import mean_up
from gsc_jax.render.projection import NEAR
from gsc_jax.scene import Array, Camera

MIN_LEVEL = 0.2
"""Sine of the angle between view and vertical below which the up of the image is used instead."""


class Pose(NamedTuple):
    """A camera in the terms of viser: world units, `up` of length 1, vertical `fov` in radians."""

    name: str
    position: np.ndarray
    look_at: np.ndarray
    up: np.ndarray
    fov: float


def pose(camera: Camera, means: Array, *, up: Array, near: float = NEAR) -> Pose:
    """Convert a camera; its principal point is taken to be the middle of the image.

    What it looks at has the median depth of those of the `means`, (N, 3), that it shows beyond the
    near plane, or 1; `up` is the unit up direction of the scene.
    """
    rotation, K = np.asarray(camera.viewmat, np.float64)[:3, :3], np.asarray(camera.K, np.float64)
    right, down, forward = rotation
    position = np.asarray(camera.center, np.float64)
    half_width, half_height = camera.width / (2 * K[0, 0]), camera.height / (2 * K[1, 1])
    x, y, z = rotation @ (np.asarray(means, np.float64) - position).T
    visible = (z > near) & (abs(x) < half_width * z) & (abs(y) < half_height * z)
    depth = float(np.median(z[visible])) if visible.any() else 1.0
    level = np.asarray(up, np.float64) - (up @ right) * right
    upright = level / np.linalg.norm(level) if level @ -down > MIN_LEVEL else -down
    fov = 2 * float(np.arctan(half_height))
    return Pose(camera.name, position, position + depth * forward, upright, fov)


MAX_DEPTH_SAMPLES = 20_000
"""Gaussians from which the depth of each view is estimated; more do not change a median."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Contents:
    """What a viewer shows: N splats, and the cameras of the run, first those that show most labels.

    The sentences say what the run found. Above the threshold of the `score` (N,) float32, it has
    labelled the Gaussians, perhaps as candidates only. `rows` (N,) int64 are those of the splats
    among the `total` of the scene file, and `traces` (N,) bool mark the Gaussians with each trace
    that was found. `up` is a unit vector, and the far plane twice the diagonal of the box around
    all splats, cameras and their targets.
    """

    title: str
    sentences: list[str]
    splats: Splats
    score: np.ndarray
    threshold: float
    candidates: bool
    rows: np.ndarray
    total: int
    traces: dict[str, np.ndarray]
    poses: list[Pose]
    up: np.ndarray
    near: float
    far: float


def viewer_contents(results: Results, *, most: int) -> tuple[Contents, list[str]]:
    """At most `most` Gaussians, the most important first, with all else to show; and notes."""
    gaussians = results.scene.gaussians
    rows = by_importance(gaussians, labelled=results.labels)[:most]
    chosen = splats(gaussians.take(rows))
    means = np.asarray(gaussians.means)
    sample = means[np.linspace(0, len(means) - 1, min(len(means), MAX_DEPTH_SAMPLES)).astype(int)]
    near, up = float(results.report["config"]["near"]), mean_up(results.cameras)
    traced = (results.report.get("attributes") or {}).get("traces")
    traces = forensic_evidence(gaussians).traces if traced else ()
    shares = [-view.get("tampered_share", 0) for view in results.report["per_view"]]
    cameras = [results.cameras[k] for k in np.argsort(shares, kind="stable")]
    poses = [pose(camera, sample, up=up, near=near) for camera in cameras]
    places = [place for pose in poses for place in (pose.position, pose.look_at)]
    contents = Contents(
        title=results.folder.resolve().name.encode(errors="replace").decode(),
        sentences=_sentences(results.report),
        splats=chosen,
        score=results.tamper[rows],
        threshold=float(results.report["config"]["threshold"]),
        candidates=wording.are_candidates(results.report.get("verdict")),
        rows=results.scene.rows[rows],
        total=results.scene.total,
        traces={trace.name: trace.score[rows] > 0.5 for trace in traces if trace.found},
        poses=poses,
        up=up,
        near=near,
        far=2 * float(np.linalg.norm(np.ptp(np.concatenate([chosen.centers, places]), axis=0))),
    )
    omitted = len(results.labels) - len(rows)
    tampered = int(results.labels.sum() - results.labels[rows].sum())
    note = (
        f"shows {len(rows):,} of {len(results.labels):,} Gaussians, those of largest opacity times "
        f"area; {tampered:,} of the {omitted:,} omitted are labelled; --most N shows more"
    )
    return contents, [note] if omitted else []


def _sentences(report: Mapping[str, Any]) -> list[str]:
    differences = wording.differences(report.get("contrasts", {}))
    labels = " ".join(filter(None, [wording.lead(report), differences]))
    if (verdict := report.get("verdict")) is None:
        return [labels]
    headline = wording.headline(verdict, report["counts"]["tampered"])
    explained = wording.explained(report)
    reason = f"The scene probability of an edit is {wording.percent(verdict)}. {explained}"
    traces = (report.get("attributes") or {}).get("traces", {})
    return [headline, labels, reason, *traces.values()]
