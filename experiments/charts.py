"""Charts of the experiments, in colours for all kinds of colour vision."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from tables import Frame, front_of, spread, where

from gsc_jax.io.files import atomic

mpl.use("Agg")
from matplotlib import pyplot as plt

COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#999999")
"""Okabe and Ito's palette."""
MARKERS = "osD^vP*Xph<>8Hd"
BLACK = "#000000"
"""The colour of `robust`, which is drawn in front and wider."""
FAMILIES: Mapping[str, str] = dict.fromkeys(
    ("inverse projection", "mode vote", "SAGD vote"), "votes"
)
"""Families of methods whose names do not begin with the same word."""
DASHES = "-", "--", ":", "-."
"""Line styles that tell the methods of one colour apart."""


def save(figure: Any, path: Path) -> None:
    """Write a figure, under a temporary name first, and close it."""
    with atomic(path) as temporary:
        figure.savefig(temporary, dpi=130, format="png")
    plt.close(figure)


def grid(rows: Frame, path: Path, *, panels: str = "edit", across: str = "regime") -> None:
    """Mean F1 as numbers on colours: methods down, a panel for each kind of edit."""
    names, titles, columns = (list(rows[key].unique()) for key in ("method", panels, across))
    size = (1.9 + 0.62 * len(columns) * len(titles), 1.4 + 0.3 * len(names))
    figure, axes = plt.subplots(1, len(titles), figsize=size, squeeze=False, layout="constrained")
    for axis, title in zip(axes[0], titles, strict=True):
        means = where(rows, **{panels: title}).groupby(["method", across]).f1.mean().unstack()
        values = means.reindex(index=names, columns=columns).to_numpy()
        axis.imshow(values, cmap="cividis", vmin=0, vmax=1, aspect="auto")
        for (y, x), value in np.ndenumerate(values):
            color = "white" if value < 0.55 else "black"
            text = "-" if np.isnan(value) else f"{value:.2f}"
            axis.text(x, y, text, ha="center", va="center", fontsize=7.5, color=color)
        axis.set_title(title, fontsize=10)
        axis.set_xticks(range(len(columns)), columns, rotation=40, ha="right", fontsize=8)
        axis.set_yticks(range(len(names)), names if axis is axes[0, 0] else [], fontsize=8)
    save(figure, path)


def line_styles(names: Sequence[str]) -> dict[str, dict[str, Any]]:
    """Line options of Matplotlib for each method.

    The methods of a family, such as the variants of GS-Checker, have one colour, and each of them
    another line style.
    """
    members: dict[str, list[str]] = {}
    for name in names:
        members.setdefault(FAMILIES.get(name, name.split(",")[0].split(" ")[0]), []).append(name)
    colors = dict(zip(members, [c for c in COLORS if c != BLACK], strict=False))
    return {
        name: {"color": BLACK, "lw": 2.6, "zorder": 3}
        if name == "robust"
        else {"color": colors[family], "ls": dash, "lw": 1.3}
        for family, own in members.items()
        for name, dash in zip(own, DASHES, strict=False)
    }


def curves(
    panels: Mapping[str, Frame],
    path: Path,
    *,
    x: str,
    labels: tuple[str, str],
    y: str = "f1",
    columns: int = 3,
    crosses: Mapping[tuple[str, str], tuple[float, float]] | None = None,
) -> None:
    """A score against a number: a panel per title, a line per method, its spread over seeds.

    A cross marks a point of the curve of a method, by title and method.
    """
    styles = line_styles(pd.concat(panels.values()).method.unique())
    count = -(-len(panels) // columns)
    size = (4.0 * min(columns, len(panels)), 3.0 * count + 0.7)
    figure, axes = plt.subplots(
        count, min(columns, len(panels)), figsize=size, squeeze=False, layout="constrained"
    )
    for axis in axes.flat[len(panels) :]:
        axis.set_visible(False)
    for axis, (title, rows) in zip(axes.flat, panels.items(), strict=False):
        for name, style in styles.items():
            groups = where(rows, method=name).groupby(x)
            middle = groups[y].mean()
            around = np.array([spread(group, y) for _, group in groups])
            axis.plot(middle.index, middle, marker="o", ms=3, label=name, **style)
            low, high = middle - around, middle + around
            axis.fill_between(middle.index, low, high, color=style["color"], alpha=0.12, lw=0)
            if point := (crosses or {}).get((title, name)):
                axis.plot(*point, "X", ms=8, mec="white", color=style["color"], zorder=4)
        axis.set(title=title, xlabel=labels[0], ylabel=labels[1], ylim=(-0.03, 1.03))
        axis.grid(visible=True, alpha=0.25)
    figure.legend(
        *axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, handlelength=4
    )
    save(figure, path)


def trade_off(
    fronts: Mapping[tuple[str, str], Mapping[str, Frame]],
    titles: Mapping[tuple[str, str], str],
    path: Path,
) -> None:
    """F1 against seconds: a panel per pair of columns, a curve per method, named at the right.

    A curve joins the settings of a method that no faster one of its own reaches; the wide grey line
    is the same over all methods. Bars are the standard deviation over the scenes of the best
    setting. Variants, such as "X, rendered", have the colour of X.
    """
    bases = dict.fromkeys(name.split(",")[0] for name in next(iter(fronts.values())))
    palette = dict(zip(bases, [c for c in COLORS if c != BLACK], strict=False))
    palette["robust"] = BLACK
    figure, axes = plt.subplots(2, 2, figsize=(12.5, 8.5), sharey=True, layout="constrained")
    for axis, ((x, y), curves) in zip(axes.T.flat, fronts.items(), strict=True):
        best = front_of(pd.concat(curves.values()), x, y)
        axis.step(best[x], best[y], where="post", color="#dddddd", lw=8, zorder=0)
        ends = []
        for k, (name, front) in enumerate(curves.items()):
            color, width = palette[name.split(",")[0]], 2.5 if name == "robust" else 1.2
            axis.plot(front[x], front[y], lw=width, color=color, marker=MARKERS[k], ms=5)
            last = front.iloc[-1]
            axis.errorbar(last[x], last[y], last[f"{y}_spread"], color=color, lw=1)
            ends.append((last[x], last[y], name, color))
        axis.set(xscale="log", ylim=(-0.03, 1.05), xlabel="seconds from file to labels")
        axis.set(ylabel="F1", title=titles[x, y])
        axis.margins(x=0.06)
        axis.grid(visible=True, alpha=0.25)
        axis.xaxis.set_major_formatter("{x:g}")
        axis.xaxis.set_minor_formatter("{x:g}" if np.min(best[x]) > 1 else "")
        _name_ends(axis, ends)
    save(figure, path)


def _name_ends(axis: Any, ends: Sequence[tuple[float, float, str, str]]) -> None:
    """Name curves right of a panel, at the height of their ends but apart from each other."""
    height = -1.0
    for x, y, name, color in sorted(ends, key=lambda end: end[1]):
        height = max(y, height + 0.05)
        axis.annotate(
            name,
            (x, y),
            (1.03, height),
            textcoords=axis.get_yaxis_transform(),
            color=color,
            fontsize=8.5,
            weight="bold" if name == "robust" else "normal",
            va="center",
            annotation_clip=False,
            arrowprops={"arrowstyle": "-", "color": color, "lw": 0.5, "alpha": 0.6},
        )
