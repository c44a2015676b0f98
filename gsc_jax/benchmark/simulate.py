"""Simulated 2D detectors: the truth of each view, with named failures.

A mask is represented by its signed distance in pixels, positive inside: regions unite by the
maximum, smooth noise makes edges ragged, and a logistic function turns distance into probability.
Without failures, probability > 0.5 is exactly the truth.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
import scipy  # whose submodules load when they are first used
from scipy.spatial import KDTree
from scipy.special import expit

from gsc_jax.scene import Gaussians
from gsc_jax.scene.errors import check_ranges

SHARES = "misses", "decoy", "inverted"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Failures:
    """Strengths of the failures of a 2D detector.

    Attributes:
        boundary: Standard deviation of the position of edges in pixels.
        misses: Share of the views with the object in which it is missed.
        blobs: Expected number of false blobs per view, independent between views.
        blob_size: Median radius of a blob as a share of the image diagonal.
        decoy: Share of the views with the decoy, an authentic region, in which it is flagged.
        inverted: Share of the views in which the complement is returned.
        softness: Pixels over which the probability changes at an edge; 0 gives zeros and ones.
    """

    boundary: float = 0.0
    misses: float = 0.0
    blobs: float = 0.0
    blob_size: float = 0.05
    decoy: float = 0.0
    inverted: float = 0.0
    softness: float = 1.5

    def __post_init__(self) -> None:
        check_ranges(self, {key: (0.0, 1.0 if key in SHARES else np.inf) for key in vars(self)})


REGIMES: Mapping[str, Failures] = {
    "clean": Failures(),
    "boundary": Failures(boundary=4.0),
    "misses": Failures(misses=0.4),
    "blobs": Failures(blobs=2.0),
    "consistent": Failures(decoy=0.6),
    "inverted": Failures(inverted=0.25),
    "mixture": Failures(boundary=3.0, misses=0.25, blobs=0.5, decoy=0.5, inverted=0.1),
}
"""The reported settings: each failure alone, and a mixture of all."""


def simulate(
    truth: np.ndarray, decoy: np.ndarray | None = None, *, seed: int, failures: Failures
) -> np.ndarray:
    """Probability maps (V, H, W) of a detector with these failures, float32.

    Shares of views are exact up to rounding; which views fail is random. Truth and decoy, an
    authentic region that is flagged, are masks (V, H, W). ValueError if a needed decoy is missing.
    """
    truth, decoy = np.asarray(truth, bool), None if decoy is None else np.asarray(decoy, bool)
    if truth.ndim != 3:
        raise ValueError(f"truth must have shape (V, H, W), got {truth.shape}")
    if decoy is None and failures.decoy > 0:
        raise ValueError("failures.decoy > 0 needs the masks of a decoy region, got None")
    if decoy is not None and decoy.shape != truth.shape:
        raise ValueError(f"decoy has shape {decoy.shape}, expected that of truth, {truth.shape}")
    rng = np.random.default_rng(seed)
    missed = _random_share(np.array(truth.any(axis=(1, 2))), failures.misses, rng)
    regions = truth & ~missed[:, None, None]
    if decoy is not None:
        flagged_views = _random_share(np.array(decoy.any(axis=(1, 2))), failures.decoy, rng)
        regions |= decoy & flagged_views[:, None, None]
    inverted = _random_share(np.ones(len(truth), bool), failures.inverted, rng)
    flagged = np.reshape([_probabilities(region, failures, rng) for region in regions], truth.shape)
    return np.where(inverted[:, None, None], 1 - flagged, flagged).astype(np.float32)


def decoy_labels(gaussians: Gaussians, labels: np.ndarray, *, seed: int) -> np.ndarray:
    """Label a compact authentic region (N,) apart from the object that a detector may flag.

    The region has at most as many Gaussians as the object and is not larger. It lies near the
    object, where its cameras look; of a few random places, the one with most Gaussians is taken.
    If nothing is tampered, or no opaque Gaussian lies apart from the object, raises ValueError.
    """
    labels = np.asarray(labels, bool)
    if not labels.any():
        raise ValueError("labels mark no Gaussian, so there is no object to match in size")
    means = np.asarray(gaussians.means)
    distance = np.linalg.norm(means - np.median(means[labels], axis=0), axis=1)
    # A quantile, since pasted objects contain a few stray Gaussians.
    radius = np.quantile(distance[labels], 0.9)
    opaque = np.asarray(gaussians.opacities) > 0.5
    eligible = np.flatnonzero(~labels & opaque & (distance > 2.5 * radius))
    if not eligible.size:
        raise ValueError("no opaque authentic Gaussian lies further than 2.5 radii from the object")
    near = eligible[np.argsort(distance[eligible])[: len(eligible) // 10 + 1]]
    places = means[np.random.default_rng(seed).choice(near, 8)]
    authentic = np.flatnonzero(~labels)
    tree = KDTree(means[authentic])
    counts = tree.query_ball_point(places, radius, return_length=True)
    _, nearest = tree.query(places[np.argmax(counts)], k=min(int(labels.sum()), int(counts.max())))
    return np.isin(np.arange(len(labels)), authentic[nearest])


def _random_share(among: np.ndarray, share: float, rng: np.random.Generator) -> np.ndarray:
    """Mask of a random share of the views in `among`, shape (V,) bool."""
    views = np.flatnonzero(among)
    return np.isin(np.arange(len(among)), rng.permutation(views)[: round(share * len(views))])


def _probabilities(region: np.ndarray, failures: Failures, rng: np.random.Generator) -> np.ndarray:
    """Probability map of a view in which this region is flagged, blobs and rough edges added."""
    distance = _signed_distance(region)
    for _ in range(rng.poisson(failures.blobs)):
        distance = np.maximum(distance, _blob(region.shape, failures.blob_size, rng))
    if failures.boundary > 0:
        length = 3 * failures.boundary
        noise = scipy.ndimage.gaussian_filter(rng.normal(size=region.shape), length, mode="wrap")
        # Averaging over an area of 4 pi length^2 pixels divides the variance by it.
        distance = distance + failures.boundary * (noise * np.sqrt(4 * np.pi) * length)
    return expit(distance / failures.softness) if failures.softness else (distance > 0) * 1.0


def _signed_distance(region: np.ndarray) -> np.ndarray:
    """Distance to the edge of a region in pixels, positive inside; the diagonal without edge."""
    if region.all() or not region.any():
        return np.where(region, 1.0, -1.0) * np.hypot(*region.shape)
    distance = scipy.ndimage.distance_transform_edt
    inside, outside = (np.asarray(distance(side)) for side in (region, ~region))
    return np.where(region, inside - 0.5, 0.5 - outside)


def _blob(shape: tuple[int, int], size: float, rng: np.random.Generator) -> np.ndarray:
    """Approximate signed distance of a random ellipse."""
    radius = size * np.hypot(*shape) * rng.lognormal(0, 0.4)
    stretch, angle = rng.uniform(1, 2), rng.uniform(0, np.pi)
    y, x = np.indices(shape) + 0.5 - rng.uniform(0, shape)[:, None, None]
    along = (np.cos(angle) * x + np.sin(angle) * y) / np.sqrt(stretch)
    across = (np.cos(angle) * y - np.sin(angle) * x) * np.sqrt(stretch)
    return radius - np.hypot(along, across)
