"""Looking no longer than it takes: views are added until the labels stop changing.

A 2D network is the most expensive part of a run, and what it says of the hundredth view seldom
matters. Views are taken spread over the order of the cameras, half as many again each time.
"""

import dataclasses
import itertools
from collections import deque
from collections.abc import Iterator, Sequence

import jax
import numpy as np

from gsc_jax.estimators.protocol import Finding
from gsc_jax.estimators.robust.estimator import RobustConfig, find_robust
from gsc_jax.estimators.robust.prior_fusion import Prior
from gsc_jax.evidence.detector import Detector
from gsc_jax.evidence.lifting import Evidence
from gsc_jax.evidence.monitor import Progress, Stages, silent
from gsc_jax.evidence.observation import Observation, observe
from gsc_jax.evidence.storage import blank_evidence
from gsc_jax.scene import Camera, Gaussians

FIRST = 12
"""Views before the first labels."""
MORE = 1.5
"""So many times as many views are looked at before the next ones."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Effort:
    """What was looked at, and why no more.

    Attributes:
        views: Number of views that were looked at.
        available: Number of views that could have been.
        changes: Share of the labelled weight that each further batch of views changed.
    """

    views: int
    available: int
    changes: tuple[float, ...]

    @property
    def reason(self) -> str:
        """Why no more views were looked at, in a sentence."""
        if self.views == self.available:
            return "All views were looked at."
        return f"The last views changed {self.changes[-1]:.1%} of what is labelled."


def observe_enough(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    detector: Detector,
    config: RobustConfig,
    *,
    prior: Prior | None = None,
    stages: Stages | None = None,
    progress: Progress = silent,
) -> tuple[list[Camera], Observation, Finding, Effort]:
    """Look from ever more cameras, until the labels of `robust` change no more.

    Args:
        gaussians: N Gaussians.
        cameras: Views that the detector can judge.
        detector: The 2D detector.
        config: Of the estimator; labels that change by less than its tolerance stop the looking.
        prior: What is known without the masks.
        stages: Where to note the time of each stage.
        progress: Called with (stage, done, total).

    Returns:
        The cameras that were looked from, what they saw, what that says, and the effort.
    """
    order = [cameras[k] for k in spread(len(cameras))]
    stages = stages or Stages()
    rounds = _ever_more(gaussians, order, detector, config, prior, stages, progress)
    return deque(rounds, maxlen=1).pop()


def _ever_more(
    gaussians: Gaussians,
    order: list[Camera],
    detector: Detector,
    config: RobustConfig,
    prior: Prior | None,
    stages: Stages,
    progress: Progress,
) -> Iterator[tuple[list[Camera], Observation, Finding, Effort]]:
    """What is known after each batch of views, until it is enough."""
    room = blank_evidence(len(order), len(gaussians))
    parts: list[Observation] = []
    changes: list[float] = []
    labels = None
    for begin, end in itertools.pairwise([0, *batches(len(order))]):

        def told(stage: str, done: int, _: int, begin: int = begin) -> None:
            progress(stage, begin + done, len(order))

        part = observe(
            gaussians,
            order[begin:end],
            detector,
            near=config.near,
            evidence=_rows(room, begin, end),
            stages=stages,
            progress=told,
        )
        parts.append(part)
        observation = _joined(parts, _rows(room, 0, end))
        with stages("optimise"):
            finding = find_robust(observation.evidence, gaussians.means, config, prior)
        if labels is not None:
            changes.append(changed(labels, finding.labels, observation.evidence))
        labels = finding.labels
        effort = Effort(views=end, available=len(order), changes=tuple(changes))
        yield order[:end], observation, finding, effort
        # Where nothing was found yet, the next views may be the first to see it.
        if labels.any() and changes and changes[-1] < config.tolerance:
            return


def batches(count: int) -> Iterator[int]:
    """Numbers of views after which to ask, the last of them all; a short rest is not put off."""
    views = FIRST
    while views * MORE <= count:
        yield views
        views = round(views * MORE)
    yield count


def spread(count: int) -> list[int]:
    """The numbers below `count`, each next one far from those before (van der Corput, 1935)."""
    digits = max(1, (count - 1).bit_length())
    reversed_bits = (int(f"{k:0{digits}b}"[::-1], 2) for k in range(2**digits))
    return [k for k in reversed_bits if k < count]


def changed(before: np.ndarray, after: np.ndarray, evidence: Evidence) -> float:
    """Share of the weight labelled before or after that is not labelled both times."""
    weight = np.sum(evidence.total, axis=0)
    either = weight[before | after].sum()
    return float(weight[before ^ after].sum() / either) if either else 0.0


def _rows(evidence: Evidence, begin: int, end: int) -> Evidence:
    return jax.tree.map(lambda part: part[begin:end], evidence)


def _joined(parts: Sequence[Observation], evidence: Evidence) -> Observation:
    """One observation of what several looked at."""
    votes = parts[0].votes
    for part in parts[1:]:
        votes = votes + part.votes
    return Observation(
        evidence=evidence,
        votes=votes,
        masks={name: mask for part in parts for name, mask in part.masks.items()},
        detections={name: said for part in parts for name, said in part.detections.items()},
    )
