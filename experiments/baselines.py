"""The methods that GS-Checker is compared with, from the same votes and evidence.

Each follows its authors' definition, so that tables compare methods on the same masks and the same
blending weights. The votes of SAGD are those of `gsc_jax.vote`; SA3D and FlashSplat need the
blending weight of each Gaussian inside and outside of the masks, which is the evidence. The second
half of SAGD, which cuts Gaussians at the border of a mask, is `sagd_boundary`.

    observation = observe(gaussians, cameras, masks)  # gsc_jax.evidence.observation
    mode_vote(observation.votes), flashsplat(observation.evidence)
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
from boundary import sagd_boundary

from gsc_jax.evidence.lifting import Evidence, EvidenceOfViews
from gsc_jax.loop import adam, view_order
from gsc_jax.losses import loss_2d_from_evidence
from gsc_jax.scene import Array
from gsc_jax.vote import Tally, official_consensus

__all__ = [
    "SA3D_LEVEL",
    "flashsplat",
    "inverse_projection",
    "mode_vote",
    "sa3d",
    "sagd_boundary",
    "sagd_vote",
]

SA3D_LEVEL = 0.1
"""SA3D's threshold on the rendered score, which is not normalised."""
MIN_OVERLAP = 0.5
"""SA3D's gate skips a view where the IoU of mask and rendered score is lower."""


def inverse_projection(votes: Tally) -> np.ndarray:
    """Label by back-projecting the masks and uniting them (GS-Checker, table 1).

    True where the projected centre lies in the mask of at least one view, shape (N,) bool.
    """
    return np.asarray(votes.tampered) > 0


def mode_vote(votes: Tally) -> np.ndarray:
    """Majority vote of GS-Checker's released code, without optimisation.

    Args:
        votes: The votes on N Gaussians.

    Returns:
        True where most votes are tampered, abstentions counted as a third option, shape (N,).
    """
    return np.asarray(official_consensus(votes)) > 0


def sagd_vote(votes: Tally, *, agreement: float = 0.7) -> np.ndarray:
    """SAGD's label vote (Hu et al., SAGD, arXiv 2401.17857).

    Args:
        votes: The votes on N Gaussians.
        agreement: Threshold on the share of tampered votes among all views, abstentions included.

    Returns:
        True where `mode_vote` is true and the share is above the threshold, shape (N,).
    """
    tampered, authentic, abstained = (
        np.asarray(count) for count in (votes.tampered, votes.authentic, votes.abstained)
    )
    # A quotient is rounded once, so 63 of 90 is 0.7 exactly; 0.7 * 90 would be less than 63.
    share = tampered / np.maximum(tampered + authentic + abstained, 1)
    return mode_vote(votes) & (share > agreement)


def sa3d(
    evidence: EvidenceOfViews,
    *,
    price: float = 0.3,
    learning_rate: float = 1.0,
    passes: int = 2,
    overlap: Callable[[int, np.ndarray], Array | float] | None = None,
) -> np.ndarray:
    """SA3D's mask inverse rendering on Gaussians (Cen et al., SA3D, arXiv 2304.12308).

    Adam from 0, one view per step in fixed order, on L = -sum M R + price sum (1 - M) R with R the
    rendered score. This is `loss_2d` with other weights, so the evidence gives its gradient. After
    the first pass, Gaussians with r <= 0 are frozen at 0. The original deletes them, which also
    uncovers Gaussians behind them; the evidence of the whole scene cannot reproduce this.

    Args:
        evidence: Evidence of V views, shapes (V, N). `tampered` may have shape (S, V, N) for S sets
            of masks, which are optimised independently; the gate can then render them together.
        price: Weight of the score outside the masks.
        learning_rate: Learning rate of Adam.
        passes: Number of steps per view.
        overlap: The gate: maps the index of a view and the scores r so far, shape (N,) or (S, N),
            to the IoU of its mask and R > 0.5, scalar or of shape (S,). Views below `MIN_OVERLAP`
            are skipped, except in the first step. None: no gate.

    Returns:
        Raw score r, shape (N,) or (S, N), float32; the mask of a view is R > `SA3D_LEVEL`.
    """
    views, count = np.shape(evidence.total)
    shape = (*np.shape(evidence.tampered)[:-2], count)
    sets = np.reshape(evidence.tampered, (-1, views, count))
    r, kept = jnp.zeros((len(sets), count)), jnp.ones((len(sets), count), bool)
    moments = jax.vmap(adam(learning_rate).init)(r)
    for turn, view in enumerate(view_order(views, epochs=passes).tolist()):
        if turn == views:
            kept = r > 0
            r = jnp.where(kept, r, 0.0)
        agrees = np.ones(len(sets), bool)
        if turn and overlap is not None:
            agrees &= np.asarray(overlap(view, np.reshape(r, shape))) >= MIN_OVERLAP
        if agrees.any():
            seen = evidence.total[view], sets[:, view]
            r, moments = _sa3d_step((r, moments), kept, agrees, *seen, price, learning_rate)
    return np.reshape(r, shape)


@jax.jit
@functools.partial(jax.vmap, in_axes=(0, 0, 0, None, 0, None, None))
def _sa3d_step(state, kept, agrees, total, tampered, price, learning_rate):
    r, moments = state
    evidence = Evidence(total=total, tampered=tampered)
    loss = functools.partial(loss_2d_from_evidence, evidence=evidence, lambda2=price)
    # Adam's bias correction raises a float to an integer power, which strict promotion refuses.
    with jax.numpy_dtype_promotion("standard"):
        updates, stepped = adam(learning_rate).update(jax.grad(loss)(r), moments)
    moved = jnp.where(kept, r + updates, r)
    return jax.tree.map(lambda new, old: jnp.where(agrees, new, old), (moved, stepped), state)


def flashsplat(evidence: EvidenceOfViews, *, gamma: float = 0.0) -> np.ndarray:
    """FlashSplat's closed form (Shen et al., FlashSplat, arXiv 2409.08270).

    With A1 and A0 the blending weight inside and outside of the masks over all views, scaled so
    that (A0, A1) has length 1, the label is A1 > A0 + gamma. For |gamma| <= 1 that is a threshold
    on the share inside, A1 / (A0 + A1) > (1 + gamma / sqrt(2 - gamma^2)) / 2.

    Args:
        evidence: Evidence of V views, shapes (V, N).
        gamma: Bias towards the background; towards the foreground if negative.

    Returns:
        True where tampered, shape (N,). Gaussians without weight are False, whereas the original
        assigns them to the foreground if gamma is negative.
    """
    total = np.sum(evidence.total, axis=0, dtype=np.float64)
    inside = np.sum(evidence.tampered, axis=0, dtype=np.float64)
    outside = total - inside
    # Without the division by the length, there is no 0 / 0, and unseen Gaussians are False.
    return inside - outside > gamma * np.hypot(outside, inside)
