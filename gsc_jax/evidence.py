"""All that a view says about each Gaussian, W^t 1 and W^t M: sufficient statistics of the method.

The 2D loss is linear in the attribute, so its gradient W^t (lambda2 (1 - M) - lambda1 M) is made
of these two sums and never changes: with them, the whole optimisation needs no more rendering.
"""

import jax.numpy as jnp
import numpy as np

from gsc_jax.pytree import pytree
from gsc_jax.scene import Array
from gsc_jax.splat import accumulate
from gsc_jax.tiles import View


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
        return np.any(total.reshape(-1, total.shape[-1]) > 0, axis=0)


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
