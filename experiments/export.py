"""What exporters and harmless editing do to a whole scene: formats, orders, crops, motions.

None of it is an edit in the sense of the package, and each of it erases traces of one, or resembles
one: a palette makes Gaussians identical, and the chunks of a streamed scene have palettes of their
own. Each exporter is a function of a scene and a random generator. `.spz` and `.compressed.ply` are
written and read by `gsply` (the extra `formats`); `palettes` follows the layout of `.sog`.
"""

import dataclasses
import functools
import importlib
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import histories
import jax
import numpy as np
from histories import OPACITY_STEP, logits, morton_order, unit_quats
from scipy.special import expit

from gsc_jax.io.compressed import from_gsply
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Gaussians, InputError
from gsc_jax.scene.gaussians import concatenate, usable_rows

SCALE_STEP = 1 / 16
"""Step of log scales, as in spz."""
COLOUR_STEP = 0.03
"""Step of all harmonics; spz has 1 / (0.15 * 255) for the base colour, more for the others."""
QUATERNION_STEP = 1 / 128
"""Step of the entries of unit quaternions: 8 bits, signed."""
POSITION_BITS = 14
"""Positions have 2^14 steps along the longest side of the scene, its farthest percent excluded."""
CODEBOOK, PALETTE = 256, 1024
"""Entries for single numbers, and for the harmonics above degree 0; .sog has 1024 or more."""
LLOYD_STEPS = 10
"""Steps of Lloyd's method, a k-means of single numbers."""
CHUNKS, MIN_COUNT = 6, 8
"""Chunks of a streamed scene, and Gaussians that a scene has at least."""


class Exported(NamedTuple):
    """A scene after an export, and the row of the original that each row stems from, (M,)."""

    gaussians: Gaussians
    rows: np.ndarray


Exporter = Callable[[Gaussians, np.random.Generator], Exported]


def export(gaussians: Gaussians, exporter: str, *, seed: int = 0) -> Exported:
    """Export a scene.

    Args:
        gaussians: N Gaussians, at least 8, all of which can be rendered.
        exporter: One of `EXPORTERS`.
        seed: Seed of all random choices.

    Returns:
        M Gaussians, NumPy float32.

    Raises:
        ValueError: if the exporter is unknown, or the scene has too few Gaussians, or such that
            cannot be rendered.
        InputError: if gsply is needed and not installed.
    """
    if exporter not in EXPORTERS:
        raise ValueError(f"exporter must be one of {', '.join(EXPORTERS)}, got {exporter!r}")
    host = jax.tree.map(lambda leaf: np.asarray(leaf, np.float32), gaussians)
    usable = int(usable_rows(host).sum())
    if not MIN_COUNT <= usable == len(host):
        raise ValueError(
            f"expected at least {MIN_COUNT} Gaussians that can all be rendered, got {len(host)}, "
            f"of which {usable} can"
        )
    return EXPORTERS[exporter](host, np.random.default_rng(seed))


def _same_rows(change: Callable[[Gaussians, np.random.Generator], Gaussians]) -> Exporter:
    return lambda gaussians, rng: Exported(change(gaussians, rng), np.arange(len(gaussians)))


def _selected(choose: Callable[[Gaussians, np.random.Generator], np.ndarray]) -> Exporter:
    def selected(gaussians: Gaussians, rng: np.random.Generator) -> Exported:
        rows = choose(gaussians, rng)
        return Exported(gaussians.take(rows), rows)

    return selected


def requantised(gaussians: Gaussians, rng: np.random.Generator, *, rounded: bool) -> Gaussians:
    """Add noise of up to one quantisation step to all rows, and round them to it.

    The noise hides an earlier quantisation of about the same step. Quaternions have w >= 0 before
    the noise.
    """

    def noisy_steps(values: np.ndarray, step: float) -> np.ndarray:
        # Triangular noise: after uniform noise, rounding would restore values on the lattice.
        noise = rng.random(values.shape, np.float32) - rng.random(values.shape, np.float32)
        noisy = values + step * noise
        return (np.round(noisy / step) * step if rounded else noisy).astype(np.float32)

    extent = np.ptp(np.nanpercentile(gaussians.means, [1, 99], axis=0), axis=0).max()
    opacities = noisy_steps(np.asarray(gaussians.opacities), OPACITY_STEP)
    quats = noisy_steps(unit_quats(gaussians), QUATERNION_STEP)
    return dataclasses.replace(
        gaussians,
        means=noisy_steps(np.asarray(gaussians.means), max(extent, 1e-6) / 2**POSITION_BITS),
        log_scales=noisy_steps(np.asarray(gaussians.log_scales), SCALE_STEP),
        quats=quats / np.maximum(np.linalg.norm(quats, axis=1, keepdims=True), 1e-6),
        logit_opacities=logits(opacities),
        sh=noisy_steps(np.asarray(gaussians.sh), COLOUR_STEP),
    )


def spz(gaussians: Gaussians, _: np.random.Generator) -> Gaussians:
    """Write and read a .spz: fixed-point positions, 8 bits, harmonics of 4 or 5 bits."""
    gsply = _gsply()
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.spz"
        gsply.write_spz(path, _as_gsply(gaussians))
        return from_gsply(gsply.read_spz(path))


def compressed_ply(gaussians: Gaussians, _: np.random.Generator) -> Exported:
    """Write and read a .compressed.ply: 11, 10 and 11 bits within chunks of 256 Gaussians.

    Chunks are cut in Morton order, as splat-transform does; gsply alone keeps the order.
    """
    gsply, rows = _gsply(), morton_order(np.asarray(gaussians.means))
    data = gsply.compress_to_bytes(_as_gsply(gaussians.take(rows)))
    return Exported(from_gsply(gsply.decompress_from_bytes(data)), rows)


def palettes(gaussians: Gaussians, rng: np.random.Generator) -> Gaussians:
    """Round as .sog does, with a smaller palette of harmonics and in the same order.

    Positions have 16 bits of a logarithm, opacities and quaternions 8 bits, scales and colours come
    from codebooks, all other harmonics of a Gaussian from a palette.
    """
    means = np.sign(gaussians.means) * np.log1p(np.abs(gaussians.means))
    low, step = means.min(axis=0), np.maximum(np.ptp(means, axis=0), 1e-12) / (2**16 - 1)
    means = low + np.round((means - low) / step) * step
    sh = np.array(gaussians.sh)
    sh[:, 0] = _codebook(sh[:, 0])
    if sh.shape[1] > 1:
        sh[:, 1:] = _palette(sh[:, 1:].reshape(len(sh), -1), rng).reshape(sh[:, 1:].shape)
    quats = np.asarray(gaussians.rotations)
    largest = np.take_along_axis(quats, np.abs(quats).argmax(axis=1)[:, None], axis=1)
    quats = np.round(quats * np.sign(largest) * 2**0.5 * 127) / (2**0.5 * 127)
    return Gaussians(
        means=(np.sign(means) * np.expm1(np.abs(means))).astype(np.float32),
        log_scales=_codebook(np.asarray(gaussians.log_scales)),
        quats=(quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        logit_opacities=logits(np.round(255 * expit(gaussians.logit_opacities)) / 255),
        sh=sh,
    )


def splat(gaussians: Gaussians, rng: np.random.Generator) -> Exported:
    """Round as .splat does: colour, opacity and rotation in 8 bits, no harmonics, largest first."""
    sizes = np.asarray(gaussians.log_scales, np.float64).sum(axis=1)
    rows = np.argsort(-np.exp(sizes) * expit(gaussians.logit_opacities), kind="stable")
    plain = without_harmonics(gaussians.take(rows), rng)
    colors = np.floor(255 * np.clip(0.5 + Y0 * np.asarray(plain.sh), 0, 1)) / 255
    quats = np.clip(np.floor(128 * np.asarray(plain.rotations)), -128, 127) / 128
    return Exported(
        dataclasses.replace(
            plain,
            quats=quats.astype(np.float32),
            logit_opacities=logits(np.floor(255 * expit(plain.logit_opacities)) / 255),
            sh=((colors - 0.5) / Y0).astype(np.float32),
        ),
        rows,
    )


def without_harmonics(gaussians: Gaussians, _: np.random.Generator) -> Gaussians:
    """Drop the colours that depend on the direction."""
    return dataclasses.replace(gaussians, sh=np.asarray(gaussians.sh)[:, :1])


def streamed(gaussians: Gaussians, rng: np.random.Generator) -> Exported:
    """The chunks of a streamed scene, each with palettes of its own, one after the other."""
    parts = np.array_split(morton_order(np.asarray(gaussians.means)), CHUNKS)
    chunks = [palettes(gaussians.take(rows), rng) for rows in parts]
    return Exported(concatenate(chunks), np.concatenate(parts))


def _gsply():
    try:
        return importlib.import_module("gsply")
    except ImportError as error:
        raise InputError("this exporter needs gsply: pip install 'gsc_jax[formats]'") from error


def _as_gsply(gaussians: Gaussians):
    sh = np.ascontiguousarray(gaussians.sh)
    return _gsply().GSData(
        means=np.ascontiguousarray(gaussians.means),
        scales=np.ascontiguousarray(gaussians.log_scales),
        quats=unit_quats(gaussians),
        opacities=np.ascontiguousarray(gaussians.logit_opacities),
        sh0=np.ascontiguousarray(sh[:, 0]),
        shN=np.ascontiguousarray(sh[:, 1:]) if sh.shape[1] > 1 else None,
    )


def _codebook(values: np.ndarray) -> np.ndarray:
    """Values rounded to `CODEBOOK` numbers: quantiles, improved by Lloyd's method."""
    flat = values.ravel()

    def nearest(entries: np.ndarray) -> np.ndarray:
        return np.searchsorted((entries[1:] + entries[:-1]) / 2, flat)

    entries = np.quantile(flat, (np.arange(CODEBOOK) + 0.5) / CODEBOOK)
    for _ in range(LLOYD_STEPS):
        index = nearest(entries)
        counts, sums = (np.bincount(index, weights, CODEBOOK) for weights in (None, flat))
        entries = np.where(counts > 0, sums / np.maximum(counts, 1), entries)
    return entries[nearest(entries)].reshape(values.shape).astype(np.float32)


def _palette(rows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Rows (N, D) replaced by the nearest of at most `PALETTE` of them."""
    from scipy.cluster.vq import vq

    entries = rows[rng.permutation(len(rows))[:PALETTE]]
    return entries[vq(rows, entries)[0]]


EXPORTERS: dict[str, Exporter] = {
    "8 bits": _same_rows(functools.partial(requantised, rounded=True)),
    "float": _same_rows(functools.partial(requantised, rounded=False)),
    "spz": _same_rows(spz),
    "compressed.ply": compressed_ply,
    "palettes": _same_rows(palettes),
    "splat": splat,
    "no harmonics": _same_rows(without_harmonics),
    "streamed": streamed,
    "moved": _same_rows(histories.moved),
    **{name: _selected(rows) for name, rows in histories.SELECTIONS.items()},
    "level of detail": lambda gaussians, _: Exported(*histories.level_of_detail(gaussians)),
}
"""Exporters and harmless histories by name; each keeps an authentic scene authentic."""
