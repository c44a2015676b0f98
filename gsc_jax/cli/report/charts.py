"""The charts of the report: what is drawn, and the sentence that says what to see in it.

Groups differ by how they are drawn, too, not by colour alone: what is tampered is filled, what is
authentic is a dashed line; what masks are worth has a marker of its own for each word.
"""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from gsc_jax.cli.report import svg
from gsc_jax.cli.report.properties import Property, properties
from gsc_jax.cli.report.wording import WORTH, share
from gsc_jax.estimators.protocol import Reliability
from gsc_jax.estimators.robust.estimator import RobustConfig
from gsc_jax.locate import Result
from gsc_jax.scene import Gaussians

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BINS = 60
FAR = 0.0005
"""Share of the values at either end that the outermost bars collect."""
SURE = math.log(9)
"""Log odds of 90%."""
SHARES = (0, 0.01, 0.05, 0.2, 0.5, 1)
MARKERS: Mapping[Reliability | None, str] = {
    "finds": "o",
    "inverted": "D",
    "misses": "v",
    "unseen": "x",
    None: "o",
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class Chart:
    """A chart of the page.

    Attributes:
        name: Unique on the page.
        title: Its heading.
        said: What is to be seen in it, in a sentence or two.
        svg: The drawing, an element of HTML.
    """

    name: str
    title: str
    said: str
    svg: str


def attribute_chart(result: Result) -> Chart:
    """The attribute of the Gaussians that were seen, and from where on they are tampered."""
    title, level = "Histogram of the attribute", attribute_level(result)
    values, labels = result.attribute[result.seen], result.labels[result.seen]
    edges = _edges(values, level)
    odds = isinstance(result.config, RobustConfig)
    with svg.drawing(4.4, 3.4) as (figure, axes):
        for group, draw in ((labels, _tampered), (~labels, _authentic)):
            if group.any():
                inside = np.clip(values[group], edges[0], edges[-1])
                draw(axes, np.histogram(inside, edges)[0], edges)
        if level is not None:
            axes.axvline(level, color=svg.INK, linewidth=1.2)
            place = {"xycoords": ("data", "axes fraction"), "va": "bottom", "ha": "center"}
            axes.annotate("threshold", (level, 1.03), **place)
        axes.set_yscale("symlog", linthresh=1)
        label = "attribute: log odds of being tampered" if odds else "attribute r"
        axes.set(ylim=(0, None), ylabel="Gaussians", xlabel=label)
        drawn = svg.inline_svg(figure, name="attribute", title=title)
    return Chart(name="attribute", title=title, said=_level_sentence(result, level), svg=drawn)


def attribute_level(result: Result) -> float | None:
    """The attribute from which on a Gaussian is tampered; None where it decides nothing."""
    threshold = result.config.threshold
    if isinstance(result.config, RobustConfig):
        return math.log(threshold / (1 - threshold)) if threshold > 0 else None
    largest = float(result.attribute[result.seen].max(initial=0.0))
    return threshold * largest if largest > 0 else None


def views_chart(views: Sequence[Mapping[str, Any]]) -> Chart | None:
    """What the detector flagged against what was found, a mark per view.

    Args:
        views: `per_view` of result.json.

    Returns:
        The chart; None where no detector was asked.
    """
    judged = [view for view in views if view["detector_share"] is not None]
    if not judged:
        return None
    title = "Detector against result, by view"
    with svg.drawing(4.4, 3.4) as (figure, axes):
        axes.plot([0, 1], [0, 1], color=svg.GRID, linewidth=1.2)
        for worth in MARKERS:
            _mark(axes, [view for view in judged if view["reliability"] == worth], worth)
        _root_axes(axes)
        axes.set(xlabel="flagged by the detector", ylabel="found")
        if any(view["reliability"] for view in judged):
            axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
        drawn = svg.inline_svg(figure, name="views-chart", title=title)
    said = (
        f"A mark per view, by the share of its pixels: on average the detector flags "
        f"{share(_mean(judged, 'detector_share'))}, and {share(_mean(judged, 'tampered_share'))} "
        "was found. On the line both are the same; far to the right of it lie masks that flag too "
        "much, left of it those that miss it."
    )
    return Chart(name="views-chart", title=title, said=said, svg=drawn)


def groups_chart(sizes: np.ndarray) -> Chart | None:
    """Sizes of G_h, G_m and G_l by iteration, (I, 3); None of methods that have no such groups."""
    if not len(sizes):
        return None
    title, steps = "Groups of the optimisation", np.arange(1, len(sizes) + 1)
    styles = ((svg.TAMPERED, "-", "G_h, high"), (svg.THIRD, ":", "G_m, middle"))
    styles += ((svg.AUTHENTIC, "--", "G_l, low"),)
    with svg.drawing(4.4, 3.4) as (figure, axes):
        for column, (color, style, label) in zip(sizes.T, styles, strict=True):
            axes.plot(steps, column, style, color=color, label=label, drawstyle="steps-mid")
        axes.set_yscale("symlog", linthresh=1)
        axes.set(ylim=(0, None), xlabel="iteration", ylabel="Gaussians")
        axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3)
        drawn = svg.inline_svg(figure, name="groups", title=title)
    high, middle, low = sizes[-1]
    said = (
        "The 3D contrastive loss pulls the middle group to the one that it resembles, and needs "
        f"all three: at the end they hold {high:,}, {middle:,} and {low:,} Gaussians. Counts are "
        "on a logarithmic scale."
    )
    return Chart(name="groups", title=title, said=said, svg=drawn)


def property_charts(gaussians: Gaussians, result: Result) -> list[Chart]:
    """How properties of tampered and of authentic Gaussians are distributed; perhaps none."""
    told = properties(gaussians, result.labels, result.seen)
    return [_property_chart(one) for one in told]


def _property_chart(told: Property) -> Chart:
    tampered, authentic, edges = told.densities(BINS)
    name, common = f"property-{told.name}", np.minimum(tampered, authentic).sum()
    with svg.drawing(3.1, 2.0) as (figure, axes):
        _tampered(axes, tampered, edges)
        _authentic(axes, authentic, edges)
        axes.set(ylim=(0, None), yticks=[], xlabel=told.unit)
        axes.locator_params(axis="x", nbins=5)
        axes.spines["left"].set_visible(False)
        title = f"{told.title} of tampered and of authentic Gaussians"
        drawn = svg.inline_svg(figure, name=name, title=title)
    said = (
        f"Medians: tampered {np.median(told.tampered):.3g}, authentic "
        f"{np.median(told.authentic):.3g}; {common:.0%} in common."
    )
    return Chart(name=name, title=told.title, said=said, svg=drawn)


def _level_sentence(result: Result, level: float | None) -> str:
    """What is to be seen in the histogram."""
    values, found = result.attribute[result.seen], int((result.labels & result.seen).sum())
    seen = f"{len(values):,} Gaussians that were seen"
    unseen = int(result.labels.sum()) - found
    also = f" Called tampered besides: {unseen:,} that no view shows." if unseen else ""
    if level is None:
        return f"No threshold applies; {found:,} of the {seen} are called tampered.{also}"
    beyond = int((values > level).sum())
    if found == beyond == 0:
        said = f"None of the {seen} lies right of the line, so none is called tampered."
    elif found == beyond:
        said = f"Right of the line lie {beyond:,} of the {seen}: these are called tampered."
    else:
        said = (
            f"Right of the line lie {beyond:,} of the {seen}; called tampered are {found:,}, as "
            "the evidence on the whole scene has a say, too."
        )
    said += also
    if isinstance(result.config, RobustConfig):
        unsure = int((np.abs(values) < SURE).sum())
        said += f" {unsure:,} lie between 10% and 90%, where more evidence could decide otherwise."
    else:
        said += f" The line is at {result.config.threshold:g} of the largest value."
    return f"{said} Counts are on a logarithmic scale."


def _edges(values: np.ndarray, level: float | None) -> np.ndarray:
    """Edges of bins that hold nearly all of the values, one of them at the threshold."""
    low, high = np.quantile(values, [FAR, 1 - FAR]) if len(values) else (0.0, 0.0)
    middle = float(low) if level is None else level
    low, high = min(low, middle), max(high, middle)
    step = max(high - low, 1e-3) / BINS
    below, above = math.floor((low - middle) / step), math.ceil((high - middle) / step)
    return middle + step * np.arange(below - 1, above + 2)


def _tampered(axes: "Axes", heights: np.ndarray, edges: np.ndarray) -> None:
    axes.stairs(heights, edges, fill=True, color=svg.TAMPERED, alpha=0.35)
    axes.stairs(heights, edges, color=svg.TAMPERED, linewidth=1.2)


def _authentic(axes: "Axes", heights: np.ndarray, edges: np.ndarray) -> None:
    axes.stairs(heights, edges, color=svg.AUTHENTIC, linewidth=1.4, linestyle="--")


def _mark(axes: "Axes", views: list[Mapping[str, Any]], worth: Reliability | None) -> None:
    """The views of one worth."""
    if not views:
        return
    color = svg.TAMPERED if worth in ("finds", None) else svg.AUTHENTIC
    axes.plot(
        [view["detector_share"] for view in views],
        [view["tampered_share"] for view in views],
        MARKERS[worth],
        label=f"{WORTH[worth].short} ({len(views)})" if worth else f"not known ({len(views)})",
        color=color,
        markerfacecolor=color if worth == "finds" else "none",
        markersize=6,
        clip_on=False,
    )


def _root_axes(axes: "Axes") -> None:
    """Both axes from 0 to 100%, with room for what is small."""
    labels = [f"{tick:.0%}" for tick in SHARES]
    axes.set_xscale("function", functions=(_root, np.square))
    axes.set_yscale("function", functions=(_root, np.square))
    axes.set(xlim=(0, 1), ylim=(0, 1))
    axes.set_xticks(SHARES, labels)
    axes.set_yticks(SHARES, labels)


def _root(values: np.ndarray) -> np.ndarray:
    return np.sqrt(np.maximum(values, 0))


def _mean(views: Sequence[Mapping[str, Any]], key: str) -> float:
    return float(np.mean([view[key] for view in views]))
