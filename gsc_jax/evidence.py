"""All that a view says about each Gaussian, W^t 1 and W^t M: sufficient statistics of the method.

The 2D loss is linear in the attribute, so its gradient W^t (lambda2 (1 - M) - lambda1 M) is made
of these two sums and never changes: with them, the whole optimisation needs no more rendering.
"""

import functools
import os
import tempfile

import jax.numpy as jnp
import numpy as np

from gsc_jax.errors import InputError
from gsc_jax.pytree import pytree
from gsc_jax.scene import Array
from gsc_jax.splat import accumulate
from gsc_jax.tiles import View

IN_MEMORY = 2**30
"""Bytes of evidence that are kept in memory."""


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


def blank_evidence(views: int, count: int, *, in_memory: int = IN_MEMORY) -> Evidence:
    """Evidence of zeros, on the host, to be filled view by view.

    The optimisation reads one view at a time but returns to it, so all of it has to be somewhere:
    what is large goes into a file that has no name and vanishes with the arrays, where the system
    keeps as much of it in memory as it can spare.

    Args:
        views: Number of views V.
        count: Number of Gaussians N.
        in_memory: Bytes up to which plain arrays are taken.

    Returns:
        NumPy arrays, shapes (V, N); in the folder of temporary files where they are larger, which
        should not be one in memory (TMPDIR names another).

    Raises:
        InputError: if that folder has no room for them.
    """
    if 8 * views * count <= in_memory:
        total, tampered = np.zeros((2, views, count), np.float32)
        return Evidence(total=total, tampered=tampered)
    with tempfile.TemporaryFile() as file:
        _reserve(file.fileno(), 8 * views * count)
        both = np.memmap(file, np.float32, "r+", shape=(2, views, count))
    return Evidence(total=both[0], tampered=both[1])


def _reserve(file: int, size: int) -> None:
    """Take the space of a file now: a full disk would kill the process when a page is written."""
    try:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file, 0, size)
        else:
            os.ftruncate(file, size)
    except OSError as error:
        raise InputError(
            f"{tempfile.gettempdir()}: no room for {size / 2**30:.1f} GiB of evidence "
            f"({error.strerror}); make room, set TMPDIR to another folder, or use fewer views"
        ) from error


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
