"""From the attribute to what is handed back: a score and a label per Gaussian, a mask per view.

The attribute is unbounded and its scale means nothing, so it is divided by its largest value in the
whole scene, once; dividing by a view's own maximum, as the released code does, lifts noise to 1 in
views without the object. The released rule is kept as `per-view` so that it can be compared.
"""

import dataclasses
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.render.projection import NEAR
from gsc_jax.render.tiles import make_view, restricted
from gsc_jax.scene import Array, Camera, Gaussians
from gsc_jax.splat import composite_with_alpha

MaskRule = Literal["share", "attribute", "per-view"]
MIN_COVERAGE = 0.1
"""Pixels whose alpha does not exceed this show nothing, so nothing tampered."""


def normalise(attribute: Array) -> jax.Array:
    """The attribute as a score: divided by its largest value, negative values cut off.

    Args:
        attribute: Raw r, shape (N,).

    Returns:
        Scores in [0, 1], shape (N,); all 0 when no attribute is positive.
    """
    attribute = jnp.asarray(attribute)
    largest = jnp.max(attribute, initial=0.0)
    return jnp.maximum(attribute, 0.0) / jnp.where(largest > 0, largest, 1.0)


def view_mask(
    gaussians: Gaussians,
    camera: Camera,
    tamper: Array,
    labels: Array,
    *,
    rule: MaskRule = "attribute",
    threshold: float = 0.1,
    near: float = NEAR,
) -> np.ndarray:
    """The tampered pixels of a view.

    Args:
        gaussians: N Gaussians.
        camera: The view.
        tamper: Scores in [0, 1], shape (N,).
        labels: Tampered Gaussians, boolean, shape (N,).
        rule: `attribute`: the rendered score, relative to alpha, exceeds the threshold. `share`:
            more than half of what a pixel shows is tampered Gaussians. `per-view`, the released
            rule: the tampered Gaussians alone, divided by the maximum of the view.
        threshold: Of the first and the last rule.
        near: Near plane in world units.

    Returns:
        Boolean, shape (H, W); false where the scene is transparent.
    """
    if rule == "per-view":
        return _released_mask(gaussians, camera, tamper, labels, threshold, near)
    feature, level = (labels, 0.5) if rule == "share" else (tamper, threshold)
    return rendered_share(gaussians, camera, feature, near=near) > level


def rendered_share(
    gaussians: Gaussians, camera: Camera, feature: Array, *, near: float = NEAR
) -> np.ndarray:
    """A feature as it shows in a view: its rendered weight relative to alpha.

    Args:
        gaussians: N Gaussians.
        camera: The view.
        feature: A number per Gaussian, shape (N,).
        near: Near plane in world units.

    Returns:
        Weighted mean over what each pixel shows, shape (H, W); 0 where alpha is 0.1 or less.
    """
    feature = jnp.asarray(feature, jnp.float32)
    view = restricted(make_view(gaussians, camera, near=near), np.asarray(feature) != 0)
    image, alpha = composite_with_alpha(view, feature[:, None])
    covered = alpha > MIN_COVERAGE
    return np.asarray(jnp.where(covered, image[..., 0] / jnp.where(covered, alpha, 1.0), 0.0))


def _released_mask(gaussians, camera, tamper, labels, threshold, near) -> np.ndarray:
    # Deleting the others would change N, and with it recompile everything for every result.
    logits = jnp.where(jnp.asarray(labels), gaussians.logit_opacities, -jnp.inf)
    view = make_view(dataclasses.replace(gaussians, logit_opacities=logits), camera, near=near)
    image = composite_with_alpha(view, jnp.asarray(tamper)[:, None])[0][..., 0]
    return np.asarray((image > threshold * jnp.max(image)) & (image > 0))
