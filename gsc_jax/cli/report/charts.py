"""The chart of the report: the histogram of the scores.

The two groups differ in shape as well as in colour: tampered is filled, authentic a dashed line. A
chart is an SVG of matplotlib inside the page, whose style sheet determines its colours.
"""

import io
from typing import Any, NamedTuple

import numpy as np

from gsc_jax.cli.report.wording import are_candidates
from gsc_jax.locate import Result

COLOURS = INK, MUTED, TAMPERED, AUTHENTIC = "#111111", "#222222", "#333333", "#444444"
VARIABLES = "ink", "muted", "tampered", "authentic"
"""Colours in which matplotlib draws, and the variables of report.css that replace them."""
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
SCORE_BINS = 50
"""Bins of width 0.02, so that the thresholds of all methods (0.1 and 0.5) lie between two bins."""


class Chart(NamedTuple):
    """A chart: sentences about it, and its SVG element."""

    text: str
    svg: str


def score_histogram(result: Result) -> Chart:
    """Histogram of the scores of visible Gaussians, with the threshold."""
    import matplotlib
    from matplotlib.figure import Figure

    noun = "candidates" if are_candidates(result.verdict) else "labelled as tampered"
    threshold, file = result.estimator.threshold, io.StringIO()
    scores, labels = result.tamper[result.seen], result.labels[result.seen]
    with matplotlib.rc_context(STYLE):
        figure, edges = Figure((4.4, 3.0)), np.linspace(0, 1, SCORE_BINS + 1)
        tampered, authentic = (np.histogram(scores[x], edges)[0] for x in (labels, ~labels))
        axes = figure.add_axes((0.13, 0.15, 0.85, 0.65))  # a layout engine would draw it twice
        axes.stairs(tampered, edges, fill=True, color="C0", alpha=0.35, label=noun.split()[0])
        axes.stairs(tampered, edges, color="C0", linewidth=1.2)
        axes.stairs(authentic, edges, color="C1", linestyle="--", label="others")
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.08), ncols=2, frameon=False)
        axes.axvline(threshold, color="0.5")
        axes.text(threshold, 1.03, "threshold", transform=axes.get_xaxis_transform(), ha="center")
        axes.set_yscale("symlog", linthresh=1)
        axes.set(xlim=(0, 1), ylim=(0, None), xlabel="score", ylabel="Gaussians")
        figure.savefig(file, format="svg", transparent=True)
    _, start, drawn = file.getvalue().partition("<g ")
    svg = f'<svg viewBox="0 0 316.8 216">{start}{drawn}'  # 72 units are an inch
    for colour, name in zip(COLOURS, VARIABLES, strict=True):
        svg = svg.replace(colour, f"var(--{name})")
    above = int((scores > threshold).sum())
    hidden = int(result.labels.sum() - labels.sum())
    text = (
        f"{above:,} of {len(scores):,} visible Gaussians score above the threshold of "
        f"{threshold:g}; {int(labels.sum()):,} of them are {noun}"
        f"{f', and {hidden:,} that no view shows' if hidden else ''}. Counts are on a logarithmic "
        "scale."
    )
    return Chart(text, svg)
