"""The losses of GS-Checker: the 2D rendering loss, the 3D contrastive loss, and what they compare.

Equation numbers are those of the paper. Where its text leaves a definition open (G_h, G_m, G_l, the
attributes F), the released code's definition is used for both. A mean over an empty group does not
exist; the 3D loss is then 0 with zero gradient, where the released code puts NaN into r and Adam.

Attributes F have a row each, (A, N), because XLA on a CPU sums long rows many times faster than
short columns.
"""

import functools

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.evidence.lifting import Evidence
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Array, Gaussians, pytree
from gsc_jax.scene.statistics import median_and_mad


def loss_2d(
    rendered: Array, mask: Array, *, lambda1: float = 1.0, lambda2: float = 10.0
) -> jax.Array:
    """The 2D rendering loss L_2d of a view (eq. 10).

    Args:
        rendered: Rendered attribute M^R, shape (H, W).
        mask: Tampered pixels M, in [0, 1], shape (H, W).
        lambda1: Reward for attribute inside the mask.
        lambda2: Price of attribute outside the mask.

    Returns:
        The loss summed over the pixels, scalar; unbounded below.
    """
    mask = jnp.asarray(mask, jnp.float32)
    return jnp.sum((lambda2 * (1.0 - mask) - lambda1 * mask) * rendered)


def loss_2d_from_evidence(
    r: Array, evidence: Evidence, *, lambda1: float = 1.0, lambda2: float = 10.0
) -> jax.Array:
    """The same loss without rendering: linear in r, with the evidence for coefficients.

    Args:
        r: Attribute, shape (N,).
        evidence: What one view says, shapes (N,).
        lambda1: As in `loss_2d`.
        lambda2: As in `loss_2d`.

    Returns:
        The loss of that view, scalar.
    """
    authentic = evidence.total - evidence.tampered
    return jnp.vdot(lambda2 * authentic - lambda1 * evidence.tampered, r)


@pytree
class Partition:
    """The groups G_h, G_m and G_l that the contrast is between, boolean, shapes (N,)."""

    high: Array
    middle: Array
    low: Array


def partition(r: Array) -> Partition:
    """Split Gaussians by their attribute, as the released code does.

    Args:
        r: Attribute, shape (N,).

    Returns:
        High: r > 0 and r >= 0.9 max r. Middle: 0 < r <= 0.1 max r. Low: r <= 0 and r <= 0.9 min r.
        What lies between 0.1 and 0.9 of the maximum is in no group; any group may be empty.
    """
    largest, smallest = jnp.max(r), jnp.min(r)
    return Partition(
        high=(r > 0) & (r >= 0.9 * largest),
        middle=(r > 0) & (r <= 0.1 * largest),
        low=(r <= 0) & (r <= 0.9 * smallest),
    )


def direction(attributes: Array, groups: Partition, *, per_feature: bool = False) -> jax.Array:
    """The update direction u_i (eq. 7 and 8): towards the group whose mean is nearer.

    The difference of squares sim_l - sim_h, with sim = (F - mean)^2, is taken as
    2 (F - (mean_h + mean_l) / 2) (mean_h - mean_l), which does not square large attributes.

    Args:
        attributes: What is compared, F, shape (A, N).
        groups: The partition of the N Gaussians.
        per_feature: The released code's variant: a sign per attribute, averaged over them.

    Returns:
        u in [-1, 1], shape (N,); 0 outside the middle group, or where a group is empty.
    """
    mean_h, mean_l = (_masked_mean(attributes, group) for group in (groups.high, groups.low))
    centers, gaps = 0.5 * (mean_h + mean_l), mean_h - mean_l
    nearer_h = [2.0 * (F - c) * gap for F, c, gap in zip(attributes, centers, gaps, strict=True)]
    if per_feature:
        u = _total([jnp.sign(nearer) for nearer in nearer_h]) / len(nearer_h)
    else:
        u = jnp.sign(_total(nearer_h))
    comparable = jnp.any(groups.high) & jnp.any(groups.low)
    return jnp.where(groups.middle & comparable, u, 0.0)


def loss_3d(
    r: Array, attributes: Array, groups: Partition, *, per_feature: bool = False
) -> jax.Array:
    """The 3D contrastive loss L_3d (eq. 12), with the direction held constant.

    Args:
        r: Attribute, shape (N,).
        attributes: What is compared, F, shape (A, N).
        groups: The partition of the N Gaussians.
        per_feature: The released code's variant of the direction.

    Returns:
        -mean of u_i r_i over the middle group, scalar; 0 where a group is empty.
    """
    u = jax.lax.stop_gradient(direction(attributes, groups, per_feature=per_feature))
    return -jnp.vdot(u, r) / jnp.maximum(jnp.sum(groups.middle, dtype=r.dtype), 1.0)


def _masked_mean(values: Array, mask: Array) -> jax.Array:
    """Mean of the masked columns, shape (A,); 0 when there is none."""
    weights = jnp.asarray(mask, values.dtype)
    return jnp.matmul(values, weights, precision="highest") / jnp.maximum(jnp.sum(weights), 1.0)


def _total(rows: list[jax.Array]) -> jax.Array:
    # Term by term: XLA on a CPU fuses this; its own sum over so short an axis is not vectorised.
    return functools.reduce(jnp.add, rows)


def paper_attributes(gaussians: Gaussians) -> jax.Array:
    """The attributes F of the paper, in raw units: mu, opacity, scale, rotation and all of the SH.

    Args:
        gaussians: N Gaussians.

    Returns:
        Shape (11 + 3 K, N), 0 where not finite; the attribute with the largest unit decides.
    """
    return _stack(gaussians, jnp.reshape(gaussians.sh, (len(gaussians), -1)))


def official_attributes(gaussians: Gaussians) -> jax.Array:
    """The attributes F of the released code: as in the paper, but of the SH only the DC colour.

    Args:
        gaussians: N Gaussians.

    Returns:
        Shape (14, N), 0 where not finite.
    """
    return _stack(gaussians, jnp.asarray(gaussians.sh)[:, 0])


def _stack(gaussians: Gaussians, color: jax.Array) -> jax.Array:
    opacities = gaussians.opacities[:, None]
    parts = [gaussians.means, color, opacities, gaussians.scales, gaussians.rotations]
    attributes = jnp.concatenate(parts, axis=1).T
    # Most such rows are seen by no view, but 0 times NaN in the mean of a group would not be 0.
    return jnp.where(jnp.isfinite(attributes), attributes, 0.0)


def standardised_attributes(gaussians: Gaussians) -> np.ndarray:
    """Attributes that can share a norm: stored (unbounded) units, each by its median and MAD.

    Beyond the paper. Log scales and logit opacities (clipped to +-20), the colour, and the rotation
    with the sign that makes w positive, since q and -q are one rotation.

    Args:
        gaussians: N Gaussians.

    Returns:
        Shape (14, N); 0 where it is not finite, and in an attribute that does not vary.
    """
    host = jax.tree.map(np.asarray, gaussians)
    rotations = np.asarray(gaussians.rotations)
    rotations = np.where(rotations[:, :1] < 0, -rotations, rotations)
    logits = np.clip(host.logit_opacities, -20.0, 20.0)[:, None]
    log_scales = np.maximum(host.log_scales, -20.0)
    color = 0.5 + Y0 * host.sh[:, 0]
    raw = np.concatenate([host.means, color, logits, log_scales, rotations], axis=1).T
    # On the host: a median is a sort in XLA, ten times slower.
    usable = raw[:, np.isfinite(raw).all(axis=0)]
    center, spread = median_and_mad(usable, axis=1)
    scaled = (raw - center) / np.where(spread > 0, spread, 1.0)
    return np.where((spread > 0) & np.isfinite(raw), scaled, np.float32(0))
