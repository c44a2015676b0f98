"""Evidence of a view: W^t 1 and W^t M, the sufficient statistics of every estimator.

The 2D loss (GS-Checker, eq. 10) is linear in the attribute, so its gradient
W^t (lambda2 (1 - M) - lambda1 M) is a combination of these two sums and constant: the whole
optimisation needs no rendering beyond one `accumulate` per view.
"""

import functools

import jax.numpy as jnp
import numpy as np

from gsc_jax.render.tiles import View
from gsc_jax.scene import Array, pytree
from gsc_jax.splat import accumulate


@pytree
class Evidence:
    """Blending weight of each Gaussian, in total and inside the masks, 0 <= tampered <= total.

    Attributes:
        total: Weight in pixels, (W_j^t 1)_i, shape (V, N), or (N,) for one view.
        tampered: Weight inside the mask, (W_j^t M)_i, of the same shape.
    """

    total: Array
    tampered: Array

    @property
    def seen(self) -> np.ndarray:
        """Mask of the Gaussians with weight in at least one view, shape (N,) bool."""
        views = np.atleast_2d(np.asarray(self.total))
        # One view at a time: evidence on disk must not be loaded into memory as a whole.
        unseen = np.zeros(views.shape[1], bool)
        return functools.reduce(np.logical_or, (view > 0 for view in views), unseen)

    @property
    def none_flagged(self) -> bool:
        """Whether no mask covers any of the weight."""
        return not any(np.any(view) for view in np.asarray(self.tampered))

    @property
    def all_flagged(self) -> bool:
        """Whether the masks cover all of the weight."""
        views = zip(np.asarray(self.total), np.asarray(self.tampered), strict=True)
        return all(np.array_equal(total, tampered) for total, tampered in views)


def view_evidence(view: View, mask: Array) -> Evidence:
    """Lift a mask: accumulate the blending weight of each Gaussian, in total and inside the mask.

    Args:
        view: A scene of N Gaussians, projected and binned for a camera.
        mask: Tampered pixels, boolean or in [0, 1], shape (H, W).

    Returns:
        Evidence of shapes (N,).
    """
    mask = jnp.asarray(mask, jnp.float32)
    total, tampered = accumulate(view, jnp.stack([jnp.ones_like(mask), mask], axis=-1)).T
    return Evidence(total=total, tampered=jnp.minimum(tampered, total))
