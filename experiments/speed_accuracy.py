"""F1 against seconds: every method, fewer views, smaller views, fewer iterations.

    python experiments/speed_accuracy.py [--quick] [--out docs]

One edit of each scene, the calibrated mixture. Seconds are what a method needs after the detector,
in one warm process and nothing beside it: looking (the methods that only vote project the centres;
the others also bin the views and sum the weights of one set of masks) and the method itself, the
least of two or three times each, after what compiles. F1 is that of the full-size held-out views.
"""

import dataclasses
import functools
import itertools
import time
from collections.abc import Callable, Sequence
from typing import Any

import charts
import jax
import numpy as np
from cases import Case, calibrated_mixture, detector_masks, reduced
from looks import Method, look
from methods import ALL_METHODS, checker, sa3d_gate_alone
from runner import FewArgs, heldout_masks, measured, scores, start
from tables import Row, markdown, mean, values_of, where, write_section

from gsc_jax.estimators.gschecker import METHODS
from gsc_jax.render.projection import project_centers
from gsc_jax.vote import cast_votes, tally

VIEWS, SCALES = (4, 8, 12, 18), (0.25, 0.5, 1.0)
VOTERS = "inverse projection", "mode vote", "SAGD vote"
SETTING = "method", "epochs", "views", "scale"
VARIANTS: dict[tuple[str, int | str], Method] = {
    **{(name, ""): m for name, m in ALL_METHODS.items() if name != "GS-Checker paper"},
    ("SA3D, gate", ""): sa3d_gate_alone,
    **{
        ("GS-Checker paper", epochs): checker(dataclasses.replace(METHODS["paper"], epochs=epochs))
        for epochs in (1, 2, 5, 10)
    },
}
"""By name and, where there is a choice, epochs."""
CLOSE = 0.01
"""A loss of F1 that is worth time."""


def timed(function: Callable[[], Any]) -> tuple[Any, float]:
    """A result, and the least time it takes: of three runs, or of two where they are slow."""
    result, times = None, []
    while len(times) < 2 or (len(times) < 3 and sum(times) < 1):
        start = time.perf_counter()
        result = function()
        times.append(time.perf_counter() - start)
    return result, min(times)


def vote_only(case: Case, masks: np.ndarray) -> None:
    """What the methods that only vote need to see."""
    for camera, mask in zip(case.scene.cameras, masks, strict=True):
        place = project_centers(case.gaussians.means, camera.viewmat, camera.K)
        jax.block_until_ready(tally(cast_votes(*place, mask)[None]))


def rows_of(case: Case, counts: Sequence[int], scales: Sequence[float]) -> list[Row]:
    """Every setting and method on one edit."""
    masks = detector_masks(case, {"mixture": calibrated_mixture(case)})
    rows, answers = [], []
    for views, scale in itertools.product(counts, scales):
        less, said = reduced(case, masks, views, scale)
        looks, looking = timed(functools.partial(look, less, said))
        _, voting = timed(functools.partial(vote_only, less, said["mixture"]))
        for (name, epochs), method in VARIANTS.items():
            answer, own = timed(functools.partial(method, looks["mixture"]))
            setting = dict(zip(SETTING, (name, epochs, views, scale), strict=True))
            rows.append({**setting, "seconds": own + (voting if name in VOTERS else looking)})
            answers.append(answer)
    predicted = heldout_masks(case.gaussians, case.scene.heldout, answers)
    triples = zip(rows, answers, predicted, strict=True)
    return [{**case.key, **row, **scores(case, answer, mask)} for row, answer, mask in triples]


def averaged(rows: Sequence[Row]) -> list[Row]:
    """A point per setting: means over the cases, the fastest first."""
    points = []
    for values in dict.fromkeys(tuple(row[key] for key in SETTING) for row in rows):
        setting = dict(zip(SETTING, values, strict=True))
        own = where(rows, **setting)
        points.append({**setting, "seconds": mean(own, "seconds"), "f1": mean(own)})
    return sorted(points, key=lambda point: (point["seconds"], -point["f1"]))


def front_of(points: Sequence[Row]) -> list[Row]:
    """Of points, the fastest first, those that no faster one equals."""
    best = np.maximum.accumulate([-1.0, *(point["f1"] for point in points)])
    return [point for point, before in zip(points, best, strict=False) if point["f1"] > before]


def extremes(points: Sequence[Row]) -> list[Row]:
    """Each method at its best, and its cheapest point that is hardly worse."""
    chosen = []
    for name in values_of(points, "method"):
        own = where(points, method=name)
        best = max(own, key=lambda point: point["f1"])
        cheap = next(point for point in own if point["f1"] >= best["f1"] - CLOSE)
        chosen += [best] if cheap is best else [best, cheap]
    return chosen


def table(points: Sequence[Row]) -> str:
    """Points in Markdown."""
    cells = [
        [*(p[key] for key in SETTING), f"{p['seconds']:.3g}", f"{p['f1']:.3f}"] for p in points
    ]
    return markdown([*SETTING, "seconds", "F1"], cells)


def label(point: Row) -> str:
    """A point in a few words."""
    epochs = f", {point['epochs']} epochs" if point["epochs"] else ""
    return f"{point['method']}{epochs}, {point['views']} views, x{point['scale']:g}"


def main(args: FewArgs) -> None:
    """Time every case; print and write the tables and the chart."""
    counts, scales = ((4, 8), (0.5, 1.0)) if args.quick else (VIEWS, SCALES)
    cases = args.one_edit_each()
    rows = measured(args, "speed_accuracy", (rows_of(case, counts, scales) for case in cases))
    points = averaged(rows)
    front = front_of(points)
    text = (
        "**F1 against seconds, mixture of failures: the settings that no faster one equals**\n\n"
        f"{table(front)}\n\n**Each method at its best, and its cheapest setting within {CLOSE} of "
        f"that**\n\n{table(extremes(points))}"
    )
    print(text)
    write_section(args.out / "results.md", "speed_accuracy", text)
    ordered = sorted(points, key=lambda point: [*ALL_METHODS].index(point["method"]))
    charts.pareto(ordered, {label(p): p for p in front}, args.out / "speed_accuracy.png")


if __name__ == "__main__":
    start(main, __doc__)
