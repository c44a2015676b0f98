"""Traces: what an edit leaves in the stored numbers of a scene, detected without a trained model.

Each trace marks Gaussians that differ from the convention of the file. Files hold single
coincidences by the thousand, so a mark counts only inside a compact region of marks. The score is a
posterior, with the rates of marks inside and outside of regions measured in the scene itself.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy.special import expit, logit

from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Array, Gaussians
from gsc_jax.scene.parallel import in_blocks

NEIGHBOURS = 12
"""Neighbours that decide about a region: fewer give ragged regions, more blur small edits."""
MIN_REGION = 32
"""Gaussians of the smallest region: a smaller one may be a coincidence (copies: 19 in a .splat)."""
MAX_REGION_SHARE = 0.5
"""Share of the scene above which marks are the rule and not the exception."""
MAX_OUTSIDE_RATE = 0.05
"""Rate of marks outside of the regions above which the scene itself produces them."""
MAX_RARE_RATE = 0.005
"""The same for quaternions with w < 0 (0.03 in scenes that follow w >= 0 in part) or a length of 1
(0.02 in scenes that were normalised and then trained a little more), and for harmonics of another
degree (0.006 to 0.03 where an exporter rounds them to few values)."""
MIN_MAGNITUDE_RATIO = 0.7
"""Least median |w| of quaternions with w < 0 in the regions, divided by that of the others there.
Where a scene was turned after training, w is close to 0 where it changes its sign: the ratio was at
most 0.49 in 300 turns of a capture, and at least 1.02 for ten pasted objects (by hand)."""
MIN_RATE = 1e-3
"""Floor of the estimated rates, so that no score reaches 1."""
BLACK = 0.02
"""Colour up to which a channel counts as black: rasterisers clip colours at 0, so that training
leaves what is black from all sides as it is, with harmonics of 0 and values that clones share."""
START_OPACITY = 0.11
"""Opacity at which training starts, with a margin for rounding to 8 bits."""
UNIT_TOLERANCE = 1e-4
"""Deviation from length 1 of a normalised float32 quaternion, with a margin."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Trace:
    """Score of one trace for each Gaussian.

    Attributes:
        name: "copy-move", "quantisation", "sh-degree", "row-order" or "quaternion-convention".
        score: Probability by this trace alone, shape (N,) float32; 0 means no evidence.
        explanation: One sentence with counts, also where nothing was found.
    """

    name: str
    score: np.ndarray
    explanation: str

    @property
    def found(self) -> bool:
        """Whether any score is above 0.5."""
        return bool((self.score > 0.5).any())


def make_trace(name: str, score: np.ndarray, found: str, absent: str) -> Trace:
    """Trace with an explanation: what the marked Gaussians have, or why there are none."""
    count = int((score > 0.5).sum())
    if count < MIN_REGION:
        return Trace(name=name, score=np.zeros(len(score), np.float32), explanation=absent)
    explanation = f"{count:,} of {len(score):,} Gaussians {found}."
    return Trace(name=name, score=score.astype(np.float32), explanation=explanation)


def any_trace(traces: Sequence[Trace]) -> np.ndarray:
    """Noisy-or of the scores of at least one trace: 1 - prod(1 - score), shape (N,)."""
    return 1 - np.prod([1 - trace.score for trace in traces], axis=0, dtype=np.float32)


def region_scores(
    marked: np.ndarray,
    neighbours: np.ndarray,
    *,
    min_share: float = 0.5,
    max_outside: float = MAX_OUTSIDE_RATE,
    min_outside: float = MIN_RATE,
) -> np.ndarray:
    """Probability that each Gaussian belongs to a compact region of marks, shape (N,) float32.

    Args:
        marked: Marked Gaussians, shape (N,) bool.
        neighbours: Nearest other Gaussians, shape (N, K).
        min_share: Share of marks in a neighbourhood that makes it part of a region.
        max_outside: Rate of marks outside of the regions above which all scores are 0.
        min_outside: Floor of the rate of marks beside a region.

    Returns:
        Posterior given the own mark, with the share of marks nearby as prior; 0 away from regions.
    """
    nothing, size = np.zeros(len(marked), np.float32), neighbours.shape[1] + 1
    if marked.sum() < MIN_REGION or not neighbours.size:
        return nothing
    around = (marked + in_blocks(lambda near: marked[near].sum(axis=1), neighbours)) / size
    share = (around + in_blocks(lambda near: around[near].sum(axis=1), neighbours)) / size
    inside = share >= min_share
    if not MIN_REGION <= inside.sum() <= MAX_REGION_SHARE * len(marked):
        return nothing
    near = inside | inside[neighbours].any(axis=1)
    rate_outside = marked[~near].sum() / max((~near).sum(), 1)
    rate = min(marked[inside].mean(), 1 - MIN_RATE)
    other = max(rate_outside, min_outside)
    if rate_outside > max_outside or rate <= other:
        return nothing
    prior = np.clip((share - other) / (rate - other), 0.01, 0.99)
    own = np.where(marked, np.log(rate / other), np.log((1 - rate) / (1 - other)))
    return np.where(near, expit(own + logit(prior)), 0).astype(np.float32)


def is_black(sh: Array) -> np.ndarray:
    """Which base colours of harmonics (N, K, 3) are black, by channel, shape (N, 3) bool."""
    return 0.5 + Y0 * np.asarray(sh)[:, 0] < BLACK


def is_untrained(gaussians: Gaussians) -> np.ndarray:
    """Gaussians that no view showed in training, still as at its start (INRIA), shape (N,) bool."""
    spheres = np.ptp(np.asarray(gaussians.log_scales), axis=1) == 0
    return spheres & (np.asarray(gaussians.opacities) < START_OPACITY)


def sh_degree(gaussians: Gaussians, neighbours: np.ndarray) -> Trace:
    """Detect Gaussians whose harmonics end at another degree than most, as pasted ones may."""
    sh = np.asarray(gaussians.sh)
    degrees = np.zeros(len(sh), int)
    for degree in range(1, gaussians.sh_degree + 1):
        degrees[sh[:, degree**2 : (degree + 1) ** 2].any(axis=(1, 2))] = degree
    usual = int(np.argmax(np.bincount(degrees, minlength=1)))
    odd = (degrees != usual) & ~is_black(sh).all(axis=1) & ~is_untrained(gaussians)
    score = region_scores(odd, neighbours, max_outside=MAX_RARE_RATE)
    found = f"have harmonics that do not end at degree {usual} as those of the others do"
    absent = "The harmonics end at the same degree everywhere."
    absent = absent if gaussians.sh_degree else "The file holds no view-dependent colour."
    return make_trace("sh-degree", score, found, absent)


def quaternion_convention(gaussians: Gaussians, neighbours: np.ndarray) -> Trace:
    """Detect quaternions of another length or sign convention than those of most Gaussians."""
    quats = np.asarray(gaussians.quats, np.float64)
    norms = np.linalg.norm(quats, axis=1)
    unit = np.abs(norms - 1) < UNIT_TOLERANCE
    # Training starts with no rotation, and leaves it at that where no view shows the Gaussian.
    untouched = is_untrained(gaussians) | ~quats[:, 1:].any(axis=1)
    odd = (unit ^ (unit.sum() > 0.5 * len(unit))) & ~untouched
    lengths = region_scores(odd, neighbours, max_outside=MAX_RARE_RATE)
    # Half of the quaternions of a part without the sign convention satisfy it by chance. Formats
    # that leave out the largest component make that positive instead.
    largest = np.take_along_axis(quats, np.abs(quats).argmax(axis=1)[:, None], axis=1)
    share = 0.3 if (largest < 0).sum() > MIN_RATE * len(quats) else 0.6
    negative = quats[:, 0] < 0
    signs = region_scores(negative, neighbours, min_share=share, max_outside=MAX_RARE_RATE)
    inside, size = signs > 0.5, np.abs(quats[:, 0]) / np.where(norms > 0, norms, 1)
    below, above = size[inside & negative], size[inside & ~negative]
    if len(below) and len(above) and np.median(below) < MIN_MAGNITUDE_RATIO * np.median(above):
        signs = np.zeros_like(signs)
    found = "have quaternions of another length or sign convention than the others"
    absent = "The quaternions follow one convention."
    return make_trace("quaternion-convention", np.maximum(lengths, signs), found, absent)
