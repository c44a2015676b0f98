"""All that a view says about each Gaussian, W^t 1 and W^t M: sufficient statistics of the method.

The 2D loss is linear in the attribute, so its gradient W^t (lambda2 (1 - M) - lambda1 M) is made
of these two sums and never changes: with them, the whole optimisation needs no more rendering.
"""

import functools

import jax.numpy as jnp
import numpy as np

from gsc_jax.render.tiles import View
from gsc_jax.scene import Array, pytree
from gsc_jax.splat import accumulate


@pytree
class Evidence:
    """Blending weight of each Gaussian, in all and inside the masks, 0 <= tampered <= total.

    Attributes:
        total: Weight in pixels, (W_j^t 1)_i, shape (V, N) or (N,) for one view.
        tampered: Weight inside the mask, (W_j^t M)_i, of the same shape.
    """

    total: Array
    tampered: Array

    @property
    def seen(self) -> np.ndarray:
        """Gaussians that contribute to some pixel of some view, shape (N,)."""
        total = np.asarray(self.total)
        views = np.atleast_2d(total)
        # View by view, as everywhere: what is kept on disk is never in memory all at once.
        nowhere = np.zeros(views.shape[1], bool)
        return functools.reduce(np.logical_or, (view > 0 for view in views), nowhere)

    @property
    def says_nothing(self) -> bool:
        """Whether no view flags anything that it sees."""
        return not any(np.any(view) for view in np.asarray(self.tampered))

    @property
    def says_everything(self) -> bool:
        """Whether every view flags all that it sees."""
        views = zip(np.asarray(self.total), np.asarray(self.tampered), strict=True)
        return all(np.array_equal(total, tampered) for total, tampered in views)


def view_evidence(view: View, mask: Array) -> Evidence:
    """The evidence of one view.

    Args:
        view: The scene as a camera sees it, of N Gaussians.
        mask: Tampered pixels, boolean or in [0, 1], shape (H, W).

    Returns:
        Evidence of shapes (N,).
    """
    mask = jnp.asarray(mask, jnp.float32)
    total, tampered = accumulate(view, jnp.stack([jnp.ones_like(mask), mask], axis=-1)).T
    return Evidence(total=total, tampered=jnp.minimum(tampered, total))
