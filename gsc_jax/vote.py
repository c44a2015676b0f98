"""From masks to votes to the initial attribute (GS-Checker, eq. 5 and 6).

A view votes on a Gaussian by the pixel of its projected centre: 1 in the tampered region, 0 in the
authentic region, -1 (abstention) outside the image or behind the camera; occlusion is ignored. The
paper states both that abstentions do not count and that a majority must exceed them; in the
released code they compete. `paper_consensus` and `official_consensus` are the two readings.
"""

import jax
import jax.numpy as jnp

from gsc_jax.scene import Array, pytree

TAMPERED, AUTHENTIC, ABSTAIN = 1, 0, -1


@pytree
class Tally:
    """Number of views with each vote on each of N Gaussians, shapes (N,) int32."""

    tampered: Array
    authentic: Array
    abstained: Array

    def __add__(self, other: "Tally") -> "Tally":
        """The tally of both sets of views."""
        return jax.tree.map(jnp.add, self, other)


@jax.jit
def cast_votes(centers: Array, depths: Array, mask: Array) -> jax.Array:
    """Compute the votes V_ij of one view j, 1, 0 or -1, shape (N,) int32 (GS-Checker, eq. 5).

    The centres are in pixels, shape (N, 2), the first of which spans 0 to 1; their depths (N,) are
    not positive behind the camera; the mask, shape (H, W), is boolean, or tampered above 0.5.
    """
    height, width = mask.shape
    size = jnp.array([[width, height]], centers.dtype)
    inside = jnp.all((centers >= 0) & (centers < size), axis=1) & (depths > 0)
    column, row = jnp.where(inside[:, None], centers, 0.0).astype(jnp.int32).T
    chosen = mask[row, column].astype(jnp.float32)
    return jnp.where(inside, (chosen > 0.5).astype(jnp.int32), ABSTAIN)


def tally(votes: Array) -> Tally:
    """Count votes, shape (V, N): `tampered` is the total T_i (GS-Checker, eq. 6)."""
    votes = jnp.asarray(votes)
    return Tally(
        tampered=jnp.sum(votes == TAMPERED, axis=0, dtype=jnp.int32),
        authentic=jnp.sum(votes == AUTHENTIC, axis=0, dtype=jnp.int32),
        abstained=jnp.sum(votes == ABSTAIN, axis=0, dtype=jnp.int32),
    )


def no_votes(count: int) -> Tally:
    """The tally of zero views on N Gaussians, to which others can be added."""
    return tally(jnp.zeros((0, count), jnp.int32))


def paper_consensus(counts: Tally) -> jax.Array:
    """Initial attribute, (N,) float32 (eq. 6): T_i if more vote tampered than authentic, else 0."""
    return jnp.where(counts.tampered > counts.authentic, counts.tampered, 0).astype(jnp.float32)


def official_consensus(counts: Tally) -> jax.Array:
    """Initial attribute of the released code: T_i where "tampered" is the strict mode, else 0."""
    others = jnp.maximum(counts.authentic, counts.abstained)
    return jnp.where(counts.tampered > others, counts.tampered, 0).astype(jnp.float32)
