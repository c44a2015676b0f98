"""How many views the estimator asks for by itself, and what that costs.

    python experiments/enough.py [--quick] [--out docs]

Edits of the made scenes, with 72 cameras instead of 18. Views are added as `locate` adds them in
front of a network, the labels at each number of views are scored on the held-out views, and from
how much they changed follows where each tolerance would have stopped.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import charts
import jax
import numpy as np
from cases import MADE, QUICK, Case, detector_masks, seen_from
from garden import garden_cameras
from looks import Answer, Look, look
from methods import labelled
from runner import FewArgs, heldout_masks, measured, start
from tables import Row, markdown, mean, values_of, where, write_section

from gsc_jax.benchmark.metrics import mean_over_tampered_views
from gsc_jax.benchmark.scenes import room_cameras
from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.estimators.robust.early_stopping import batches, changed, spread
from gsc_jax.estimators.robust.estimator import RobustConfig, find_robust

VIEWS, WIDTH, HEIGHT = 72, 240, 180
TOLERANCES = (0.1, 0.05, 0.02, 0.01, 0.0)


def rows_of(case: Case) -> Iterator[Row]:
    """F1 and change at each number of views, under every failure."""
    place = garden_cameras if case.scene.name == "garden" else room_cameras
    views = VIEWS // 3 if case.scene.name == QUICK else VIEWS
    case = seen_from(case, place(views, width=WIDTH, height=HEIGHT))
    rungs = [
        ({**case.key, "regime": regime, "method": "robust", **row}, answer)
        for regime, one in look(case, detector_masks(case, REGIMES)).items()
        for row, answer in ladder(one)
    ]
    masks = heldout_masks(case.gaussians, case.scene.heldout, [answer for _, answer in rungs])
    for (row, _), mask in zip(rungs, masks, strict=True):
        f1 = mean_over_tampered_views(list(mask), list(case.heldout_truth)).f1
        yield {**row, "f1": round(f1, 4)}


def ladder(one: Look) -> Iterator[tuple[Row, Answer]]:
    """What the estimator says of ever more views, and how much of it is new."""
    evidence, means = one.observation.evidence, np.asarray(one.case.gaussians.means)
    order, labels = spread(len(evidence.total)), None
    for count in batches(len(order)):
        some = jax.tree.map(lambda part, n=count: part[order[:n]], evidence)
        found = find_robust(some, means, RobustConfig(seed=one.case.seed)).labels
        change = 1.0 if labels is None or not found.any() else changed(labels, found, some)
        labels = found
        yield {"views": count, "change": round(change, 4)}, labelled(found)


def stopped(rungs: Sequence[Row], tolerance: float) -> Row:
    """Where a tolerance stops: at the first change below it, or at the end."""
    return next((row for row in rungs if row["change"] < tolerance), rungs[-1])


def stops(rows: Sequence[Row]) -> list[Row]:
    """A row per look and tolerance: views taken, and F1 there less F1 of all."""
    found = []
    keys = dict.fromkeys((r["scene"], r["edit"], r["seed"], r["regime"]) for r in rows)
    for key in keys:
        place = dict(zip(("scene", "edit", "seed", "regime"), key, strict=True))
        rungs = where(rows, **place)
        for tolerance in TOLERANCES:
            row = stopped(rungs, tolerance)
            lost = row["f1"] - rungs[-1]["f1"]
            found.append({**row, "tolerance": tolerance, "lost": lost})
    return found


def table(rows: Sequence[Row]) -> str:
    """Failures down, tolerances across: mean views, and mean and worst change of F1."""
    found = stops(rows)
    lines = []
    for regime in [*values_of(found, "regime"), "all"]:
        own = found if regime == "all" else where(found, regime=regime)
        cells = []
        for tolerance in TOLERANCES:
            some = where(own, tolerance=tolerance)
            worst = min(row["lost"] for row in some)
            cells.append(f"{mean(some, 'views'):.0f}, {mean(some, 'lost'):+.3f} ({worst:+.2f})")
        lines.append([regime, *cells])
    return markdown(["failure", *(f"tolerance {t:g}" for t in TOLERANCES)], lines)


def main(args: FewArgs) -> None:
    """Climb on every case; print and write the table and the chart."""
    names = (QUICK,) if args.quick else MADE
    cases = FewArgs(**{**vars(args), "scenes": names}).cases()
    rows = measured(args, "enough", (rows_of(case) for case in cases))
    text = (
        "**Views looked at, and F1 there less F1 of all views, mean (worst), by tolerance**\n\n"
        + table(rows)
    )
    print(text)
    write_section(args.out / "results.md", "enough", text)
    chart(rows, args.out / "enough.png")


def chart(rows: Sequence[Row], path: Path) -> None:
    """F1 against views, a panel per failure."""
    panels = {regime: where(rows, regime=regime) for regime in values_of(rows, "regime")}
    charts.curves(panels, path, x="views", labels=("views", "F1"), columns=4)


if __name__ == "__main__":
    start(main, __doc__)
