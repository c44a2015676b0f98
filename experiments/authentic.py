"""False alarms: what the methods flag in authentic scenes.

    python experiments/authentic.py [--quick] [--out docs]

The detector is shown authentic scenes and fails with blobs, with a decoy flagged in most views,
with inverted masks, or in all ways at once, at the strengths of `benchmark/simulate.py`. Ragged
edges and misses need a tampered object, and the detector without failures flags nothing, so these
are left out. F1 does not exist here (IMDL-BenCo's formula is 0 whatever is flagged): the measures
are the flagged share of the held-out pixels, and whether a scene as a whole raises a false alarm.
"""

import functools
from collections.abc import Mapping
from pathlib import Path

import charts
import numpy as np
from cases import Case, detector_masks, without_edit
from matplotlib import pyplot as plt
from methods import ALL_METHODS, if_called_tampered
from observations import Method, observe_regimes
from runner import ChosenArgs, judge, measured, refuse_unused, start
from tables import TRUTH, Frame, Row, pivot, where, write_section

from gsc_jax.benchmark.simulate import REGIMES

FAILURES = {name: REGIMES[name] for name in ("blobs", "consistent", "inverted", "mixture")}
CALLED = "robust, if called tampered"
"""`robust`, whose labels are dropped where its verdict calls the scene authentic."""
ALARM = 0.5
"""Percentage of held-out pixels above which a scene counts as a false alarm."""


def rows_of(case: Case, methods: Mapping[str, Method]) -> list[Row]:
    """Measure the percentage of flagged held-out pixels under every failure and method."""
    observed = observe_regimes(case, detector_masks(case, FAILURES))
    rows = []
    for row in judge(observed, methods):
        if row["method"] != TRUTH:
            flagged = round(100 * row["false_area"], 2)
            rows.append({**row, "flagged": flagged, "alarm": float(flagged > ALARM)})
    return rows


def report(rows: Frame) -> str:
    """All tables."""
    table = functools.partial(pivot, rows, "method", "regime", best="min")
    return "\n\n".join(
        [
            "**Authentic scenes: percentage of the held-out pixels flagged** (less is better; F1 "
            "does not exist where nothing is tampered)",
            table(metric="flagged", digits=1),
            f"**Share of the authentic scenes of which more than {ALARM} % is flagged**",
            table(metric="alarm"),
        ]
    )


def chart(rows: Frame, path: Path) -> None:
    """Percentage flagged, a dot per method and failure."""
    names = rows.method.unique()[::-1]
    figure, axis = plt.subplots(figsize=(7.5, 0.6 + 0.36 * len(names)), layout="constrained")
    for k, regime in enumerate(FAILURES):
        values = where(rows, regime=regime).groupby("method").flagged.mean().reindex(names)
        height = np.arange(len(names)) + 0.14 * (1.5 - k)
        axis.plot(values, height, charts.MARKERS[k], ms=6, color=charts.COLORS[k], label=regime)
    axis.axvline(ALARM, color="grey", lw=1, ls="--")
    axis.set_yticks(range(len(names)), names)
    axis.set_xscale("symlog", linthresh=ALARM)
    ticks = 0, 0.1, ALARM, 1, 10, 100
    axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set(xlabel="held-out pixels flagged in authentic scenes, %", xlim=(-0.03, 105))
    axis.grid(visible=True, alpha=0.25)
    figure.legend(loc="outside upper right", ncols=len(FAILURES))
    charts.save(figure, path)


def main(args: ChosenArgs) -> None:
    """Measure every authentic scene; print and write the tables and the chart."""
    refuse_unused(args, "edits")
    cases = args.cases(edits=("modification",))
    methods = args.among({**ALL_METHODS, CALLED: if_called_tampered})
    per_case = (rows_of(without_edit(case), methods) for case in cases)
    rows = measured(args, "authentic", per_case)
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "authentic", text)
    chart(rows, args.out / "authentic.png")


if __name__ == "__main__":
    start(main, __doc__)
