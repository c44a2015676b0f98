"""Simulated detectors beyond the single failures: profiles, and strengths like those of real ones.

`PROFILES` are detectors with typical combinations of failures. `calibrated` scales the failures of
a detector until they hurt as much as those of real detectors: in the paper's Table 1 the naive
inverse projection of their masks has an F1 between 0.1 and 0.4.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence

from gsc_jax.benchmark.simulate import SHARES, Failures

STRENGTHS = 0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0
"""Strengths that `calibrated` tries: half an octave apart."""
PUBLISHED: Mapping[str, Failures] = {
    "incorporation": Failures(
        boundary=0.631, misses=0.276, blobs=3.818, blob_size=0.078, decoy=0.386, inverted=0.0
    ),
    "modification": Failures(
        boundary=0.024, misses=0.001, blobs=0.0, blob_size=0.041, decoy=0.0, inverted=0.044
    ),
    "removal": Failures(
        boundary=0.249, misses=0.059, blobs=4.0, blob_size=0.104, decoy=0.613, inverted=0.016
    ),
}
"""Failures under which the methods come nearest to the figures of the paper, by kind of edit: the
best draws of `published_fit.py`."""
PROFILES: Mapping[str, Failures] = {
    "picks the wrong side": Failures(inverted=0.4, boundary=1.0, softness=0.3),
    "coarse patches": Failures(boundary=9.0, misses=0.1, softness=8.0),
    "over-eager": Failures(boundary=2.0, blobs=3.0, blob_size=0.06, decoy=0.8),
    "shy": Failures(boundary=2.0, misses=0.65, softness=3.0),
}
"""Detectors by behaviour: two sharp clusters with random names, classified patches, too many flags,
too few flags."""


def scaled(failures: Failures, strength: float) -> Failures:
    """Multiply every failure by a strength, shares up to 1; keep `softness` and `blob_size`."""
    if not 0 <= strength < math.inf:
        raise ValueError(f"strength must be a number of at least 0, got {strength}")
    shares = {name: min(1.0, strength * getattr(failures, name)) for name in SHARES}
    return dataclasses.replace(
        failures, boundary=strength * failures.boundary, blobs=strength * failures.blobs, **shares
    )


def calibrated(
    failures: Failures,
    score: Callable[[Failures], float],
    *,
    low: float = 0.1,
    high: float = 0.4,
    strengths: Sequence[float] = STRENGTHS,
) -> Failures:
    """Scale failures until the inverse projection scores as on masks of real detectors.

    Args:
        failures: Failures to scale.
        score: F1 of the inverse projection on masks with given failures. It is called for the
            strength next to 1 first, and no more once a score is in the range.
        low: Least F1 of the range.
        high: Greatest F1 of the range.
        strengths: Strengths to try, all above 0.

    Returns:
        The failures at the strength nearest to 1, as a ratio, whose score is in the range; of two
        equally near the weaker. If there is none, those whose score is nearest to the range.

    Raises:
        ValueError: if there are no such strengths, the bounds are not in order, or a score is NaN.
    """
    if not (len(strengths) and min(strengths) > 0 and low <= high):
        raise ValueError(
            f"expected strengths above 0 and low <= high, got {strengths}, {low} and {high}"
        )
    excess = {}
    # Rounded, so that 0.5 and 2 are equally near whatever the rounding of their logarithms.
    for strength in sorted(strengths, key=lambda s: (round(abs(math.log(s)), 9), s)):
        f1 = score(scaled(failures, strength))
        if math.isnan(f1):
            raise ValueError(f"the score at strength {strength} is NaN; is any view tampered?")
        excess[strength] = max(low - f1, f1 - high, 0.0)
        if not excess[strength]:
            break
    return scaled(failures, min(excess, key=excess.__getitem__))
