"""Attributes whose distributions differ between tampered and authentic Gaussians (GS-Checker)."""

import dataclasses
from collections.abc import Iterator

import jax
import numpy as np

from gsc_jax.io.ply import LUMA
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Gaussians
from gsc_jax.scene.parallel import in_blocks

MIN_LOG_SCALE = -30.0
"""Floor of log scales: flat Gaussians are stored with scales down to exp(-100)."""
MAX_SAMPLE = 2**19
"""More Gaussians would change no chart visibly, and take memory."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Distribution:
    """Values of one attribute of tampered (A,) and of authentic Gaussians (B,)."""

    title: str
    unit: str
    tampered: np.ndarray
    authentic: np.ndarray

    def shares(self, bins: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Share of each group per bin, and the edges of the bins.

        The bins span the 0.5% to 99.5% quantiles of both groups; the outermost include the rest.
        """
        groups = (self.tampered, self.authentic)
        quantiles = np.concatenate([np.quantile(group, [0.005, 0.995]) for group in groups])
        low, high = float(quantiles.min()), float(quantiles.max())
        margin = max(high - low, 1e-6 * max(abs(low), 1.0)) / bins
        edges = np.linspace(low - margin, high + margin, bins + 1)
        tampered, authentic = (
            np.histogram(np.clip(group, edges[0], edges[-1]), edges)[0] / len(group)
            for group in groups
        )
        return tampered, authentic, edges


def attribute_distributions(
    gaussians: Gaussians, labels: np.ndarray, seen: np.ndarray
) -> list[Distribution]:
    """Distributions of attributes of the visible Gaussians by label; none if a group is empty.

    Of large scenes, at most `MAX_SAMPLE` Gaussians at even distances in the file are used.
    """
    sample = slice(None, None, -(-len(labels) // MAX_SAMPLE) or None)
    gaussians = jax.tree.map(np.asarray, gaussians).take(sample)
    labels, seen = labels[sample], seen[sample]
    tampered, authentic = seen & labels, seen & ~labels
    if not (tampered.any() and authentic.any()):
        return []
    return [
        Distribution(title=title, unit=unit, tampered=values[tampered], authentic=values[authentic])
        for title, unit, values in _attributes(gaussians)
    ]


def _attributes(gaussians: Gaussians) -> Iterator[tuple[str, str, np.ndarray]]:
    """Title, unit and values (N,) of each attribute."""
    log_scales = np.maximum(np.asarray(gaussians.log_scales, np.float64), MIN_LOG_SCALE)
    decades = log_scales / np.log(10)
    sh = np.asarray(gaussians.sh)
    rgb = 0.5 + Y0 * sh[:, 0].astype(np.float64)
    cos_half_angle = np.abs(np.asarray(gaussians.rotations)[:, 0]).clip(0, 1)
    yield "Opacity", "from 0 to 1", np.asarray(gaussians.opacities)
    yield "Size", "log10 of the mean scale, scene units", decades.mean(axis=1)
    yield "Anisotropy", "log10 of longest to shortest axis", np.ptp(decades, axis=1)
    yield "Rotation", "angle in degrees", np.degrees(2 * np.arccos(cos_half_angle))
    yield "Luminance", "of the base colour", rgb @ LUMA
    yield "Saturation", "of the base colour, max minus min", np.ptp(rgb, axis=1)
    if sh.shape[1] > 1:
        rms = np.sqrt(in_blocks(lambda rest: np.asarray(np.mean(rest**2, axis=(1, 2))), sh[:, 1:]))
        yield "View dependence", "log10 RMS of the harmonics", np.log10(rms + 1e-6)
