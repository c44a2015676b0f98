"""F1 against seconds: every estimator over its budgets of views, pixels and iterations.

    python experiments/speed_accuracy.py [--quick] [--out docs]

One edit of each scene, under all failures of the detector. Seconds are those from the file to the
labels in one warm process without other load: reading the file, observing the views (methods that
only vote project the centres; the others also bin the views and lift one set of masks), and the
method itself, each the least of two or three runs without compilation. A 2D network also needs the
renders, and a second for each. F1 is that of the full-size held-out views.
"""

import dataclasses
import functools
import itertools
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import charts
import numpy as np
from cases import Case, calibrated_mixture, detector_masks, reduced
from methods import ALL_METHODS, predict_with
from observations import CaseObservation, Method, observe_regimes
from runner import FewArgs, heldout_masks, measured, scores, start
from tables import Frame, Row, front_of, markdown, where, write_section

from gsc_jax import load_ply, save_ply
from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.estimators.gschecker import OFFICIAL, PAPER
from gsc_jax.evidence.observation import votes_of_view
from gsc_jax.splat import render

VIEWS, SCALES = (4, 8, 12, 18), (0.25, 0.5, 1.0)
VOTERS = "inverse projection", "mode vote", "SAGD vote"
SETTING = ["method", "epochs", "views", "scale"]
RELEASED, RENDERED = "GS-Checker official, attribute", "GS-Checker official, rendered"
"""Both use the rule of the released code for the mask of a view; the other methods flag a pixel if
more than half of its weight is of labelled Gaussians."""
WITHOUT_EVIDENCE = (*VOTERS, RENDERED)
"""Methods that need the votes of the views, but not the evidence."""
VARIANTS: dict[tuple[str, int | str], Method] = {
    **{(name, ""): ALL_METHODS[name] for name in (*VOTERS, "SA3D", "FlashSplat")},
    (RELEASED, ""): ALL_METHODS[RELEASED],
    **{
        ("GS-Checker paper", epochs): predict_with(dataclasses.replace(PAPER, epochs=epochs))
        for epochs in (1, 2, 5)
    },
    ("robust", ""): ALL_METHODS["robust"],
}
"""Methods by name and, for `GS-Checker paper`, number of epochs."""
AS_RELEASED = predict_with(dataclasses.replace(OFFICIAL, path="rendered"), own_rule=True)
"""The released method with its own rendering of every step, at all views in full size only."""
CLOSE = 0.01
"""Loss of F1 that is acceptable for less time."""
NETWORK = 1.0
"""Seconds that a 2D network takes for a view, in the second panel."""
PANELS = {
    ("seconds", "f1"): "masks given; mixture of all failures",
    ("seconds", "f1_mean"): "masks given; mean over all failures",
    ("with_network", "f1"): "a network of 1 s a view; mixture",
    ("with_network", "f1_mean"): "a network of 1 s a view; mean",
}


def timed(function: Callable[[], Any]) -> tuple[Any, float]:
    """Result and least time of three runs, or of two if they are slow."""
    result, times = None, []
    while len(times) < 2 or (len(times) < 3 and sum(times) < 1):
        start = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - start)
    return result, min(times)


def vote_only(case: Case, masks: np.ndarray) -> None:
    """Observe as far as the methods that only vote need it."""
    for camera, mask in zip(case.scene.cameras, masks, strict=True):
        votes_of_view(case.gaussians, camera, mask)


def render_all(case: Case) -> None:
    """Render every view, as a 2D network needs it."""
    for camera in case.scene.cameras:
        np.asarray(render(case.gaussians, camera)[0])


def reading(case: Case) -> float:
    """Seconds to read the scene from a file."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.ply"
        save_ply(path, case.gaussians)
        return timed(functools.partial(load_ply, path))[1]


def rows_of(case: Case, counts: Sequence[int], scales: Sequence[float]) -> list[Row]:
    """Measure every setting and method on one edit."""
    masks = detector_masks(case, {**REGIMES, "mixture": calibrated_mixture(case)})
    before, rows = reading(case), []
    for views, scale in itertools.product(counts, scales):
        smaller, own = reduced(case, masks, views, scale)
        alone = {"mixture": own["mixture"]}
        _, observing = timed(functools.partial(observe_regimes, smaller, alone))
        _, voting = timed(functools.partial(vote_only, smaller, own["mixture"]))
        _, rendering = timed(functools.partial(render_all, smaller))
        observed = observe_regimes(smaller, own)
        full = views == max(counts) and scale == max(scales)
        for key, method in (VARIANTS | ({(RENDERED, ""): AS_RELEASED} if full else {})).items():
            seconds = before + (voting if key[0] in WITHOUT_EVIDENCE else observing)
            setting = dict(zip(SETTING, (*key, views, scale), strict=True))
            row = {**case.key, **setting, **measure(case, observed, method, seconds)}
            row["with_network"] = row["seconds"] + rendering + NETWORK * views
            rows.append(row)
    return rows


def measure(
    case: Case, observed: Mapping[str, CaseObservation], method: Method, before: float
) -> Row:
    """Seconds under the mixture, and F1 under it and in the mean of all regimes."""
    _, seconds = timed(functools.partial(method, observed["mixture"]))
    predictions = [method(one) for one in observed.values()]
    masks = heldout_masks(case.gaussians, case.scene.heldout, predictions)
    f1 = [scores(case, *pair)["f1"] for pair in zip(predictions, masks, strict=True)]
    return {
        "seconds": round(before + seconds, 4),
        "f1": f1[list(observed).index("mixture")],
        "f1_mean": round(float(np.mean(f1)), 4),
    }


def averaged(rows: Frame) -> Frame:
    """Means and standard deviations over the cases of each setting, the fastest first."""
    groups = rows.groupby(SETTING, sort=False)
    points = groups[["seconds", "with_network", "f1", "f1_mean"]].mean()
    points = points.join(groups[["f1", "f1_mean"]].std().add_suffix("_spread"))
    return points.reset_index().sort_values(["seconds", "f1"], ascending=[True, False])


def extremes(points: Frame) -> Frame:
    """The best setting of each method, and its fastest one that is hardly worse."""
    chosen = []
    for name in points.method.unique():
        own = where(points, method=name)
        best = own.f1.idxmax()
        fast = own.index[own.f1 >= own.f1[best] - CLOSE][0]
        chosen += [best] if fast == best else [best, fast]
    return points.loc[chosen]


def table(points: Frame) -> str:
    """Points in Markdown."""
    cells = [
        [
            *(p[key] for key in SETTING),
            *(f"{p[key]:.3g}" for key in ("seconds", "with_network")),
            f"{p['f1']:.3f} ± {p['f1_spread']:.2f}",
            f"{p['f1_mean']:.3f}",
        ]
        for p in points.to_dict("records")
    ]
    return markdown([*SETTING, "seconds", "with a network", "F1", "mean F1"], cells)


def main(args: FewArgs) -> None:
    """Measure every case; print and write the tables and the chart."""
    counts, scales = ((4, 8), (0.5, 1.0)) if args.quick else (VIEWS, SCALES)
    cases = args.one_edit_each()
    rows = measured(args, "speed_accuracy", (rows_of(case, counts, scales) for case in cases))
    points = averaged(rows)
    text = (
        "**F1 against seconds from the file to the labels, mixture of failures: settings whose F1 "
        f"no faster one reaches** (± standard deviation over the scenes)\n\n"
        f"{table(front_of(points))}\n\n**Each method at its best, and its cheapest setting within "
        f"{CLOSE} of that**\n\n{table(extremes(points))}"
    )
    print(text)
    write_section(args.out / "results.md", "speed_accuracy", text)
    fronts = {
        panel: {name: front_of(where(points, method=name), *panel) for name in names_of(points)}
        for panel in PANELS
    }
    charts.trade_off(fronts, PANELS, args.out / "speed_accuracy.png")


def names_of(points: Frame) -> list[str]:
    """Methods in the order of the tables, the most accurate last, which is drawn on top."""
    return [*points.groupby("method").f1.max().sort_values().index]


if __name__ == "__main__":
    start(main, __doc__)
