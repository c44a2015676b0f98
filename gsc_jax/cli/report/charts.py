"""The charts of the report: histogram of the scores, distributions of attributes (GS-Checker).

The two groups differ in shape as well as in colour: tampered is filled, authentic a dashed line. A
chart is an SVG of matplotlib in the colours of a light and of a dark scheme, of which the page
selects one. Colours C0 (tampered) and C1 (authentic) repeat those of report.css.
"""

import dataclasses
import io
from base64 import b64encode
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import jax
import numpy as np

from gsc_jax.io.ply import LUMA
from gsc_jax.locate import Result
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Gaussians
from gsc_jax.scene.parallel import in_blocks

if TYPE_CHECKING:
    from matplotlib.axes import Axes

LIGHT = INK, MUTED, TAMPERED, AUTHENTIC = "#1c1b1a", "#5c5954", "#b3004b", "#22588f"
DARK = "#ebe8e3", "#aba69e", "#ff7fae", "#85b8ee"
STYLE: dict[Any, Any] = {
    "svg.fonttype": "none",
    "svg.hashsalt": "gsc_jax",  # reproducible ids
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.prop_cycle": f"cycler(color=['{TAMPERED}', '{AUTHENTIC}'])",
    **dict.fromkeys(("text.color", "axes.labelcolor", "xtick.labelcolor", "ytick.labelcolor"), INK),
    **dict.fromkeys(("axes.edgecolor", "xtick.color", "ytick.color"), MUTED),
}


@dataclasses.dataclass(frozen=True)
class Chart:
    """A chart: heading, sentences, and its image for each scheme as a data URI."""

    title: str
    text: str
    light: str
    dark: str


def chart(
    plot: "Callable[[Axes], object]", *, title: str, text: str, size: tuple[float, float]
) -> Chart:
    """Draw a chart in both colour schemes; `size` is in inches, with text of 9 points."""
    import matplotlib
    from matplotlib.figure import Figure

    file = io.StringIO()
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=size, layout="constrained")
        plot(figure.subplots())
        figure.savefig(file, format="svg", transparent=True, metadata={"Date": None})
    light = dark = file.getvalue()
    for one, other in zip(LIGHT, DARK, strict=True):
        dark = dark.replace(one, other)
    uris = ("data:image/svg+xml;base64," + b64encode(x.encode()).decode() for x in (light, dark))
    return Chart(title, text, *uris)


MIN_LOG_SCALE = -30.0
"""Floor of log scales: flat Gaussians are stored with scales down to exp(-100)."""
MAX_SAMPLE = 2**19
"""More Gaussians would change no chart visibly, and take memory."""


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


SCORE_BINS = 50
"""Bins of width 0.02, so that the thresholds of all methods (0.1 and 0.5) lie between two bins."""
ATTRIBUTE_BINS = 60


def score_histogram(result: Result) -> Chart:
    """Histogram of the scores of visible Gaussians, with the threshold."""
    threshold = result.estimator.threshold
    scores, labels = result.tamper[result.seen], result.labels[result.seen]
    edges = np.linspace(0, 1, SCORE_BINS + 1)

    def plot(axes: "Axes") -> None:
        groups = scores[labels], scores[~labels]
        _draw(axes, [np.histogram(group, edges)[0] for group in groups], edges)
        axes.axvline(threshold, color="0.5")
        axes.annotate(
            "threshold", (threshold, 1.03), xycoords=("data", "axes fraction"), ha="center"
        )
        axes.set_yscale("symlog", linthresh=1)
        axes.set(xlim=(0, 1), ylim=(0, None), xlabel="score", ylabel="Gaussians")

    above = int((scores > threshold).sum())
    hidden = int(result.labels.sum() - labels.sum())
    text = (
        f"{above:,} of {len(scores):,} visible Gaussians score above the threshold of "
        f"{threshold:g}; {int(labels.sum()):,} of them are labelled as tampered"
        f"{f', and {hidden:,} that no view shows' if hidden else ''}. Counts are on a logarithmic "
        "scale."
    )
    return chart(plot, title="Histogram of the scores", text=text, size=(4.4, 3.0))


def attribute_charts(gaussians: Gaussians, result: Result) -> list[Chart]:
    """A chart per attribute of the visible tampered and authentic Gaussians; none without both.

    Of large scenes, at most `MAX_SAMPLE` Gaussians at even distances in the file are used.
    """
    sample = slice(None, None, -(-len(result.labels) // MAX_SAMPLE) or None)
    host = jax.tree.map(np.asarray, gaussians).take(sample)
    labels, seen = result.labels[sample], result.seen[sample]
    groups = seen & labels, seen & ~labels
    if not all(group.any() for group in groups):
        return []
    return [
        _attribute_chart(title, unit, [values[group] for group in groups])
        for title, unit, values in attributes(host)
    ]


def _attribute_chart(title: str, unit: str, groups: Sequence[np.ndarray]) -> Chart:
    heights, edges = shares(groups, ATTRIBUTE_BINS)

    def plot(axes: "Axes") -> None:
        _draw(axes, heights, edges)
        axes.set(ylim=(0, None), yticks=[], xlabel=unit)
        axes.locator_params(axis="x", nbins=5)
        axes.spines["left"].set_visible(False)

    medians = [np.median(group) for group in groups]
    overlap = np.minimum(*heights).sum()
    text = f"Medians: {medians[0]:.3g}, others {medians[1]:.3g}; overlap {overlap:.0%}."
    return chart(plot, title=title, text=text, size=(3.1, 2.0))


def _draw(axes: "Axes", heights: Sequence[np.ndarray], edges: np.ndarray) -> None:
    tampered, authentic = heights
    axes.stairs(tampered, edges, fill=True, color="C0", alpha=0.35)
    axes.stairs(tampered, edges, color="C0", linewidth=1.2)
    axes.stairs(authentic, edges, color="C1", linewidth=1.4, linestyle="--")
