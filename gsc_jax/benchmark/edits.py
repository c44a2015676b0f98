"""What the three edits share: the proposed edit, and why one is rejected."""

from typing import NamedTuple

import numpy as np

from gsc_jax.scene import Gaussians


class ProposedEdit(NamedTuple):
    """A scene after an edit whose visibility has not been checked yet.

    `labels` (N,) is True where a Gaussian was pasted, changed or filled in. `original` is the
    authentic scene, for edits that must change the colour of pixels.
    """

    gaussians: Gaussians
    labels: np.ndarray
    description: str
    original: Gaussians | None = None


class EditRejected(Exception):  # noqa: N818 - not an error: another attempt may succeed
    """An attempt at an edit failed; the message gives the reason."""
