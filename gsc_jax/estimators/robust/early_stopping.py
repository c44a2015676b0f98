"""Early stopping over views: observe further views only until the labels are stable.

A 2D network is the most expensive part of a run, and its output for the hundredth view seldom
changes a label. Views are taken spread over the order of the cameras, in growing batches.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from gsc_jax.estimators.protocol import Estimator, Finding, Prior
from gsc_jax.evidence.lifting import EvidenceOfViews
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.evidence.observation import Observation
from gsc_jax.scene import Camera

FIRST_BATCH = 12
"""Views before the first estimate; docs/results.md shows how many views the labels need."""
GROWTH = 1.5
"""Growth factor of the number of views between two estimates."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class EarlyStopping:
    """How many views were used, of those available, and why no more.

    `changes` are the shares of the labelled weight that each further batch of views changed.
    """

    views: int
    available: int
    changes: tuple[float, ...]

    @property
    def reason(self) -> str:
        """Why no more views were used, in a sentence."""
        if self.views == self.available:
            return "All views were used."
        return f"The last views changed {self.changes[-1]:.1%} of the labelled weight."


def observe_until_stable(
    observe: Callable[[Sequence[Camera]], Observation],
    cameras: Sequence[Camera],
    estimator: Estimator,
    prior: Prior | None,
    monitor: Monitor,
) -> tuple[Observation, Finding, EarlyStopping]:
    """Observe growing batches of views until labels change by less than the estimator's tolerance.

    `observe` must keep the views that it has observed, as with a store; the detector has an output
    for all cameras. `prior` is a probability per Gaussian. The monitor records time and progress.
    """
    order = [cameras[k] for k in spread(len(cameras))]
    changes, before = [], None
    monitor.expect("views", len(order))
    for end in batches(len(order)):
        observation = observe(order[:end])
        with monitor.stage("optimise"):
            finding = estimator.estimate(observation, prior)
        if before is not None:
            changes.append(changed(before, finding.labels, observation.evidence))
        before = finding.labels
        # As long as nothing is labelled, the next views may be the first to show the edit.
        if end == len(order) or (before.any() and changes and changes[-1] < estimator.tolerance):
            stop = EarlyStopping(views=end, available=len(order), changes=tuple(changes))
            return observation, finding, stop
    raise ValueError("expected at least one camera, got none")


def batches(count: int) -> Iterator[int]:
    """Numbers of views at which to estimate; the last is `count`, without a small last batch."""
    views = FIRST_BATCH
    while views * GROWTH <= count:
        yield views
        views = round(views * GROWTH)
    yield count


def spread(count: int) -> list[int]:
    """Permutation of range(count), each element far from those before (van der Corput, 1935)."""
    digits = max(1, (count - 1).bit_length())
    reversed_bits = (int(f"{k:0{digits}b}"[::-1], 2) for k in range(2**digits))
    return [k for k in reversed_bits if k < count]


def changed(before: np.ndarray, after: np.ndarray, evidence: EvidenceOfViews) -> float:
    """Share of the weight labelled before or after whose label differs."""
    weight = evidence.weight
    either = weight[before | after].sum()
    return float(weight[before ^ after].sum() / either) if either else 0.0
