"""Evidence of a view: W^t 1 and W^t M, the sufficient statistics of every estimator.

The 2D loss (GS-Checker, eq. 10) is linear in the attribute, so its gradient
W^t (lambda2 (1 - M) - lambda1 M) is a combination of these two sums and constant: the whole
optimisation needs no rendering beyond one `accumulate` per view.

A view shows a small part of a large scene. `SparseEvidence` holds only that part; the zeros that it
leaves out are exact, so estimates from it are the same.
"""

import abc
import dataclasses
import math
from collections.abc import Callable, Iterator

import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from gsc_jax.render.tiles import View
from gsc_jax.scene import Array, pytree
from gsc_jax.splat import accumulate


class EvidenceOfViews(abc.ABC):
    """What estimators read: the evidence of V views of N Gaussians, by view or by Gaussian."""

    total: Array
    tampered: Array
    shape: tuple[int, int]

    @abc.abstractmethod
    def view(self, index: int) -> "Evidence":
        """Evidence of one view, shapes (N,)."""

    def of(self, rows: np.ndarray | slice) -> tuple[np.ndarray, np.ndarray]:
        """Total and tampered weight of M of the Gaussians in all views, shapes (V, M)."""
        return np.asarray(self.total)[:, rows], np.asarray(self.tampered)[:, rows]

    def views(self) -> Iterator["Evidence"]:
        """Evidence view by view: that of large scenes must not be loaded as a whole."""
        return (self.view(index) for index in range(self.shape[0]))

    @property
    def seen(self) -> np.ndarray:
        """Mask of the Gaussians with weight in at least one view, shape (N,) bool."""
        return self.weight > 0

    @property
    def weight(self) -> np.ndarray:
        """Blending weight summed over the views, shape (N,) float32."""
        nothing = np.zeros(self.shape[1], np.float32)
        return sum((np.asarray(view.total) for view in self.views()), nothing)

    @property
    def none_flagged(self) -> bool:
        """Whether no mask covers any of the weight."""
        return not any(np.any(view.tampered) for view in self.views())

    @property
    def all_flagged(self) -> bool:
        """Whether the masks cover all of the weight."""
        return all(np.array_equal(view.total, view.tampered) for view in self.views())


@pytree
class Evidence(EvidenceOfViews):
    """Blending weight of each Gaussian, in total and inside the masks, 0 <= tampered <= total.

    Attributes:
        total: Weight in pixels, (W_j^t 1)_i, shape (V, N), or (N,) for one view.
        tampered: Weight inside the mask, (W_j^t M)_i, of the same shape.
    """

    total: Array
    tampered: Array

    @property
    def shape(self) -> tuple[int, int]:  # pyright: ignore[reportIncompatibleVariableOverride]
        """V and N; V is 1 for the evidence of one view."""
        views, count = (1, *np.shape(self.total))[-2:]
        return views, count

    def view(self, index: int) -> "Evidence":
        """Evidence of one view, shapes (N,)."""
        if np.ndim(self.total) == 1:
            return self
        return Evidence(total=self.total[index], tampered=self.tampered[index])


@dataclasses.dataclass(frozen=True, kw_only=True)
class SparseEvidence(EvidenceOfViews):
    """Evidence without the Gaussians that a view does not show.

    Attributes:
        entry: Gives what `sparse` returns for a view, by its index; it may read a file.
        shape: V and N.
    """

    entry: Callable[[int], np.ndarray]
    shape: tuple[int, int]

    def view(self, index: int) -> Evidence:
        """Evidence of one view, shapes (N,)."""
        rows, total, tampered = self.entry(index)
        both = np.zeros((2, self.shape[1]), np.float32)
        both[:, rows] = np.stack([total, tampered]).view(np.float32)
        return Evidence(total=both[0], tampered=both[1])

    def of(self, rows: np.ndarray | slice) -> tuple[np.ndarray, np.ndarray]:
        """Total and tampered weight of M of the Gaussians in all views, shapes (V, M)."""
        views, count = self.shape
        wanted = np.arange(count)[rows]
        both = np.zeros((2, views, len(wanted)), np.float32)
        for view in range(views):
            at, weights = _find(self.entry(view), wanted, consecutive=isinstance(rows, slice))
            both[:, view, at] = weights.view(np.float32)
        return both[0], both[1]

    @property
    def total(self) -> np.ndarray:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Weight in pixels, shape (V, N) float32: 4 V N bytes, made anew whenever it is asked."""
        return self.of(slice(None))[0]

    @property
    def tampered(self) -> np.ndarray:  # pyright: ignore[reportIncompatibleVariableOverride]
        """Weight inside the masks, shape (V, N) float32: 4 V N bytes, made anew."""
        return self.of(slice(None))[1]

    def expanded(self, max_bytes: int) -> EvidenceOfViews:
        """`Evidence`, which is faster to read, if it needs at most `max_bytes`; else this."""
        if 8 * math.prod(self.shape) > max_bytes:
            return self
        total, tampered = self.of(slice(None))
        return Evidence(total=total, tampered=tampered)


def view_evidence(view: View, mask: Array) -> Evidence:
    """Lift a mask (H, W) in [0, 1]: blending weight of N Gaussians, in total and inside of it."""
    # In NumPy, unless JAX traces the mask: it would compile for each image size.
    numpy = jnp if isinstance(mask, Tracer) else np
    mask = numpy.asarray(mask, jnp.float32)
    total, tampered = accumulate(view, numpy.stack([numpy.ones_like(mask), mask], axis=-1)).T
    return Evidence(total=total, tampered=jnp.minimum(tampered, total))


def sparse(evidence: Evidence) -> np.ndarray:
    """The Gaussians with any weight in a view, of evidence (N,), shape (3, M) int32.

    Their rows, ascending, and the bits of total and of tampered: 12 bytes per visible Gaussian.
    """
    total, tampered = (np.asarray(x, np.float32) for x in (evidence.total, evidence.tampered))
    rows = np.flatnonzero(total).astype(np.int32)
    return np.stack([rows, total[rows].view(np.int32), tampered[rows].view(np.int32)])


def _find(entries: np.ndarray, wanted: np.ndarray, *, consecutive: bool) -> tuple[np.ndarray, ...]:
    """Which of the wanted rows a view shows, (K,), and the bits of their evidence, (2, K)."""
    rows = entries[0]
    if not (len(rows) and len(wanted)):
        return np.zeros(0, int), np.zeros((2, 0), np.int32)
    if consecutive:  # only this part of a file is read
        start, end = np.searchsorted(rows, np.array([wanted[0], wanted[-1] + 1], rows.dtype))
        return rows[start:end] - wanted[0], np.ascontiguousarray(entries[1:, start:end])
    place = np.minimum(np.searchsorted(rows, wanted.astype(rows.dtype)), len(rows) - 1)
    at = np.flatnonzero(rows[place] == wanted)
    return at, np.ascontiguousarray(entries[1:, place[at]])
