"""A simulated 2D tampering detector: the truth of each view, with named failures.

The detectors of the field miss the object, flag blobs, flag the same authentic thing from all
sides, return the complement and draw ragged edges. Each failure has a strength in `Failures`, so
that a method can be tested against one at a time. `REGIMES` names the settings that are reported,
`PROFILES` detectors with a character, and `calibrated` finds the strength at which a setting hurts
as much as real detectors do: in the paper's Table 1 the naive inverse projection of their masks
reaches an F1 between 0.1 and 0.4.

A mask is handled as its signed distance in pixels, positive inside: regions unite by the maximum,
an edge becomes ragged by adding smooth noise, and a logistic turns distance into probability. With
no failures, probability > 0.5 is exactly the truth.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from gsc_jax.scene import Gaussians

SHARES = "misses", "decoy", "inverted"
STRENGTHS = 0.25, 0.35, 0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0
"""What `calibrated` tries: half an octave apart."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Failures:
    """How a detector fails.

    Attributes:
        boundary: Standard deviation in pixels by which edges move in and out.
        misses: Share of the views with the object in which it is not found.
        blobs: Expected number of false blobs per view, independent between views.
        blob_size: Median radius of a blob as a share of the image diagonal.
        decoy: Share of the views with the decoy, an authentic region, in which it is flagged.
        inverted: Share of the views in which the complement is returned.
        softness: Pixels over which a probability changes at an edge; 0 gives zeros and ones.
    """

    boundary: float = 0.0
    misses: float = 0.0
    blobs: float = 0.0
    blob_size: float = 0.05
    decoy: float = 0.0
    inverted: float = 0.0
    softness: float = 1.5

    def __post_init__(self) -> None:
        for name in SHARES:
            if not 0 <= getattr(self, name) <= 1:
                raise ValueError(f"{name} is a share of the views, got {getattr(self, name)}")
        for name in ("boundary", "blobs", "blob_size", "softness"):
            if getattr(self, name) < 0:
                raise ValueError(f"{name} must not be negative, got {getattr(self, name)}")

    def scaled(self, strength: float) -> "Failures":
        """The same detector, failing more or less.

        Args:
            strength: 0 is a detector without failures, 1 this one. Multiplies every failure, shares
                up to 1; `softness` and `blob_size` say what a mask looks like and stay.

        Returns:
            The other detector.

        Raises:
            ValueError: if the strength is negative or not finite.
        """
        if not 0 <= strength < math.inf:
            raise ValueError(f"strength must be a number of at least 0, got {strength}")
        shares = {name: min(1.0, strength * getattr(self, name)) for name in SHARES}
        return dataclasses.replace(
            self, boundary=strength * self.boundary, blobs=strength * self.blobs, **shares
        )


REGIMES: Mapping[str, Failures] = {
    "clean": Failures(),
    "boundary": Failures(boundary=4.0),
    "misses": Failures(misses=0.4),
    "blobs": Failures(blobs=2.0),
    "consistent": Failures(decoy=0.6),
    "inverted": Failures(inverted=0.25),
    "mixture": Failures(boundary=3.0, misses=0.25, blobs=0.5, decoy=0.5, inverted=0.1),
}
"""The reported detectors: one failure each, and a mixture of all."""

PROFILES: Mapping[str, Failures] = {
    "picks the wrong side": Failures(inverted=0.4, boundary=1.0, softness=0.3),
    "coarse patches": Failures(boundary=9.0, misses=0.1, softness=8.0),
    "over-eager": Failures(boundary=2.0, blobs=3.0, blob_size=0.06, decoy=0.8),
    "shy": Failures(boundary=2.0, misses=0.65, softness=3.0),
}
"""Detectors with a character, called by what they do: one that splits the image sharply in two and
names the parts at random, one that classifies patches, one that flags too much, one too little."""


def calibrated(
    failures: Failures,
    score: Callable[[Failures], float],
    *,
    low: float = 0.1,
    high: float = 0.4,
    strengths: Sequence[float] = STRENGTHS,
) -> Failures:
    """A detector as bad as real ones: scaled until the naive method scores as theirs does.

    Args:
        failures: The detector to scale.
        score: F1 of the naive inverse projection, under masks simulated with such failures. Asked
            from the strength next to 1 outwards, and no more once one fits.
        low: Least F1 that fits.
        high: Greatest F1 that fits.
        strengths: What is tried, all above 0.

    Returns:
        The failures at the strength nearest to 1, as a ratio, whose score fits; of two equally
        near the weaker. If none fits, those whose score comes nearest.

    Raises:
        ValueError: if there are no such strengths, the bounds are not in order, or a score is NaN.
    """
    if not (len(strengths) and min(strengths) > 0 and low <= high):
        raise ValueError(
            f"expected strengths above 0 and low <= high, got {strengths}, {low} and {high}"
        )
    missed = {}
    # Rounded, so that 0.5 and 2 are equally near whatever their logarithms round to.
    for strength in sorted(strengths, key=lambda s: (round(abs(math.log(s)), 9), s)):
        f1 = score(failures.scaled(strength))
        if math.isnan(f1):
            raise ValueError(f"the score at strength {strength} is NaN; is any view tampered?")
        missed[strength] = max(low - f1, f1 - high, 0.0)
        if not missed[strength]:
            break
    return failures.scaled(min(missed, key=missed.__getitem__))


def simulate(
    truth: np.ndarray,
    decoy: np.ndarray | None = None,
    *,
    seed: int,
    failures: Failures,
) -> np.ndarray:
    """What a detector with these failures says about each view.

    Shares of views are met exactly, up to rounding; chance decides which views.

    Args:
        truth: Where something is tampered, shape (V, H, W) bool.
        decoy: Masks of an authentic region that looks suspicious, shape (V, H, W) bool.
        seed: What chance follows.
        failures: Strengths of the failures.

    Returns:
        Probabilities of tampering in [0, 1], shape (V, H, W) float32.

    Raises:
        ValueError: if the shapes differ, or the decoy is wanted and not given.
    """
    if truth.ndim != 3:
        raise ValueError(f"truth must have shape (V, H, W), got {truth.shape}")
    if decoy is None and failures.decoy > 0:
        raise ValueError("failures.decoy > 0 needs the masks of a decoy region, got None")
    if decoy is not None and decoy.shape != truth.shape:
        raise ValueError(f"decoy has shape {decoy.shape}, expected that of truth, {truth.shape}")
    rng = np.random.default_rng(seed)
    missed = _chosen(_views_with(truth), failures.misses, rng)
    regions = truth & ~missed[:, None, None]
    if decoy is not None:
        regions |= decoy & _chosen(_views_with(decoy), failures.decoy, rng)[:, None, None]
    inverted = _chosen(np.ones(len(truth), bool), failures.inverted, rng)
    views = [_respond(region, failures, rng) for region in regions]
    flagged = np.stack(views) if views else np.zeros(truth.shape)
    return np.where(inverted[:, None, None], 1 - flagged, flagged).astype(np.float32)


def decoy_labels(gaussians: Gaussians, labels: np.ndarray, *, seed: int) -> np.ndarray:
    """A compact authentic region apart from the object, for a detector to be wrong about.

    The region has at most as many Gaussians as the object and is not larger. It lies near, where
    the cameras that see the object look; of a few places that chance proposes there, the one with
    most Gaussians is taken, so that it is a thing rather than air.

    Args:
        gaussians: N Gaussians.
        labels: True where tampered, shape (N,).
        seed: What chance follows.

    Returns:
        True in the region, shape (N,) bool.

    Raises:
        ValueError: if nothing is tampered, or no opaque Gaussian lies apart from the object.
    """
    from scipy.spatial import KDTree

    if not labels.any():
        raise ValueError("labels mark no Gaussian, so there is no object to match in size")
    means = np.asarray(gaussians.means)
    middle = np.median(means[labels], axis=0)
    distance = np.linalg.norm(means - middle, axis=1)
    # A quantile: pasted objects drag a few stray Gaussians along.
    radius = np.quantile(distance[labels], 0.9)
    opaque = np.asarray(gaussians.opacities) > 0.5
    eligible = np.flatnonzero(~labels & opaque & (distance > 2.5 * radius))
    if not eligible.size:
        raise ValueError("no opaque authentic Gaussian lies further than 2.5 radii from the object")
    near = eligible[np.argsort(distance[eligible])[: len(eligible) // 10 + 1]]
    places = means[np.random.default_rng(seed).choice(near, 8)]
    authentic = np.flatnonzero(~labels)
    tree = KDTree(means[authentic])
    crowd = tree.query_ball_point(places, radius, return_length=True)
    wanted = min(int(labels.sum()), int(crowd.max()))
    _, nearest = tree.query(places[np.argmax(crowd)], k=wanted)
    region = np.zeros(len(labels), bool)
    region[authentic[np.atleast_1d(nearest)]] = True
    return region


def _views_with(masks: np.ndarray) -> np.ndarray:
    return np.asarray(masks.any(axis=(1, 2)))


def _chosen(among: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """A random share of the views in `among`, shape (V,) bool."""
    views = np.flatnonzero(among)
    picked = np.zeros(len(among), bool)
    picked[rng.permutation(views)[: round(share * len(views))]] = True
    return picked


def _respond(region: np.ndarray, failures: Failures, rng: np.random.Generator) -> np.ndarray:
    """Probabilities for one view in which these pixels are flagged."""
    from scipy.special import expit

    distance = _signed_distance(region)
    for _ in range(rng.poisson(failures.blobs)):
        distance = np.maximum(distance, _blob(region.shape, failures.blob_size, rng))
    if failures.boundary > 0:
        distance = distance + failures.boundary * _smooth_noise(
            region.shape, 3 * failures.boundary, rng
        )
    return expit(distance / failures.softness) if failures.softness else (distance > 0) * 1.0


def _signed_distance(region: np.ndarray) -> np.ndarray:
    """Pixels to the edge of a region, positive inside; the diagonal where there is no edge."""
    from scipy.ndimage import distance_transform_edt

    if region.all() or not region.any():
        return np.where(region, 1.0, -1.0) * np.hypot(*region.shape)
    inside, outside = (np.asarray(distance_transform_edt(side)) for side in (region, ~region))
    return np.where(region, inside - 0.5, 0.5 - outside)


def _blob(shape: tuple[int, int], size: float, rng: np.random.Generator) -> np.ndarray:
    """About the signed distance of a random ellipse somewhere in the image."""
    radius = size * np.hypot(*shape) * rng.lognormal(0, 0.4)
    stretch, angle = rng.uniform(1, 2), rng.uniform(0, np.pi)
    y, x = np.indices(shape) + 0.5 - rng.uniform(0, shape)[:, None, None]
    along = (np.cos(angle) * x + np.sin(angle) * y) / np.sqrt(stretch)
    across = (np.cos(angle) * y - np.sin(angle) * x) * np.sqrt(stretch)
    return radius - np.hypot(along, across)


def _smooth_noise(shape: tuple[int, int], reach: float, rng: np.random.Generator) -> np.ndarray:
    """Gaussian noise of about unit variance that is correlated over `reach` pixels."""
    from scipy.ndimage import gaussian_filter

    noise = gaussian_filter(rng.normal(size=shape), reach, mode="wrap")
    # Averaging over an area of 4 pi reach^2 pixels divides the variance by it.
    return noise * np.sqrt(4 * np.pi) * reach
