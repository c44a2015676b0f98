"""Masks to votes to the initial attribute (GS-Checker, section "Obtaining 3D tampering attribute").

Each view votes on each Gaussian by the pixel its centre falls into: 1 in the tampered region, 0 in
the authentic one, -1 (an abstention) outside the image or behind the camera. The paper knows no
occlusion here, and neither do these functions. The paper says both that abstentions do not count
and that a majority must exceed them; the released code lets them compete. Both readings are here,
as pure functions of the tally.
"""

import jax
import jax.numpy as jnp

from gsc_jax.scene import Array, pytree

TAMPERED, AUTHENTIC, ABSTAIN = 1, 0, -1


@pytree
class Tally:
    """How many views voted what on each of N Gaussians, shapes (N,), int32."""

    tampered: Array
    authentic: Array
    abstained: Array

    def __add__(self, other: "Tally") -> "Tally":
        """The tally of both sets of views."""
        return jax.tree.map(jnp.add, self, other)


@jax.jit
def cast_votes(centers: Array, depths: Array, mask: Array) -> jax.Array:
    """The votes V_ij of one view (GS-Checker, eq. 5).

    Args:
        centers: Projected centres in pixels, the first pixel spanning 0 to 1, shape (N, 2).
        depths: Depths of the centres, shape (N,); not positive means behind the camera.
        mask: Tampered pixels, boolean, shape (H, W).

    Returns:
        1, 0 or -1 per Gaussian, shape (N,), int32. A centre that is not finite abstains.
    """
    height, width = mask.shape
    size = jnp.array([[width, height]], centers.dtype)
    inside = jnp.all((centers >= 0) & (centers < size), axis=-1) & (depths > 0)
    column, row = jnp.where(inside[:, None], centers, 0.0).astype(jnp.int32).T
    return jnp.where(inside, mask[row, column].astype(jnp.int32), ABSTAIN)


def tally(votes: Array) -> Tally:
    """Count the votes of some views.

    Args:
        votes: 1, 0 or -1, shape (V, N).

    Returns:
        The counts per Gaussian; they add up to V.
    """
    votes = jnp.asarray(votes)
    return Tally(
        tampered=jnp.sum(votes == TAMPERED, axis=0, dtype=jnp.int32),
        authentic=jnp.sum(votes == AUTHENTIC, axis=0, dtype=jnp.int32),
        abstained=jnp.sum(votes == ABSTAIN, axis=0, dtype=jnp.int32),
    )


def no_votes(count: int) -> Tally:
    """The tally of no view on N Gaussians."""
    return tally(jnp.zeros((0, count), jnp.int32))


def paper_consensus(counts: Tally) -> jax.Array:
    """Initial attribute of the paper: T_i where more views say tampered than authentic, else 0.

    Args:
        counts: The votes on N Gaussians. Abstentions are not counted (eq. 6); no vote at all is 0.

    Returns:
        Initial attribute r, shape (N,), float32.
    """
    majority = counts.tampered > counts.authentic
    return jnp.where(majority, counts.tampered, 0).astype(jnp.float32)


def official_consensus(counts: Tally) -> jax.Array:
    """Initial attribute of the released code: the mode over all views, abstentions competing.

    Args:
        counts: The votes on N Gaussians.

    Returns:
        Number of tampered votes where they are the strict mode, else 0, shape (N,), float32.
    """
    rivals = jnp.maximum(counts.authentic, counts.abstained)
    return jnp.where(counts.tampered > rivals, counts.tampered, 0).astype(jnp.float32)
