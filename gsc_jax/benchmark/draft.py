"""An edit on its way: what a scene would become, and whether views show that."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from gsc_jax.benchmark.metrics import truth_mask
from gsc_jax.benchmark.regions import over_views
from gsc_jax.scene import Camera, Gaussians


class Draft(NamedTuple):
    """A scene with an edit that nobody has looked at yet; `what` is for people.

    `original` holds the untouched scene where the pixels must differ from it.
    """

    gaussians: Gaussians
    labels: np.ndarray
    what: str
    original: Gaussians | None = None


class Unsuitable(Exception):  # noqa: N818 - no error: the next attempt may do
    """An attempt that came to nothing, and why."""


def visible_shares(
    gaussians: Gaussians, cameras: Sequence[Camera], labels: np.ndarray, *, near: float
) -> np.ndarray:
    """The share of the pixels of each view that show something tampered, shape (V,)."""

    def share(camera: Camera) -> float:
        return float(truth_mask(gaussians, camera, labels, near=near).mean())

    return np.array(over_views(share, cameras), np.float64)
