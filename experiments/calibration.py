"""Whether a probability of `robust` is one, and whether its verdict tells edited scenes apart.

    python experiments/calibration.py [--quick] [--out docs]

Gaussians are sorted into ten bins by their probability to be tampered, weighted by what the
held-out views show of them; in each, the mean probability stands beside the share that is truly
tampered. The verdict is asked for every edited scene and for the same scene untouched, where the
detector takes what was edited for suspicious as often as `benchmark/simulate.py` says. Its scale
and that of the probabilities were fixed on other seeds.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

import charts
import jax.numpy as jnp
import numpy as np
from authentic import FAILURES
from cases import Case, calibrated_mixture, detector_masks, untouched
from looks import Look, look
from matplotlib import pyplot as plt
from runner import FewArgs, measured, start
from tables import Row, markdown, mean, values_of, where, write_section

from gsc_jax.benchmark.metrics import auc
from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.estimators.robust.estimator import RobustConfig, find_robust
from gsc_jax.render.tiles import make_view
from gsc_jax.splat import accumulate

BINS = 10


def rows_of(case: Case) -> Iterator[Row]:
    """The bins and the verdict under every failure, of the edited scene and the untouched one."""
    regimes = {**REGIMES, "mixture": calibrated_mixture(case)}
    shown = visible(case)
    for regime, one in look(case, detector_masks(case, regimes)).items():
        yield from judged(one, regime, shown, case.labels)
    pristine = untouched(case)
    shown = visible(pristine)
    failures = {name: regimes[name] for name in FAILURES}
    for regime, one in look(pristine, detector_masks(pristine, failures)).items():
        for row in judged(one, regime, shown, pristine.labels):
            yield {**row, **case.key, "edit": "none"}


def visible(case: Case) -> np.ndarray:
    """What the held-out views show of each Gaussian, in pixels, shape (N,)."""
    ones = [jnp.ones((c.height, c.width, 1)) for c in case.scene.heldout]
    views = [make_view(case.gaussians, camera) for camera in case.scene.heldout]
    return np.sum([accumulate(v, o)[:, 0] for v, o in zip(views, ones, strict=True)], axis=0)


def judged(one: Look, regime: str, shown: np.ndarray, labels: np.ndarray) -> Iterator[Row]:
    """A row for the verdict and a row for each bin."""
    means = np.asarray(one.case.gaussians.means)
    found = find_robust(one.observation.evidence, means, RobustConfig(seed=one.case.seed))
    row = {**one.case.key, "regime": regime}
    flagged = float(shown[found.labels & ~labels].sum() / shown.sum())
    yield {**row, "bin": -1, "verdict": found.verdict, "flagged": 100 * flagged}
    which = np.minimum((found.tamper * BINS).astype(int), BINS - 1)
    for k in range(BINS):
        inside = np.where(which == k, shown, 0.0)
        share = float(inside.sum() / shown.sum())
        if share:
            said, true = (float(np.average(x, weights=inside)) for x in (found.tamper, labels))
            yield {**row, "bin": k, "share": share, "said": said, "true": true}


def bins_of(rows: Sequence[Row]) -> list[tuple[float, float, float]]:
    """Share, mean probability and share truly tampered in each bin, over all rows."""
    bins = []
    for k in range(BINS):
        own = where(rows, bin=k)
        share = np.array([row["share"] for row in own])
        if share.sum():
            said, true = (
                np.average([r[key] for r in own], weights=share) for key in ("said", "true")
            )
            bins.append((share.sum(), said, true))
    total = sum(share for share, _, _ in bins)
    return [(share / total, said, true) for share, said, true in bins]


def expected_error(rows: Sequence[Row]) -> float:
    """Expected calibration error: mean distance of probability and truth over the bins."""
    return float(sum(share * abs(said - true) for share, said, true in bins_of(rows)))


def verdict_auc(rows: Sequence[Row]) -> float:
    """How well the verdict ranks edited scenes over untouched ones."""
    scenes = where(rows, bin=-1)
    values = np.array([row["verdict"] for row in scenes])
    return float(auc(values, np.array([row["edit"] != "none" for row in scenes])))


def undecided_error(rows: Sequence[Row]) -> float:
    """The same over what is neither in the first bin nor in the last, where nearly all is."""
    return expected_error([row for row in rows if 0 < row["bin"] < BINS - 1])


def report(rows: Sequence[Row]) -> str:
    """The tables."""
    edited = [row for row in rows if row["edit"] != "none"]
    pristine = where(rows, edit="none")
    reliability = [
        [f"{share:.2%}", f"{said:.3f}", f"{true:.3f}"] for share, said, true in bins_of(edited)
    ]
    errors = [
        [regime, f"{expected_error(where(edited, regime=regime)):.3f}"]
        for regime in values_of(edited, "regime")
    ]
    return "\n\n".join(
        [
            "**Said and true, over all edits and failures**, weighted by what held-out views show "
            f"(expected calibration error {expected_error(edited):.3f}; between the first bin and "
            f"the last {undecided_error(edited):.3f})",
            markdown(["share", "probability", "truly tampered"], reliability),
            "**Expected calibration error by failure**",
            markdown(["failure", "error"], errors),
            f"**The verdict**: area under the curve {verdict_auc(rows):.3f}, over "
            f"{len(where(edited, bin=-1))} looks at edited and {len(where(pristine, bin=-1))} at "
            "untouched scenes; where both failed alike, "
            + ", ".join(
                f"{name} {verdict_auc(where(rows, regime=name)):.3f}"
                for name in values_of(pristine, "regime")
            ),
            verdicts(edited, pristine),
        ]
    )


def verdicts(edited: Sequence[Row], pristine: Sequence[Row]) -> str:
    """By failure: how often a scene is called tampered, and what is flagged where it is not."""
    lines = []
    for kind, rows in (("edited", edited), ("untouched", pristine)):
        for regime in values_of(rows, "regime"):
            own = where(rows, regime=regime, bin=-1)
            called = [row["verdict"] > 0.5 for row in own]
            kept = np.mean([row["flagged"] * c for row, c in zip(own, called, strict=True)])
            values = [f"{np.mean(called):.2f}", f"{mean(own, 'flagged'):.2f}", f"{kept:.2f}"]
            lines.append([kind, regime, *values])
    heads = ["scene", "failure", "called tampered", "% falsely flagged", "if called tampered"]
    return markdown(heads, lines)


def chart(rows: Sequence[Row], path: Path) -> None:
    """The reliability diagram, and the verdicts."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    edited = [row for row in rows if row["edit"] != "none"]
    left.plot([0, 1], [0, 1], color="#999999", lw=1)
    for k, regime in enumerate(values_of(edited, "regime")):
        _, said, true = zip(*bins_of(where(edited, regime=regime)), strict=True)
        style = {"marker": charts.MARKERS[k], "color": charts.COLORS[k], "ms": 4, "lw": 1}
        left.plot(said, true, label=regime, **style)
    left.set(xlabel="probability to be tampered", ylabel="truly tampered")
    left.legend(fontsize=8)
    scenes = where(rows, bin=-1)
    for kind, color in (("edited", charts.COLORS[1]), ("untouched", charts.COLORS[0])):
        values = [r["verdict"] for r in scenes if (r["edit"] == "none") == (kind == "untouched")]
        right.hist(values, bins=np.linspace(0, 1, 21), color=color, alpha=0.6, label=kind)
    right.set(xlabel="verdict: probability that anything was tampered with", ylabel="looks")
    right.legend(fontsize=8)
    charts.save(figure, path)


def main(args: FewArgs) -> None:
    """Ask on every case; print and write the tables and the chart."""
    rows = measured(args, "calibration", (rows_of(case) for case in args.cases()))
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "calibration", text)
    chart(rows, args.out / "calibration.png")


if __name__ == "__main__":
    start(main, __doc__)
