"""`robust` from coarse to fine against all pixels: F1, time, and the share of the pixels.

    python experiments/adaptive.py [--quick] [--out docs]

Both runs get the same masks in one process: observing the views and estimating. Seconds are those
of the processor in all threads, which other load changes little, after a run that compiles. F1 is
that of the held-out views. A case whose parts become too large falls back to all pixels, after the
time that this took; its share is 1.
"""

import functools
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np
from cases import Case, calibrated_mixture, detector_masks
from coarse_to_fine import CoarseToFine, labels_where_needed
from methods import labelled
from runner import Args, heldout_masks, measured, start
from tables import Frame, Row, markdown, where, write_section

from gsc_jax import observe
from gsc_jax.benchmark.metrics import mean_over_tampered_views
from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.estimators import RobustEstimator

BOUND = 0.005
"""Loss of F1 up to which coarse to fine would have been acceptable."""
RUNS = 2
"""Timed runs of each, after one that compiles."""


def full(case: Case, masks: Mapping[str, np.ndarray]) -> np.ndarray:
    """Labels from all pixels."""
    observation = observe(case.gaussians, case.scene.cameras, masks)
    return RobustEstimator(seed=case.seed).estimate(observation).labels


def adaptive(case: Case, masks: Mapping[str, np.ndarray]) -> tuple[np.ndarray, list[float], float]:
    """Labels from coarse to fine, the weight outside at each step, and the share of the pixels."""
    views = CoarseToFine(case.gaussians, case.scene.cameras, masks)
    estimator, means = RobustEstimator(seed=case.seed), np.asarray(case.gaussians.means)
    labels, outside, pixels = labels_where_needed(views, means, estimator)
    return full(case, masks) if labels is None else labels, outside, pixels


def processor_seconds(*functions: Callable[[], Any]) -> list[tuple[Any, float]]:
    """Results and processor times of functions, the least of `RUNS` that take turns, after one."""
    times, results = [], [function() for function in functions]
    for _ in range(RUNS):
        for function in functions:
            start = time.process_time()
            function()
            times.append(time.process_time() - start)
    return [(one, min(times[k :: len(functions)])) for k, one in enumerate(results)]


def rows_of(case: Case) -> Iterator[Row]:
    """Measure both runs under every failure of the detector on one edit."""
    names, labels, rows = [camera.name for camera in case.scene.cameras], [], []
    regimes = {**REGIMES, "mixture": calibrated_mixture(case)}
    for regime, own in detector_masks(case, regimes).items():
        masks = dict(zip(names, own, strict=True))
        runs = [functools.partial(function, case, masks) for function in (full, adaptive)]
        (all_pixels, seconds_full), (found, seconds) = processor_seconds(*runs)
        needed, outside, pixels = found
        labels += [labelled(all_pixels), labelled(needed)]
        used = {"pixels": round(pixels, 4), "steps": len(outside)}
        times = {"seconds_full": round(seconds_full, 4), "seconds": round(seconds, 4)}
        rows.append({**case.key, "regime": regime, "method": "robust", **used, **times})
    masks = heldout_masks(case.gaussians, case.scene.heldout, labels)
    truth = list(case.heldout_truth)
    f1 = [mean_over_tampered_views(list(mask), truth).f1 for mask in masks]
    for row, before, after in zip(rows, f1[::2], f1[1::2], strict=True):
        yield {**row, "f1_full": round(before, 4), "f1": round(after, 4)}


def table(rows: Frame) -> str:
    """Failures down: F1 of both, differences, ratios of the time, and pixels."""
    lines = []
    for regime in [*rows.regime.unique(), "all"]:
        own = rows if regime == "all" else where(rows, regime=regime)
        lost, ratio = own.f1 - own.f1_full, own.seconds / own.seconds_full
        lines.append(
            [
                regime,
                f"{own.f1_full.mean():.3f}",
                f"{own.f1.mean():.3f}",
                f"{lost.mean():+.3f} ({lost.min():+.3f})",
                f"{np.sum(lost < -BOUND)} of {len(own)}",
                f"{ratio.mean():.2f} ({ratio.max():.2f})",
                f"{own.pixels.mean():.0%}",
                f"{np.sum(own.pixels == 1)}",
            ]
        )
    heads = ["failure", "F1, all pixels", "F1, coarse to fine", "difference (worst)"]
    heads += [f"worse by {BOUND}", "time ratio (worst)", "pixels", "of which all"]
    return markdown(heads, lines)


def main(args: Args) -> None:
    """Measure every case; print and write the table."""
    rows = measured(args, "adaptive", (rows_of(case) for case in args.cases()))
    text = (
        "**`robust` from coarse to fine against all pixels: means over the cases, with the worst "
        f"case in brackets; all views are used**\n\n{table(rows)}"
    )
    print(text)
    write_section(args.out / "results.md", "adaptive", text)


if __name__ == "__main__":
    start(main, __doc__)
