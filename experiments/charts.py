"""Charts of the experiments, in colours for all kinds of colour vision."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
import pandas as pd
from tables import Frame, spread, where

from gsc_jax.io.files import atomic

mpl.use("Agg")
from matplotlib import pyplot as plt

COLORS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000", "#999999")
"""Okabe and Ito's palette."""
MARKERS = "osD^vP*Xph<>8Hd"


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


def curves(
    panels: Mapping[str, Frame],
    path: Path,
    *,
    x: str,
    labels: tuple[str, str],
    columns: int = 3,
) -> None:
    """F1 against a number: a panel per title, a line per method, its spread over seeds."""
    names = pd.concat(panels.values()).method.unique()
    count = -(-len(panels) // columns)
    size = (4.0 * min(columns, len(panels)), 3.0 * count + 0.7)
    figure, axes = plt.subplots(
        count, min(columns, len(panels)), figsize=size, squeeze=False, layout="constrained"
    )
    for axis in axes.flat[len(panels) :]:
        axis.set_visible(False)
    for axis, (title, rows) in zip(axes.flat, panels.items(), strict=False):
        for k, name in enumerate(names):
            groups = where(rows, method=name).groupby(x)
            middle = groups.f1.mean()
            around = np.array([spread(group) for _, group in groups])
            color, style = COLORS[k % len(COLORS)], "-" if k < len(COLORS) else "--"
            axis.plot(middle.index, middle, style, marker=MARKERS[k], ms=4, color=color, label=name)
            axis.fill_between(
                middle.index, middle - around, middle + around, color=color, alpha=0.12
            )
        axis.set(title=title, xlabel=labels[0], ylabel=labels[1], ylim=(-0.03, 1.03))
        axis.grid(visible=True, alpha=0.25)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    save(figure, path)


def pareto(points: Frame, front: Mapping[str, Any], path: Path) -> None:
    """F1 against seconds, and a line through the Pareto front, whose points are labelled.

    A colour per method, hollow for its variants; a marker per number of views; the size is the
    scale of the images; the number of epochs stands beside a point where it varies.
    """
    figure, axis = plt.subplots(figsize=(10.5, 6.5), layout="constrained")
    names, scales = points.method.unique(), points.scale.unique()
    views = sorted(points["views"].unique())
    bases = list(dict.fromkeys(name.split(",")[0] for name in names))

    def draw(x: float, y: float, name: str, k: int = 0, scale: float = 0.5, **style: Any) -> Any:
        color = COLORS[bases.index(name.split(",")[0])] if name else "#444444"
        face, size = "none" if "," in name else color, 12 + 70 * scale
        style = {"fc": face, "ec": color, "marker": MARKERS[k], "s": size, **style}
        return axis.scatter(x, y, alpha=0.75, linewidths=1.2, **style)

    for _, p in points.iterrows():
        at = p["seconds"], p["f1"]
        draw(*at, p["method"], views.index(p["views"]), p["scale"])
        axis.annotate(p["epochs"], at, (5, -3), textcoords="offset points", fontsize=6.5)
    away = float("nan"), float("nan")
    handles = [draw(*away, name, label=name) for name in names]
    handles += [draw(*away, "", k, label=f"{view} views") for k, view in enumerate(views)]
    handles += [draw(*away, "", scale=scale, label=f"scale {scale:g}") for scale in scales]
    x, y = ([point[key] for point in front.values()] for key in ("seconds", "f1"))
    last = points.seconds.max()
    axis.step([*x, last], [*y, y[-1]], where="post", color="black", lw=1)
    for k, (label, p) in enumerate(front.items(), start=1):
        at = p["seconds"], p["f1"]
        axis.annotate(str(k), at, (-4, 7), textcoords="offset points", ha="right", fontsize=9)
        handles += axis.plot([], [], " ", label=f"{k}: {label}")
    axis.set(xscale="log", xlabel="seconds after the detector", ylabel="F1", ylim=(-0.03, 1.03))
    axis.grid(visible=True, alpha=0.25)
    figure.legend(handles=handles, loc="outside right center", fontsize=8)
    save(figure, path)
