"""A copy of a scene for any viewer: tampered Gaussians red, candidates blue, the others grey."""

import dataclasses
from pathlib import Path

import jax
import numpy as np

from gsc_jax.io.ply import LUMA, save_parts
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Array, Gaussians

TAMPERED_COLOR, CANDIDATE_COLOR = np.array([1.0, 0.1, 0.1]), np.array([0.1, 0.45, 1.0])


def save_highlight(
    path: str | Path, gaussians: Gaussians, labels: Array, *, candidates: bool = False
) -> None:
    """Write a copy: labelled Gaussians, (N,) bool, are red, candidates blue, all others grey."""
    color = CANDIDATE_COLOR if candidates else TAMPERED_COLOR
    host, labels = jax.tree.map(np.asarray, gaussians), np.asarray(labels, bool)

    def highlighted(rows: slice) -> Gaussians:
        part = host.take(rows)
        luma = np.clip(0.5 + Y0 * part.sh[:, 0], 0, 1) @ LUMA
        # Half of the luminance keeps the structure visible; no grey is as bright as white.
        marked = color * (0.5 + 0.5 * luma[:, None])
        grey = np.repeat(0.2 + 0.5 * luma[:, None], 3, axis=1)
        sh = np.zeros_like(part.sh)
        sh[:, 0] = (np.where(labels[rows, None], marked, grey) - 0.5) / Y0
        return dataclasses.replace(part, sh=sh)

    save_parts(path, host, highlighted)
