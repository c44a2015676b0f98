"""False alarms: what the methods flag in scenes that nobody tampered with.

    python experiments/authentic.py [--quick] [--out docs]

The detector is shown untouched scenes and fails with blobs, with a decoy flagged in most views,
with inverted masks, or in all ways at once, at the strengths of `benchmark/simulate.py`. Where
nothing is tampered there is no edge to be ragged and no object to be missed, so those two failures
are left out, as is the detector without failures, which flags nothing. F1 does not exist here
(IMDL-BenCo's formula gives 0 whatever is flagged): what counts is the share of the held-out pixels
that is flagged, and whether a scene as a whole raises a false alarm.
"""

import functools
from collections.abc import Mapping
from pathlib import Path

import charts
import numpy as np
from cases import Case, detector_masks, untouched
from looks import Method, look
from matplotlib import pyplot as plt
from methods import ALL_METHODS, if_called_tampered
from runner import ITSELF, TRUTH, ChosenArgs, judge, measured, start
from tables import Row, mean, pivot, values_of, where, write_section

from gsc_jax.benchmark.simulate import REGIMES

FAILURES = {name: REGIMES[name] for name in ("blobs", "consistent", "inverted", "mixture")}
CALLED = "robust, if called tampered"
"""Where its verdict is that nothing was tampered with, nothing is flagged."""
ALARM = 0.5
"""Percent of the held-out pixels above which a scene counts as a false alarm."""


def rows_of(case: Case, methods: Mapping[str, Method]) -> list[Row]:
    """Every failure and method on one untouched scene, in percent of the held-out pixels."""
    looks = look(case, detector_masks(case, FAILURES))
    rows = []
    for row in judge(looks, methods):
        if row["method"] != TRUTH:
            flagged = round(100 * row["false_area"], 2)
            rows.append({**row, "flagged": flagged, "alarm": float(flagged > ALARM)})
    return rows


def report(rows: list[Row]) -> str:
    """The tables."""
    table = functools.partial(pivot, rows, "method", "regime", best=min, reference=(ITSELF,))
    return "\n\n".join(
        [
            "**Untouched scenes: percent of the held-out pixels flagged** (less is better; F1 does "
            "not exist where nothing is tampered)",
            table(metric="flagged", digits=1),
            f"**Share of the untouched scenes of which more than {ALARM} % is flagged**",
            table(metric="alarm"),
        ]
    )


def chart(rows: list[Row], path: Path) -> None:
    """Percent flagged, a dot per method and failure."""
    names = values_of(rows, "method")[::-1]
    figure, axis = plt.subplots(figsize=(7.5, 0.6 + 0.36 * len(names)), layout="constrained")
    for k, regime in enumerate(FAILURES):
        values = [mean(where(rows, method=name, regime=regime), "flagged") for name in names]
        height = np.arange(len(names)) + 0.14 * (1.5 - k)
        axis.plot(values, height, charts.MARKERS[k], ms=6, color=charts.COLORS[k], label=regime)
    axis.axvline(ALARM, color="grey", lw=1, ls="--")
    axis.set_yticks(range(len(names)), names)
    axis.set_xscale("symlog", linthresh=ALARM)
    ticks = 0, 0.1, ALARM, 1, 10, 100
    axis.set_xticks(ticks, [f"{tick:g}" for tick in ticks])
    axis.set(xlabel="held-out pixels flagged in untouched scenes, %", xlim=(-0.03, 105))
    axis.grid(visible=True, alpha=0.25)
    figure.legend(loc="outside upper right", ncols=len(FAILURES))
    charts.save(figure, path)


def main(args: ChosenArgs) -> None:
    """Judge every untouched scene; print and write the tables and the chart."""
    cases = args.cases(edits=("modification",))
    methods = args.among({**ALL_METHODS, CALLED: if_called_tampered})
    per_case = (rows_of(untouched(imagined), methods) for imagined in cases)
    rows = measured(args, "authentic", per_case)
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "authentic", text)
    chart(rows, args.out / "authentic.png")


if __name__ == "__main__":
    start(main, __doc__)
