"""Properties of Gaussians that tell tampered from authentic ones (GS-Checker's figure of them)."""

import dataclasses
from collections.abc import Iterator

import numpy as np

from gsc_jax.forensics.features import FLATTEST
from gsc_jax.io.ply import LUMA
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Gaussians

MOST = 200_000
"""Gaussians of a group that are looked at; more change no picture of a distribution."""
DECADE = np.log(10)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Property:
    """One number per Gaussian, of two groups.

    Attributes:
        name: For ids.
        title: For people.
        unit: What the numbers are.
        tampered: Of the tampered Gaussians, shape (A,).
        authentic: Of the authentic ones, shape (B,).
    """

    name: str
    title: str
    unit: str
    tampered: np.ndarray
    authentic: np.ndarray

    def densities(self, bins: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Shares of either group per bin, each of sum 1, and the edges of the bins.

        Args:
            bins: How many, between the outermost half percents; what lies beyond is in the last.
        """
        ends = [np.quantile(group, [0.005, 0.995]) for group in (self.tampered, self.authentic)]
        low, high = float(np.min(ends)), float(np.max(ends))
        room = max(high - low, 1e-6 * max(abs(low), 1.0)) / bins
        edges = np.linspace(low - room, high + room, bins + 1)
        counts = [
            np.histogram(np.clip(group, edges[0], edges[-1]), edges)[0] / len(group)
            for group in (self.tampered, self.authentic)
        ]
        return counts[0], counts[1], edges


def properties(gaussians: Gaussians, labels: np.ndarray, seen: np.ndarray) -> list[Property]:
    """The properties of tampered and of authentic Gaussians.

    Args:
        gaussians: N Gaussians.
        labels: Which are tampered, shape (N,) bool.
        seen: Which were looked at; the others are in neither group, shape (N,) bool.

    Returns:
        Six, or seven where the colours have harmonics; none where a group is empty.
    """
    groups = [_some(np.flatnonzero(rows)) for rows in (seen & labels, seen & ~labels)]
    if not all(map(len, groups)):
        return []
    tampered, authentic = (list(_described(gaussians.take(rows))) for rows in groups)
    return [
        Property(name=name, title=title, unit=unit, tampered=one, authentic=other)
        for (name, title, unit, one), (*_, other) in zip(tampered, authentic, strict=True)
    ]


def _some(rows: np.ndarray) -> np.ndarray:
    return rows[:: -(-len(rows) // MOST) or 1]


def _described(gaussians: Gaussians) -> Iterator[tuple[str, str, str, np.ndarray]]:
    """Name, title, unit and values (N,) of each property."""
    logs = np.maximum(np.asarray(gaussians.log_scales, np.float64), FLATTEST) / DECADE
    sh = np.asarray(gaussians.sh, np.float64)
    rgb = 0.5 + Y0 * sh[:, 0]
    turned = np.abs(np.asarray(gaussians.rotations)[:, 0]).clip(0, 1)
    yield "opacity", "Opacity", "from 0 to 1", np.asarray(gaussians.opacities)
    yield "size", "Size", "log10 of the mean scale, scene units", logs.mean(axis=1)
    yield "anisotropy", "Anisotropy", "log10 of longest to shortest axis", np.ptp(logs, axis=1)
    yield "rotation", "Rotation", "angle in degrees", np.degrees(2 * np.arccos(turned))
    yield "luminance", "Luminance", "of the base colour", rgb @ LUMA
    yield "saturation", "Saturation", "of the base colour, max minus min", np.ptp(rgb, axis=1)
    if sh.shape[1] > 1:
        energy = np.sqrt(np.mean(sh[:, 1:] ** 2, axis=(1, 2)))
        yield "harmonics", "View dependence", "log10 RMS of the harmonics", np.log10(energy + 1e-6)
