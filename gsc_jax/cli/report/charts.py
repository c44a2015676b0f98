"""The charts of the report: histogram of the scores, distributions of attributes.

The two groups differ in shape as well as in colour: tampered is filled, authentic a dashed line.
"""

from typing import TYPE_CHECKING

import numpy as np

from gsc_jax.cli.report.attributes import Distribution, attribute_distributions
from gsc_jax.cli.report.figure import Chart, chart
from gsc_jax.locate import Result
from gsc_jax.scene import Gaussians

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SCORE_BINS = 50
"""Bins of width 0.02, so that the thresholds of all methods (0.1 and 0.5) lie between two bins."""
ATTRIBUTE_BINS = 60


def score_histogram(result: Result) -> Chart:
    """Histogram of the scores of visible Gaussians, with the threshold."""
    threshold = result.estimator.threshold
    scores, labels = result.tamper[result.seen], result.labels[result.seen]
    edges = np.linspace(0, 1, SCORE_BINS + 1)

    def plot(axes: "Axes") -> None:
        _draw_tampered(axes, np.histogram(scores[labels], edges)[0], edges)
        _draw_authentic(axes, np.histogram(scores[~labels], edges)[0], edges)
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
    """A chart per attribute of the visible tampered and authentic Gaussians; perhaps none."""
    found = attribute_distributions(gaussians, result.labels, result.seen)
    return [_attribute_chart(distribution) for distribution in found]


def _attribute_chart(distribution: Distribution) -> Chart:
    tampered, authentic, edges = distribution.shares(ATTRIBUTE_BINS)

    def plot(axes: "Axes") -> None:
        _draw_tampered(axes, tampered, edges)
        _draw_authentic(axes, authentic, edges)
        axes.set(ylim=(0, None), yticks=[], xlabel=distribution.unit)
        axes.locator_params(axis="x", nbins=5)
        axes.spines["left"].set_visible(False)

    text = (
        f"Medians: tampered {np.median(distribution.tampered):.3g}, authentic "
        f"{np.median(distribution.authentic):.3g}; overlap "
        f"{np.minimum(tampered, authentic).sum():.0%}."
    )
    return chart(plot, title=distribution.title, text=text, size=(3.1, 2.0))


def _draw_tampered(axes: "Axes", heights: np.ndarray, edges: np.ndarray) -> None:
    axes.stairs(heights, edges, fill=True, color="C0", alpha=0.35)
    axes.stairs(heights, edges, color="C0", linewidth=1.2)


def _draw_authentic(axes: "Axes", heights: np.ndarray, edges: np.ndarray) -> None:
    axes.stairs(heights, edges, color="C1", linewidth=1.4, linestyle="--")
