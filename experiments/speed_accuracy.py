"""F1 against seconds: every method, fewer views, smaller views, fewer iterations.

    python experiments/speed_accuracy.py [--quick] [--out docs]

One edit of each scene, the calibrated mixture. Seconds are the time of a method after the detector,
in one warm process without other load: the observation (methods that only vote project the centres;
the others also bin the views and accumulate the weights of one set of masks) and the method itself,
each the least of two or three runs without compilation. F1 is that of the full-size held-out views.
"""

import dataclasses
import functools
import itertools
import time
from collections.abc import Callable, Sequence
from typing import Any

import charts
import numpy as np
from cases import Case, calibrated_mixture, detector_masks, reduced
from methods import ALL_METHODS, predict_with, sa3d_gate_alone
from observations import Method, observe_regimes
from runner import FewArgs, heldout_masks, measured, scores, start
from tables import Frame, Row, markdown, where, write_section

from gsc_jax.estimators.gschecker import PAPER
from gsc_jax.evidence.observation import votes_of_view

VIEWS, SCALES = (4, 8, 12, 18), (0.25, 0.5, 1.0)
VOTERS = "inverse projection", "mode vote", "SAGD vote"
SETTING = ["method", "epochs", "views", "scale"]
VARIANTS: dict[tuple[str, int | str], Method] = {
    **{(name, ""): m for name, m in ALL_METHODS.items() if name != "GS-Checker paper"},
    ("SA3D, gate", ""): sa3d_gate_alone,
    **{
        ("GS-Checker paper", epochs): predict_with(dataclasses.replace(PAPER, epochs=epochs))
        for epochs in (1, 2, 5, 10)
    },
}
"""Methods by name and, for `GS-Checker paper`, number of epochs."""
CLOSE = 0.01
"""Loss of F1 that is acceptable for less time."""


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


def rows_of(case: Case, counts: Sequence[int], scales: Sequence[float]) -> list[Row]:
    """Measure every setting and method on one edit."""
    masks = detector_masks(case, {"mixture": calibrated_mixture(case)})
    rows, predictions = [], []
    for views, scale in itertools.product(counts, scales):
        smaller, own = reduced(case, masks, views, scale)
        observed, observing = timed(functools.partial(observe_regimes, smaller, own))
        _, voting = timed(functools.partial(vote_only, smaller, own["mixture"]))
        for (name, epochs), method in VARIANTS.items():
            prediction, seconds = timed(functools.partial(method, observed["mixture"]))
            setting = dict(zip(SETTING, (name, epochs, views, scale), strict=True))
            rows.append({**setting, "seconds": seconds + (voting if name in VOTERS else observing)})
            predictions.append(prediction)
    masks = heldout_masks(case.gaussians, case.scene.heldout, predictions)
    triples = zip(rows, predictions, masks, strict=True)
    return [{**case.key, **row, **scores(case, one, mask)} for row, one, mask in triples]


def averaged(rows: Frame) -> Frame:
    """Mean seconds and F1 of each setting over the cases, the fastest first."""
    points = rows.groupby(SETTING, sort=False)[["seconds", "f1"]].mean().reset_index()
    return points.sort_values(["seconds", "f1"], ascending=[True, False])


def front_of(points: Frame) -> Frame:
    """Points, the fastest first, whose F1 no faster one reaches."""
    return points[points.f1 > points.f1.cummax().shift(fill_value=-1.0)]


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
        [*(p[key] for key in SETTING), f"{p['seconds']:.3g}", f"{p['f1']:.3f}"]
        for p in points.to_dict("records")
    ]
    return markdown([*SETTING, "seconds", "F1"], cells)


def label(point: Any) -> str:
    """Short description of a point."""
    epochs = f", {point['epochs']} epochs" if point["epochs"] else ""
    return f"{point['method']}{epochs}, {point['views']} views, x{point['scale']:g}"


def main(args: FewArgs) -> None:
    """Measure every case; print and write the tables and the chart."""
    counts, scales = ((4, 8), (0.5, 1.0)) if args.quick else (VIEWS, SCALES)
    cases = args.one_edit_each()
    rows = measured(args, "speed_accuracy", (rows_of(case, counts, scales) for case in cases))
    points = averaged(rows)
    front = front_of(points)
    text = (
        "**F1 against seconds, mixture of failures: settings whose F1 no faster one reaches**\n\n"
        f"{table(front)}\n\n**Each method at its best, and its cheapest setting within {CLOSE} of "
        f"that**\n\n{table(extremes(points))}"
    )
    print(text)
    write_section(args.out / "results.md", "speed_accuracy", text)
    order = [*ALL_METHODS].index
    ordered = points.sort_values("method", key=lambda names: names.map(order), kind="stable")
    labelled = {label(point): point for _, point in front.iterrows()}
    charts.pareto(ordered, labelled, args.out / "speed_accuracy.png")


if __name__ == "__main__":
    start(main, __doc__)
