"""Attributes of the labelled and of the other Gaussians of a run, side by side.

    gsc-jax locate scene.ply --out found
    python experiments/attributes.py found [--out attributes.png]

Gaussians from another training, or with changed shape or colour, seldom have the attributes of
their surroundings: a small overlap is evidence of an edit, a large one is evidence of nothing. The
two groups differ in shape as well as in colour: labelled is filled, other a dashed line.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from pathlib import Path

import charts
import numpy as np
import tyro
from matplotlib import pyplot as plt

from gsc_jax.cli.results import read_results
from gsc_jax.io.ply import LUMA
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Gaussians, InputError
from gsc_jax.scene.parallel import in_blocks

MIN_LOG_SCALE = -30.0
"""Floor of log scales: flat Gaussians are stored with scales down to exp(-100)."""
BINS, COLUMNS = 60, 4


@dataclasses.dataclass(frozen=True, kw_only=True)
class Args:
    """What to draw.

    Attributes:
        found: Folder with the results of `gsc-jax locate`.
        out: The picture.
    """

    found: tyro.conf.Positional[Path]
    out: Path = Path("attributes.png")


def main(args: Args) -> None:
    """Draw a chart per attribute, and print the medians and the overlap."""
    results = read_results(args.found)
    groups = results.labels, ~results.labels
    if not all(group.any() for group in groups):
        raise InputError(f"{args.found}: all Gaussians have the same label; nothing to compare")
    drawn = list(attributes(results.scene.gaussians))
    rows = -(-len(drawn) // COLUMNS)
    size = (3.1 * COLUMNS, 2.3 * rows)
    figure, axes = plt.subplots(rows, COLUMNS, figsize=size, squeeze=False, layout="constrained")
    for axis, (title, unit, values) in zip(axes.flat, drawn, strict=False):
        labelled, other = (values[group] for group in groups)
        heights, edges = shares([labelled, other], BINS)
        axis.stairs(heights[0], edges, fill=True, color=charts.COLORS[1], alpha=0.5)
        axis.stairs(heights[1], edges, color=charts.COLORS[0], linewidth=1.4, linestyle="--")
        axis.set(ylim=(0, None), yticks=[], xlabel=unit)
        overlap = np.minimum(*heights).sum()
        axis.set_title(f"{title}, overlap {overlap:.0%}", fontsize=9)
        medians = f"{np.median(labelled):9.3g} labelled {np.median(other):9.3g} others"
        print(f"{title:16} medians {medians}  overlap {overlap:5.0%}")
    for axis in axes.flat[len(drawn) :]:
        axis.set_visible(False)
    charts.save(figure, args.out)


def shares(groups: Sequence[np.ndarray], bins: int) -> tuple[list[np.ndarray], np.ndarray]:
    """Share of each group per bin, and the edges of the bins.

    The bins span the 0.5% to 99.5% quantiles of all groups; the outermost include the rest.
    """
    quantiles = np.concatenate([np.quantile(group, [0.005, 0.995]) for group in groups])
    low, high = float(quantiles.min()), float(quantiles.max())
    margin = max(high - low, 1e-6 * max(abs(low), 1.0)) / bins
    edges = np.linspace(low - margin, high + margin, bins + 1)
    clipped = [np.clip(group, edges[0], edges[-1]) for group in groups]
    return [np.histogram(group, edges)[0] / len(group) for group in clipped], edges


def attributes(gaussians: Gaussians) -> Iterator[tuple[str, str, np.ndarray]]:
    """Title, unit and values (N,) of each attribute."""
    log_scales = np.maximum(np.asarray(gaussians.log_scales, np.float64), MIN_LOG_SCALE)
    decades = log_scales / np.log(10)
    sh = np.asarray(gaussians.sh)
    rgb = 0.5 + Y0 * sh[:, 0].astype(np.float64)
    quats = np.asarray(gaussians.quats, np.float64)  # a zero one is no rotation
    cos_half_angle = (np.abs(quats[:, 0]) + 1e-30) / (np.linalg.norm(quats, axis=1) + 1e-30)
    yield "Opacity", "from 0 to 1", 0.5 + 0.5 * np.tanh(np.asarray(gaussians.logit_opacities) / 2)
    yield "Size", "log10 of the mean scale, scene units", decades.mean(axis=1)
    yield "Anisotropy", "log10 of longest to shortest axis", np.ptp(decades, axis=1)
    yield "Rotation", "angle in degrees", np.degrees(2 * np.arccos(cos_half_angle))
    yield "Luminance", "of the base colour", rgb @ LUMA
    yield "Saturation", "of the base colour, max minus min", np.ptp(rgb, axis=1)
    if sh.shape[1] > 1:
        rms = np.sqrt(in_blocks(lambda rest: np.asarray(np.mean(rest**2, axis=(1, 2))), sh[:, 1:]))
        yield "View dependence", "log10 RMS of the harmonics", np.log10(rms + 1e-6)


if __name__ == "__main__":
    main(tyro.cli(Args, description=__doc__))
