"""Checks whether masks can be evidence of an edit, and reasons why they are none.

Masks are none if all are the same, if they follow a simple property of the images such as the
brightness, or if no region of the scene explains them.
"""

import numpy as np

from gsc_jax.evidence.lifting import EvidenceOfViews
from gsc_jax.evidence.observation import Observation
from gsc_jax.render.projection import NEAR
from gsc_jax.scene import Camera
from gsc_jax.scene.gaussians import filled_up
from gsc_jax.scene.parallel import map_views
from gsc_jax.splat import render

CHECKED = 6
"""Views that are compared with their masks."""
MIN_ACCURACY = 0.98
"""Balanced accuracy from which a threshold on a property explains masks; those of edits have less
(experiments/mask_checks.py)."""
MIN_CORRELATION = 0.1
"""Correlation below which the masks of other views say nothing about those of a view: that of false
blobs is mostly lower, that of the mixture of all failures higher."""
STRIDE = 2
"""Pixels from one to the next that is compared, along rows and columns."""
FULL_VIEW = 0.2
"""A view shows a region if it sees more than this share of what the best view sees of it."""
QUANTILES = 64
"""Thresholds that are tried."""


def properties(image: np.ndarray) -> dict[str, np.ndarray]:
    """Simple properties of the pixels of an image (H, W, 3) in [0, 1], by name, each (H, W)."""
    high, low = image.max(axis=-1), image.min(axis=-1)
    brightness = image.mean(axis=-1)
    named = dict(zip(("red", "green", "blue"), np.moveaxis(image, -1, 0), strict=True))
    named |= {"brightness": brightness, "saturation": (high - low) / np.maximum(high, 1e-6)}
    return named | {"edges": np.hypot(*np.gradient(brightness))}


def doubts(
    observation: Observation, region: np.ndarray | None = None, *, near: float = NEAR
) -> list[str]:
    """Reasons why masks are no evidence of an edit of a region, (N,) bool, as sentences."""
    found = []
    if same_pixels(observation):
        found.append(
            "The masks flag the same pixels in every view, though the views differ. They are no "
            "evidence of an edit; use another detector."
        )
    if (best := best_property(observation, near=near))[1] >= MIN_ACCURACY:
        found.append(
            f"The masks follow the {best[0]} of the images: one threshold on it separates what "
            "they flag in all views. They are no evidence of an edit; use another detector."
        )
    agreed = agreement(observation.evidence)
    some = region is not None and region.any()  # of which few views may show anything
    if some and agreed is not None and agreed < MIN_CORRELATION:
        agreed = max(agreed, agreement(observation.evidence, region) or 0.0)
    if agreed is not None and agreed < MIN_CORRELATION:
        found.append(
            f"The masks of different views flag the same Gaussians hardly more often than chance "
            f"would (correlation {agreed:.2f}). They are no evidence of an edit; are they of these "
            "cameras and of this scene?"
        )
    return found


def same_pixels(observation: Observation) -> bool:
    """Whether three or more masks are the same, and partly flagged, although the cameras differ."""
    centers = np.stack([np.asarray(camera.center) for camera in observation.cameras])
    masks = (np.asarray(observation.masks[camera.name], bool) for camera in observation.cameras)
    first = next(masks)
    differ = len(centers) > 2 and np.ptp(centers, axis=0).max() > 0
    return differ and 0 < first.mean() < 1 and all(np.array_equal(first, mask) for mask in masks)


def best_property(observation: Observation, *, near: float = NEAR) -> tuple[str, float]:
    """Property, such as brightness, that best predicts `CHECKED` masks that flag a part of a view.

    Returns its name and the balanced accuracy of one threshold; "" and 0 for fewer than two masks.
    """
    gaussians = filled_up(observation.gaussians)

    def mask(camera: Camera) -> np.ndarray:
        return np.asarray(observation.masks[camera.name], bool)[::STRIDE, ::STRIDE].ravel()

    partly = [camera for camera in observation.cameras if 0.001 < mask(camera).mean() < 0.999]
    chosen = partly[:: max(1, -(-len(partly) // CHECKED))]
    if len(chosen) < 2:
        return "", 0.0

    def compared(camera: Camera) -> dict[str, np.ndarray]:
        maps = properties(np.asarray(render(gaussians, camera, near=near)[0]))
        return {name: pixels[::STRIDE, ::STRIDE].ravel() for name, pixels in maps.items()}

    views = list(map_views(compared, chosen, gaussians=len(gaussians)))
    pixels = {name: np.concatenate([view[name] for view in views]) for name in views[0]}
    flagged = np.concatenate([mask(camera) for camera in chosen])
    accuracies = {name: separation(values, flagged) for name, values in pixels.items()}
    best = max(accuracies, key=accuracies.__getitem__)
    return best, accuracies[best]


def separation(values: np.ndarray, flagged: np.ndarray) -> float:
    """Largest balanced accuracy of a threshold, up or down, on values (P,) for flags (P,) bool."""
    inside, outside = np.sort(values[flagged]), np.sort(values[~flagged])
    levels = np.unique(np.quantile(inside, np.linspace(0, 1, QUANTILES)))
    below = [np.searchsorted(part, levels) / len(part) for part in (inside, outside)]
    return float(0.5 + 0.5 * np.abs(below[1] - below[0]).max())


def agreement(evidence: EvidenceOfViews, region: np.ndarray | None = None) -> float | None:
    """How well masks agree through the scene: the correlation of each view with all others.

    The share of the weight of a Gaussian that a view flags is compared with the share that all
    other views flag, weighted by its weight in the view. The median of the absolute correlations of
    up to four times `CHECKED` views, since inverted masks agree, too; with a region, (N,) bool, of
    those that show it. That is higher if the region was chosen by the same masks. None if hardly a
    view varies.
    """
    total, tampered, found = *np.zeros((2, evidence.shape[1])), []
    shows = np.ones(evidence.shape[0])
    for index, view in enumerate(evidence.views()):
        total += np.asarray(view.total)
        tampered += np.asarray(view.tampered)
        shows[index] = 1.0 if region is None else np.asarray(view.total)[region].sum()
    showing = np.flatnonzero(shows > FULL_VIEW * shows.max())
    for index in showing[:: max(1, len(showing) // (4 * CHECKED))].tolist():
        view = evidence.view(index)
        weight, own = np.asarray(view.total, float), np.asarray(view.tampered, float)
        rest = total - weight
        if (both := (weight > 0) & (rest > 0)).sum() < 2:
            continue
        here, there = own[both] / weight[both], (tampered - own)[both] / rest[both]
        covariance = np.cov(here, there, aweights=weight[both])
        if min(np.diag(covariance)) > 1e-6:
            found.append(abs(covariance[0, 1]) / np.sqrt(covariance[0, 0] * covariance[1, 1]))
    return float(np.median(found)) if len(found) > 2 else None
