"""The methods that GS-Checker is compared with, from the votes and the evidence it is given itself.

Each is as its authors define it, so that a difference in a table is one of method: same masks, same
blending weights. Inverse and SAGD count the votes of `gsc_jax.vote`; SA3D and FlashSplat need what
each Gaussian contributes inside and outside of the masks, which is the evidence. SAGD has a second
half, which changes the Gaussians at the border of a mask: `sagd_boundary`.

    observation = observe(gaussians, cameras, as_detector(masks))  # gsc_jax.evidence.observation, .detection
    mode_vote(observation.votes), flashsplat(observation.evidence)
"""

import functools
from collections.abc import Callable

import jax
import jax.numpy as jnp
import numpy as np
import optax
from boundary import sagd_boundary

from gsc_jax.evidence.lifting import Evidence
from gsc_jax.loop import view_order
from gsc_jax.losses import loss_2d_from_evidence
from gsc_jax.scene import Array
from gsc_jax.vote import Tally, official_consensus

__all__ = [
    "MIN_OVERLAP",
    "SA3D_LEVEL",
    "flashsplat",
    "inverse",
    "mode_vote",
    "sa3d",
    "sagd_boundary",
    "sagd_vote",
]

SA3D_LEVEL = 0.1
"""SA3D's mask of a view is where the rendered score R exceeds this; R is not normalised."""
MIN_OVERLAP = 0.5
"""SA3D's gate skips a view whose mask and rendered score overlap less than this (IoU)."""


def inverse(votes: Tally) -> np.ndarray:
    """The masks projected back and united (GS-Checker, table 1; no code of it was released).

    Args:
        votes: The votes on N Gaussians.

    Returns:
        True where the centre lies in the mask of at least one view, shape (N,).
    """
    return np.asarray(votes.tampered) > 0


def mode_vote(votes: Tally) -> np.ndarray:
    """The majority vote of GS-Checker's released code by itself, without any optimisation.

    Args:
        votes: The votes on N Gaussians.

    Returns:
        True where tampered is the strict mode of a Gaussian's votes, abstentions competing, (N,).
    """
    return np.asarray(official_consensus(votes)) > 0


def sagd_vote(votes: Tally, *, agreement: float = 0.7) -> np.ndarray:
    """SAGD's label vote (Hu et al., SAGD, arXiv 2401.17857).

    Args:
        votes: The votes on N Gaussians.
        agreement: Share of all views, those that abstain included, that must be exceeded.

    Returns:
        True where `mode_vote` is and enough views agree, shape (N,).
    """
    tampered, authentic, abstained = (
        np.asarray(count) for count in (votes.tampered, votes.authentic, votes.abstained)
    )
    # A quotient is rounded once, so 63 of 90 is 0.7 exactly; 0.7 * 90 would be less than 63.
    share = tampered / np.maximum(tampered + authentic + abstained, 1)
    return mode_vote(votes) & (share > agreement)


def sa3d(
    evidence: Evidence,
    *,
    price: float = 0.3,
    learning_rate: float = 1.0,
    passes: int = 2,
    overlap: Callable[[int, np.ndarray], Array | float] | None = None,
) -> np.ndarray:
    """SA3D's mask inverse rendering on Gaussians (Cen et al., SA3D, arXiv 2304.12308).

    Adam from 0, a view a step in fixed order, on L = -sum M R + price sum (1 - M) R with R the
    rendered score. This is `loss_2d` with other weights, so the evidence gives its gradient. After
    the first pass, Gaussians with r <= 0 are taken out: their score stays 0, as if they were gone.
    The original deletes them, so that they no longer hide what lies behind; the evidence is that of
    the whole scene and cannot say what would then be seen, so here they go on hiding it.

    Args:
        evidence: Of V views, shapes (V, N). `tampered` may be that of several sets of masks, shape
            (S, V, N): each is worked on by itself, but what the gate renders can be rendered once.
        price: Weight of what is rendered outside the masks.
        learning_rate: Of Adam.
        passes: How often each view is looked at.
        overlap: The gate: given the index of a view and the scores r so far, shape (N,) or (S, N),
            the IoU of its mask M and R > 0.5, which the caller can render, scalar or of shape (S,).
            After the very first step, views below 0.5 are skipped. None: no gate.

    Returns:
        The raw score r, shape (N,) or (S, N), float32; a view shows a mask where R > `SA3D_LEVEL`.
    """
    views, count = np.shape(evidence.total)
    shape = (*np.shape(evidence.tampered)[:-2], count)
    sets = np.reshape(evidence.tampered, (-1, views, count))
    r, kept = jnp.zeros((len(sets), count)), jnp.ones((len(sets), count), bool)
    moments = jax.vmap(_adam(learning_rate).init)(r)
    for turn, view in enumerate(view_order(views, epochs=passes).tolist()):
        if turn == views:
            kept = r > 0
            r = jnp.where(kept, r, 0.0)
        agrees = np.ones(len(sets), bool)
        if turn and overlap is not None:
            agrees &= np.asarray(overlap(view, np.reshape(r, shape))) >= MIN_OVERLAP
        if agrees.any():
            seen = evidence.total[view], sets[:, view]
            r, moments = _sa3d_step(r, moments, kept, agrees, *seen, price, learning_rate)
    return np.reshape(r, shape)


@jax.jit
@functools.partial(jax.vmap, in_axes=(0, 0, 0, 0, None, 0, None, None))
def _sa3d_step(r, moments, kept, agrees, total, tampered, price, learning_rate):
    evidence = Evidence(total=total, tampered=tampered)
    loss = functools.partial(loss_2d_from_evidence, evidence=evidence, lambda2=price)
    # Adam's bias correction raises a float to an integer power; strict callers need not care.
    with jax.numpy_dtype_promotion("standard"):
        updates, stepped = _adam(learning_rate).update(jax.grad(loss)(r), moments)
    moved = jnp.where(kept, r + updates, r)
    return jax.tree.map(
        lambda new, old: jnp.where(agrees, new, old), (moved, stepped), (r, moments)
    )


def _adam(learning_rate) -> optax.GradientTransformation:
    # The score is one more attribute in the optimiser of 3DGS, whose epsilon this is: every
    # Gaussian moves at the full rate, however little of it a view sees.
    return optax.adam(learning_rate, eps=1e-15)


def flashsplat(evidence: Evidence, *, gamma: float = 0.0) -> np.ndarray:
    """FlashSplat's closed form (Shen et al., FlashSplat, arXiv 2409.08270).

    With A1 and A0 the blending weight inside and outside of the masks over all views, scaled so
    that (A0, A1) has length 1, the label is A1 > A0 + gamma. For |gamma| <= 1 that is a threshold
    on the share inside, A1 / (A0 + A1) > (1 + gamma / sqrt(2 - gamma^2)) / 2.

    Args:
        evidence: Of V views, shapes (V, N).
        gamma: Bias towards the background, or with a minus sign towards the foreground.

    Returns:
        True where tampered, shape (N,). Gaussians without weight abstain, so are False: the
        original gives them to the foreground when gamma is negative.
    """
    total = np.sum(evidence.total, axis=0, dtype=np.float64)
    inside = np.sum(evidence.tampered, axis=0, dtype=np.float64)
    outside = total - inside
    # Not divided by the length, so that nothing is 0 / 0 and 0 > 0 lets the unseen abstain.
    return inside - outside > gamma * np.hypot(outside, inside)
