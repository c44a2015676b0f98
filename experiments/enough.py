"""Number of views that `robust` needs before it stops early, and the loss of F1.

    python experiments/enough.py [--quick] [--out docs]

Edits of the made scenes with 72 cameras instead of 18. Views are added in the order in which
`locate` adds them for a network, and the labels at each number of views are scored on the held-out
views. The change of the labels gives the number of views at which each tolerance would stop.
"""

import dataclasses
from collections.abc import Iterator

import charts
import numpy as np
import pandas as pd
from cases import MADE, QUICK, Case, detector_masks, seen_from
from garden import garden_cameras
from methods import labelled
from observations import CaseObservation, Prediction, observe_regimes
from runner import CASE_KEYS, FewArgs, heldout_masks, measured, refuse_unused, start
from tables import Frame, Row, markdown, where, write_section

from gsc_jax.benchmark.metrics import mean_over_tampered_views
from gsc_jax.benchmark.scenes import room_cameras
from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.estimators import RobustEstimator
from gsc_jax.estimators.robust.early_stopping import batches, changed, spread
from gsc_jax.evidence.lifting import Evidence

VIEWS, WIDTH, HEIGHT = 72, 240, 180
TOLERANCES = (0.1, 0.05, 0.02, 0.01, 0.0)


def rows_of(case: Case) -> Iterator[Row]:
    """Measure F1 and change at each number of views, under every failure."""
    make_cameras = garden_cameras if case.scene.name == "garden" else room_cameras
    views = VIEWS // 3 if case.scene.name == QUICK else VIEWS
    case = seen_from(case, make_cameras(views, width=WIDTH, height=HEIGHT))
    steps = [
        ({**case.key, "regime": regime, "method": "robust", **row}, prediction)
        for regime, one in observe_regimes(case, detector_masks(case, REGIMES)).items()
        for row, prediction in with_more_views(one)
    ]
    masks = heldout_masks(case.gaussians, case.scene.heldout, [one for _, one in steps])
    for (row, _), mask in zip(steps, masks, strict=True):
        f1 = mean_over_tampered_views(list(mask), list(case.heldout_truth)).f1
        yield {**row, "f1": round(f1, 4)}


def with_more_views(one: CaseObservation) -> Iterator[tuple[Row, Prediction]]:
    """Predict from more and more views, and measure the change of the labels."""
    evidence, means = one.observation.evidence, np.asarray(one.case.gaussians.means)
    order, labels = spread(evidence.shape[0]), None
    estimator = RobustEstimator(seed=one.case.seed)
    for count in batches(len(order)):
        chosen = order[:count]
        some = Evidence(total=evidence.total[chosen], tampered=evidence.tampered[chosen])
        new = estimator.estimate_from_evidence(some, means).labels
        change = 1.0 if labels is None or not new.any() else changed(labels, new, some)
        labels = new
        yield {"views": count, "change": round(change, 4)}, labelled(new)


def stops(rows: Frame) -> Frame:
    """Views taken, and F1 there minus F1 of all, for each case, failure and tolerance."""
    found = []
    for _, steps in rows.groupby(CASE_KEYS, sort=False):
        last = steps.iloc[-1]
        for tolerance in TOLERANCES:
            stable = steps[steps.change < tolerance]
            step = stable.iloc[0] if len(stable) else last
            found.append({**step, "tolerance": tolerance, "lost": step.f1 - last.f1})
    return pd.DataFrame(found)


def table(rows: Frame) -> str:
    """Failures down, tolerances across: mean views, and mean and worst change of F1."""
    found = stops(rows)
    lines = []
    for regime in [*found.regime.unique(), "all"]:
        own = found if regime == "all" else where(found, regime=regime)
        cells = []
        for tolerance in TOLERANCES:
            some = where(own, tolerance=tolerance)
            lost = f"{some.lost.mean():+.3f} ({some.lost.min():+.2f})"
            cells.append(f"{some['views'].mean():.0f}, {lost}")
        lines.append([regime, *cells])
    return markdown(["failure", *(f"tolerance {t:g}" for t in TOLERANCES)], lines)


def main(args: FewArgs) -> None:
    """Measure every case; print and write the table and the chart."""
    refuse_unused(args, "scenes")
    names = (QUICK,) if args.quick else MADE
    cases = dataclasses.replace(args, scenes=names).cases()
    rows = measured(args, "enough", (rows_of(case) for case in cases))
    text = "**Views used, and F1 minus that of all views, mean (worst), by tolerance**\n\n" + table(
        rows
    )
    print(text)
    write_section(args.out / "results.md", "enough", text)
    panels = {regime: where(rows, regime=regime) for regime in rows.regime.unique()}
    charts.curves(panels, args.out / "enough.png", x="views", labels=("views", "F1"), columns=4)


if __name__ == "__main__":
    start(main, __doc__)
