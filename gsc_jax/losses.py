"""The losses of GS-Checker: 2D rendering loss, 3D contrastive loss, and the attributes F.

The released code defines what the paper leaves open (G_h, G_m, G_l). The 3D loss is 0 with zero
gradient where a group is empty; in the released code, the mean over an empty group makes r NaN.
Attributes F have shape (A, N), because XLA on a CPU sums long rows much faster than short columns.
"""

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.evidence.lifting import Evidence
from gsc_jax.scene import Array, Gaussians, pytree
from gsc_jax.scene.statistics import median_and_mad

MAX_ABS_LOGIT = 20.0
"""Bound of logit opacities (float32 sigmoid saturates beyond 17), and of log scales from below
(exp(-20) is 0 for any scene): files may contain infinite values."""


def loss_2d(
    rendered: Array, mask: Array, *, lambda1: float = 1.0, lambda2: float = 10.0
) -> jax.Array:
    """Compute the 2D rendering loss L_2d of a view, summed over its pixels (GS-Checker, eq. 10).

    The rendered attribute M^R and the mask M in [0, 1] have shape (H, W); lambda1 and lambda2 are
    the weights inside and outside the mask.
    """
    mask = jnp.asarray(mask, jnp.float32)
    return jnp.sum((lambda2 * (1.0 - mask) - lambda1 * mask) * rendered)


def loss_2d_from_evidence(
    r: Array, evidence: Evidence, *, lambda1: float = 1.0, lambda2: float = 10.0
) -> jax.Array:
    """Compute `loss_2d` (eq. 10) of an attribute r, (N,), from the evidence of a view, (N,) each.

    The loss is linear in r, and the evidence gives its coefficients, so nothing is rendered.
    """
    authentic = evidence.total - evidence.tampered
    return jnp.vdot(lambda2 * authentic - lambda1 * evidence.tampered, r)


@pytree
class Partition:
    """The groups G_h, G_m and G_l of the contrastive loss, boolean, shapes (N,)."""

    high: Array
    middle: Array
    low: Array


def partition(r: Array) -> Partition:
    """Group Gaussians by their attribute r, shape (N,), with the thresholds of the released code.

    A group may be empty, and most Gaussians are in none.
    """
    largest, smallest = jnp.max(r, initial=0.0), jnp.min(r, initial=0.0)
    return Partition(
        high=(r > 0) & (r >= 0.9 * largest),
        middle=(r > 0) & (r <= 0.1 * largest),
        low=(r <= 0) & (r <= 0.9 * smallest),
    )


def sim(attributes: Array, mean: Array) -> jax.Array:
    """Compute sim_i = ||F_i - mean||^2 (GS-Checker, eq. 7), which is small for similar attributes.

    This is the definition; the loss uses `sim_difference`, which tests compare with it.
    The attributes F have shape (A, N), the mean over a group, F^h or F^l, has shape (A,).
    """
    return jnp.sum(jnp.square(attributes - mean[:, None]), axis=0)


def sim_difference(attributes: Array, mean_h: Array, mean_l: Array) -> list[jax.Array]:
    """Compute the terms of sim^l - sim^h (GS-Checker, eq. 7 and 8), one per attribute, (N,) each.

    (F - l)^2 - (F - h)^2 is factored into 2 (F - (h + l) / 2) (h - l), which does not square large
    attributes; a test compares the sum of the terms with `sim`.
    """
    centers, gaps = 0.5 * (mean_h + mean_l), mean_h - mean_l
    return [2.0 * (F - c) * gap for F, c, gap in zip(attributes, centers, gaps, strict=True)]


def direction(attributes: Array, groups: Partition, *, per_feature: bool = False) -> jax.Array:
    """Compute u_i = sign(sim^l_i - sim^h_i) (GS-Checker, eq. 8): 1 where G_h is more similar.

    The attributes F have shape (A, N), u has shape (N,) and is 0 outside G_m, or where a group is
    empty. With `per_feature`, it averages one sign per attribute, as the released code does.
    """
    mean_h, mean_l = (_masked_mean(attributes, group) for group in (groups.high, groups.low))
    terms = sim_difference(attributes, mean_h, mean_l)
    # Adding term by term is fused by XLA; its sum over so short an axis is slow on a CPU.
    signs = [jnp.sign(term) for term in terms]
    u = sum(signs) / len(terms) if per_feature else jnp.sign(sum(terms))
    comparable = jnp.any(groups.high) & jnp.any(groups.low)
    return jnp.where(groups.middle & comparable, u, 0.0)


def loss_3d(
    r: Array, attributes: Array, groups: Partition, *, per_feature: bool = False
) -> jax.Array:
    """Compute the 3D contrastive loss L_3d (GS-Checker, eq. 12) of an attribute r, shape (N,).

    It is -mean of u_i r_i over G_m, with u from `direction` held constant; 0 for an empty group.
    """
    u = jax.lax.stop_gradient(direction(attributes, groups, per_feature=per_feature))
    return -jnp.vdot(u, r) / jnp.maximum(jnp.sum(groups.middle, dtype=r.dtype), 1.0)


def _masked_mean(values: Array, mask: Array) -> jax.Array:
    """Mean of the masked columns, shape (A,); 0 for an empty mask."""
    weights = jnp.asarray(mask, values.dtype)
    return jnp.matmul(values, weights, precision="highest") / jnp.maximum(jnp.sum(weights), 1.0)


def paper_attributes(gaussians: Gaussians) -> jax.Array:
    """Attributes F of the paper, shape (11 + 3 K, N): position, SH, opacity, scale, rotation.

    In raw units: the attribute with the largest unit dominates. 0 where not finite.
    """
    sh = jnp.reshape(gaussians.sh, (len(gaussians), 3 * gaussians.sh.shape[1]))
    return _raw_attributes(gaussians, sh)


def official_attributes(gaussians: Gaussians) -> jax.Array:
    """Attributes F of the released code, shape (14, N): of the SH only the DC term."""
    return _raw_attributes(gaussians, jnp.asarray(gaussians.sh)[:, 0])


def _raw_attributes(gaussians: Gaussians, color: jax.Array) -> jax.Array:
    opacities = gaussians.opacities[:, None]
    columns = [gaussians.means, color, opacities, gaussians.scales, gaussians.rotations]
    attributes = jnp.concatenate(columns, axis=1).T
    # Rows with such values are mostly invisible, but 0 * NaN would spoil the mean of a group.
    return jnp.where(jnp.isfinite(attributes), attributes, 0.0)


def standardised_attributes(gaussians: Gaussians) -> np.ndarray:
    """Attributes F standardised by median and MAD, shape (14, N); not in the paper.

    Position, DC colour, logit opacity, log scale, and the quaternion with w >= 0, since q and -q
    are one rotation. 0 where not finite, and in attributes that do not vary.
    """
    host = jax.tree.map(np.asarray, gaussians)
    rotations = np.asarray(gaussians.rotations)
    rotations = np.where(rotations[:, :1] < 0, -rotations, rotations)
    logits = np.clip(host.logit_opacities, -MAX_ABS_LOGIT, MAX_ABS_LOGIT)[:, None]
    log_scales = np.maximum(host.log_scales, -MAX_ABS_LOGIT)
    raw = np.concatenate([host.means, host.sh[:, 0], logits, log_scales, rotations], axis=1).T
    # In NumPy, because a median is a sort, which is ten times slower in XLA on a CPU.
    center, spread = median_and_mad(raw[:, np.isfinite(raw).all(axis=0)], axis=1)
    scaled = (raw - center) / np.where(spread > 0, spread, 1.0)
    return np.where((spread > 0) & np.isfinite(scaled), scaled, np.float32(0))
