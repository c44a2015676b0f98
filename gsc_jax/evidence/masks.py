"""From the attribute to scores, and from labels to the mask of a view.

The attribute is unbounded and has no unit, so it is divided by its largest value in the whole
scene. The released code divides by the maximum of each view instead, which lifts noise to 1 in
views without the object; that rule is available as `per-view` for comparison.
"""

import dataclasses
import typing
from collections.abc import Callable, Sequence
from typing import Any, Literal, NamedTuple, Protocol

import jax
import jax.numpy as jnp
import numpy as np
import skimage  # whose submodules load when they are first used
from jax.core import Tracer

from gsc_jax.evidence.monitor import Monitor
from gsc_jax.evidence.storage import ArrayStore, ByView
from gsc_jax.render.projection import NEAR
from gsc_jax.render.spherical_harmonics import colors
from gsc_jax.render.tiles import make_view
from gsc_jax.scene import Array, Camera, Gaussians
from gsc_jax.scene.errors import BELOW_1, in_range
from gsc_jax.scene.gaussians import transparent_rows
from gsc_jax.scene.parallel import map_views
from gsc_jax.splat import composite_with_alpha, require_finite

MaskRule = Literal["share", "attribute", "per-view"]
MIN_COVERAGE = 0.1
"""Least alpha of a pixel in a mask: the truth in shared test data and experiments uses it, too."""

MASK, RENDER, SCORE = "mask", "render", "score"
"""Kinds of what `pictures` computes in a store."""


class Scored(Protocol):
    """Scores `tamper` in [0, 1] and boolean `labels` of N Gaussians, shapes (N,)."""

    @property
    def tamper(self) -> np.ndarray: ...  # noqa: D102

    @property
    def labels(self) -> np.ndarray: ...  # noqa: D102


class Labelled(NamedTuple):
    """Scores and labels as arrays, for `view_mask`."""

    tamper: np.ndarray
    labels: np.ndarray


def filled_scores(scored: Scored) -> Labelled:
    """Scores and labels of a scene that is `filled_up`: 0 and false for the transparent rows."""
    more = (0, transparent_rows(len(scored.labels)))
    return Labelled(np.pad(scored.tamper, more), np.pad(scored.labels, more))


def normalise(attribute: Array) -> jax.Array:
    """Divide an attribute (N,) by its maximum, clipped to [0, 1]; all 0 if none is positive."""
    attribute = jnp.asarray(attribute)
    largest = jnp.max(attribute, initial=0.0)
    return jnp.maximum(attribute, 0.0) / jnp.where(largest > 0, largest, 1.0)


def view_mask(
    gaussians: Gaussians,
    camera: Camera,
    scored: Scored,
    *,
    rule: MaskRule = "attribute",
    threshold: float = 0.1,
    near: float = NEAR,
) -> np.ndarray:
    """Compute the mask of a view from scores and labels.

    Args:
        gaussians: N Gaussians.
        camera: The view.
        scored: Scores `tamper` and `labels` of the Gaussians, shapes (N,): a finding or a result.
        rule: `attribute`: the rendered score, relative to alpha, exceeds the threshold. `share`:
            labelled Gaussians contribute more than half of a pixel's weight. `per-view`, the rule
            of the released code: the score rendered from labelled Gaussians only, relative to its
            maximum in the view, exceeds the threshold.
        threshold: Threshold of the rules `attribute` and `per-view`.
        near: Near plane in world units.

    Returns:
        Boolean, shape (H, W); false where the scene is transparent.

    Raises:
        ValueError: if the rule is unknown, the threshold outside [0, 1), or `near` not positive.
    """
    if rule not in (known := typing.get_args(MaskRule)):
        raise ValueError(f"rule must be one of {', '.join(known)}, got {rule!r}")
    if not in_range(threshold, 0.0, BELOW_1):
        raise ValueError(f"threshold must be in [0, 1), got {threshold!r}")
    if rule == "per-view":
        return _per_view_mask(gaussians, camera, scored, threshold=threshold, near=near)
    if rule == "share":
        return rendered_share(gaussians, camera, scored.labels, near=near) > 0.5
    return rendered_share(gaussians, camera, scored.tamper, near=near, above=threshold) > threshold


def pictures(
    gaussians: Gaussians,
    camera: Camera,
    scored: Scored,
    *,
    rule: MaskRule,
    threshold: float,
    near: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Render a view once: its mask (see `view_mask`), RGB of 8 bits, (H, W, 3), scores, (H, W)."""
    features = jnp.stack([jnp.asarray(scored.labels, jnp.float32), scored.tamper], axis=1)
    rgb = colors(gaussians.sh, gaussians.means, camera.center)
    view = make_view(gaussians, camera, near=near)
    # In NumPy from here: JAX would compile these steps for each image size.
    blended = composite_with_alpha(view, jnp.concatenate([features, rgb], axis=1))
    image, alpha = map(np.asarray, blended)
    share, score = _share(image, alpha), _share(image, alpha, channel=1)
    mask = share > 0.5 if rule == "share" else score > threshold
    if rule == "per-view":
        mask = _per_view_mask(gaussians, camera, scored, threshold=threshold, near=near)
    return mask, skimage.util.img_as_ubyte(np.minimum(image[..., 2:], 1.0)), score


def stored_masks(
    compute: Callable[[Camera], np.ndarray | tuple[np.ndarray, ...]],
    cameras: Sequence[Camera],
    store: ArrayStore,
    monitor: Monitor,
    *,
    gaussians: int = 0,
) -> ByView:
    """Put the mask of every view, or its `pictures`, into the store; return the masks."""

    def put(camera: Camera) -> None:
        with monitor.stage("masks"):
            found = compute(camera)
            arrays = found if isinstance(found, tuple) else (found,)
            for kind, array in zip((MASK, RENDER, SCORE), arrays, strict=False):
                store.put(kind, camera.name, array)

    for done, _ in enumerate(map_views(put, cameras, gaussians=gaussians), start=1):
        monitor.progress("masks", done, len(cameras))
    return ByView(tuple(c.name for c in cameras), lambda name: np.array(store.get(MASK, name)))


def rendered_share(
    gaussians: Gaussians,
    camera: Camera,
    feature: Array,
    *,
    near: float = NEAR,
    above: float | None = None,
) -> np.ndarray:
    """Render the weighted mean of a feature; `jax.grad` works for the feature and the Gaussians.

    Args:
        gaussians: N Gaussians.
        camera: The view.
        feature: A number per Gaussian, shape (N,).
        near: Near plane in world units.
        above: Leave tiles at 0 where no Gaussian exceeds this; traced features ignore it.

    Returns:
        Mean of the feature by blending weight, shape (H, W); 0 where alpha is 0.1 or less.

    Raises:
        ValueError: if the feature has not N numbers, or one is not finite.
    """
    feature = require_finite("feature", jnp.asarray(feature, jnp.float32))
    if feature.shape != (len(gaussians),):
        raise ValueError(f"feature must have shape ({len(gaussians)},), got {feature.shape}")
    chosen = None
    if not isinstance(feature, Tracer):
        values = np.asarray(feature)
        # A mean exceeds the largest value by a rounding error only.
        chosen = values != 0 if above is None else values > above - abs(above) / 100
    view = make_view(gaussians, camera, near=near, touching=chosen)
    return _share(*composite_with_alpha(view, feature[:, None]))


def _share(image: Array, alpha: Array, channel: int = 0) -> Any:
    numpy: Any = jnp if isinstance(image, Tracer) else np
    blended, alpha = numpy.asarray(image)[..., channel], numpy.asarray(alpha)
    covered = alpha > MIN_COVERAGE
    return numpy.where(covered, blended / numpy.where(covered, alpha, 1.0), 0.0)


def _per_view_mask(
    gaussians: Gaussians, camera: Camera, scored: Scored, *, threshold: float, near: float
) -> np.ndarray:
    tamper = require_finite("tamper", jnp.asarray(scored.tamper))
    # Removing the other Gaussians would change N and recompile everything for every result.
    logits = jnp.where(jnp.asarray(scored.labels), gaussians.logit_opacities, -jnp.inf)
    view = make_view(dataclasses.replace(gaussians, logit_opacities=logits), camera, near=near)
    image = composite_with_alpha(view, tamper[:, None])[0][..., 0]
    return np.asarray(image > threshold * jnp.max(image))
