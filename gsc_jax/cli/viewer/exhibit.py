"""Results made ready for a viewer: what is shown, from where, and what is said about it.

The served page and the standalone one show the same exhibit.
"""

import dataclasses
from typing import Any

import numpy as np

from gsc_jax.cli.report.wording import found_sentence, headline, percent, share
from gsc_jax.cli.results import Results
from gsc_jax.cli.viewer.poses import Pose, pose, upward
from gsc_jax.cli.viewer.splats import Splats, heat, largest, splats

SAMPLE = 20_000
"""Gaussians that tell how far away things mostly are."""
FRUSTUM = 0.08
"""Size of a drawn camera relative to its distance from what it looks at."""
STOPS = 9
"""Colours that a legend is made of."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Exhibit:
    """What a viewer shows.

    Attributes:
        title: Name of the folder of results.
        said: What was found, in sentences.
        splats: N splats in their own colours.
        score: Of tampering, shape (N,) float32.
        threshold: Above which the run called a Gaussian tampered.
        poses: The cameras of the run, at least one; the viewer begins at the first.
        up: Unit direction that is up, shape (3,).
        near: Near plane in world units.
        far: Distance beyond which nothing is, in world units.
        frustum: Size of a drawn camera in world units.
    """

    title: str
    said: list[str]
    splats: Splats
    score: np.ndarray
    threshold: float
    poses: list[Pose]
    up: np.ndarray
    near: float
    far: float
    frustum: float


def exhibit(results: Results, *, most: int) -> tuple[Exhibit, list[str]]:
    """Makes results ready.

    Args:
        results: What `locate` found.
        most: Most Gaussians to show.

    Returns:
        The exhibit, and what a person should know of it.
    """
    rows = largest(results.gaussians, most, first=results.labels)
    drawn = splats(results.gaussians.take(rows))
    means = np.asarray(results.gaussians.means)
    sample = means[np.linspace(0, len(means) - 1, min(len(means), SAMPLE)).astype(np.int64)]
    near = float(results.report["config"]["near"])
    up = upward(results.cameras)
    poses = [pose(camera, sample, up=up, near=near) for camera in results.cameras]
    distances = [np.linalg.norm(place.look_at - place.position) for place in poses]
    shown = Exhibit(
        title=results.folder.resolve().name,
        said=_said(results.report),
        splats=drawn,
        score=results.tamper[rows],
        threshold=results.threshold,
        poses=poses,
        up=up,
        near=near,
        far=_reach(drawn.centers, poses),
        frustum=FRUSTUM * float(np.median(distances)),
    )
    return shown, _left_out(results, rows)


def counted(score: np.ndarray, threshold: float) -> str:
    """How many Gaussians are tampered at a threshold, in words.

    Args:
        score: Of tampering, shape (N,).
        threshold: Above which they are.

    Returns:
        A sentence without its stop.
    """
    found = int(np.count_nonzero(score > threshold))
    return f"{found:,} of {len(score):,} Gaussians ({share(found / len(score))}) score above it"


def legend() -> str:
    """The colours of the heat map with their scores, as HTML."""
    levels = np.rint(255 * heat(np.linspace(0, 1, STOPS))).astype(int)
    colors = ", ".join(f"rgb({red}, {green}, {blue})" for red, green, blue in levels)
    return (
        '<div style="padding: 0 1em 0.5em; font-size: 0.85em">'
        '<div style="display: flex; justify-content: space-between">'
        "<span>0 authentic</span><span>score</span><span>tampered 1</span></div>"
        '<div style="height: 0.8em; border-radius: 2px; '
        f'background: linear-gradient(to right, {colors})"></div></div>'
    )


def _said(report: dict[str, Any]) -> list[str]:
    """What was found, as result.json tells it."""
    counts, verdict = report["counts"], report.get("verdict")
    said = found_sentence(
        counts["tampered"],
        counts["gaussians"],
        verdict=verdict,
        views=len(report["per_view"]),
        covered=report["tampered_share_of_views"],
    )
    if verdict is None:
        return [said]
    probability = f"The probability that anything was edited is {percent(verdict)}."
    return [headline(verdict, counts["tampered"]), f"{said} {probability}"]


def _reach(points: np.ndarray, poses: list[Pose]) -> float:
    """Twice the size of the box around all things, cameras and what these look at."""
    places = [place for pose in poses for place in (pose.position, pose.look_at)]
    everything = np.concatenate([points.astype(np.float64), places])
    return 2 * float(np.linalg.norm(np.ptp(everything, axis=0)))


def _left_out(results: Results, rows: np.ndarray) -> list[str]:
    left = len(results.labels) - len(rows)
    if not left:
        return []
    tampered = int(results.labels.sum() - results.labels[rows].sum())
    return [
        f"shows {len(rows):,} of {len(results.labels):,} Gaussians: the {left:,} of least opacity "
        f"times area are left out ({tampered:,} of them tampered); --most N shows more"
    ]
