"""Calibration of the probabilities of `robust`, and how well its verdict detects edited scenes.

    python experiments/calibration.py [--quick] [--out docs]

Gaussians are sorted into ten bins by their probability of being tampered, weighted by the pixels
that they fill in the held-out views; the mean probability of each bin is compared with the share
that is truly tampered. The verdict is measured for every edited scene and for the same scene
without its edit, where the detector flags the region of the edit as often as
`benchmark/simulate.py` says. All scales of the estimator were fixed on other seeds.
"""

from collections.abc import Iterator
from pathlib import Path

import charts
import jax.numpy as jnp
import numpy as np
from authentic import FAILURES
from cases import Case, calibrated_mixture, detector_masks, failures_without, without_edit
from matplotlib import pyplot as plt
from methods import seeded
from observations import CaseObservation, observe_regimes
from runner import FewArgs, measured, start
from tables import Frame, Row, markdown, where, write_section

from gsc_jax.benchmark.metrics import auc
from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.estimators import METHODS
from gsc_jax.render.tiles import make_view
from gsc_jax.splat import accumulate

BINS = 10


def rows_of(case: Case) -> Iterator[Row]:
    """Measure bins and verdict under every failure, with and without the edit."""
    regimes = {**REGIMES, "mixture": calibrated_mixture(case)}
    weights = heldout_weights(case)
    for one in observe_regimes(case, detector_masks(case, regimes)).values():
        yield from judged(one, weights)
    pristine = without_edit(case)
    weights = heldout_weights(pristine)
    failures = failures_without(case.edit, {name: regimes[name] for name in FAILURES})
    for one in observe_regimes(pristine, detector_masks(pristine, failures)).values():
        for row in judged(one, weights):
            yield {**row, **case.key, "edit": "none"}


def heldout_weights(case: Case) -> np.ndarray:
    """Total blending weight of each Gaussian in the held-out views, in pixels, shape (N,)."""
    ones = [jnp.ones((c.height, c.width, 1)) for c in case.scene.heldout]
    views = [make_view(case.gaussians, camera) for camera in case.scene.heldout]
    return np.sum([accumulate(v, o)[:, 0] for v, o in zip(views, ones, strict=True)], axis=0)


def judged(one: CaseObservation, weights: np.ndarray) -> Iterator[Row]:
    """A row for the verdict and a row for each bin."""
    labels = one.case.labels
    finding = seeded(METHODS["robust"], one.case.seed).estimate(one.observation)
    row = {**one.case.key, "regime": one.regime}
    flagged = float(weights[finding.labels & ~labels].sum() / weights.sum())
    yield {**row, "bin": -1, "verdict": finding.verdict, "flagged": 100 * flagged}
    bins = np.minimum((finding.tamper * BINS).astype(int), BINS - 1)
    for k in range(BINS):
        inside = np.where(bins == k, weights, 0.0)
        share = float(inside.sum() / weights.sum())
        if share:
            said, true = (float(np.average(x, weights=inside)) for x in (finding.tamper, labels))
            yield {**row, "bin": k, "share": share, "said": said, "true": true}


def bins_of(rows: Frame) -> Frame:
    """Share, mean probability (`said`) and tampered share (`true`) of each bin over all rows."""
    rows = rows[rows.bin >= 0]
    sums = rows.assign(said=rows.said * rows.share, true=rows.true * rows.share)
    bins = sums.groupby("bin")[["share", "said", "true"]].sum()
    means = bins[["said", "true"]].div(bins.share, axis=0)
    return means.assign(share=bins.share / bins.share.sum())


def expected_error(rows: Frame) -> float:
    """Expected calibration error: mean distance of probability and truth over the bins."""
    bins = bins_of(rows)
    return float((bins.share * (bins.said - bins.true).abs()).sum())


def undecided_error(rows: Frame) -> float:
    """Expected calibration error without the first and the last bin, which hold nearly all."""
    return expected_error(rows[rows.bin.between(1, BINS - 2)])


def verdict_auc(rows: Frame) -> float:
    """AUC of the verdict for edited against authentic scenes."""
    scenes = where(rows, bin=-1)
    return float(auc(scenes.verdict.to_numpy(), (scenes.edit != "none").to_numpy()))


def report(rows: Frame) -> str:
    """All tables."""
    edited, pristine = rows[rows.edit != "none"], where(rows, edit="none")
    bins = bins_of(edited)
    reliability = [
        [f"{one.share:.2%}", f"{one.said:.3f}", f"{one.true:.3f}"] for one in bins.itertuples()
    ]
    errors = [
        [regime, f"{expected_error(where(edited, regime=regime)):.3f}"]
        for regime in edited.regime.unique()
    ]
    return "\n\n".join(
        [
            "**Probability and truth, over all edits and failures**, weighted by the pixels in "
            "held-out views "
            f"(expected calibration error {expected_error(edited):.3f}; between the first bin and "
            f"the last {undecided_error(edited):.3f})",
            markdown(["share", "probability", "truly tampered"], reliability),
            "**Expected calibration error by failure**",
            markdown(["failure", "error"], errors),
            f"**The verdict**: area under the curve {verdict_auc(rows):.3f}, over "
            f"{len(where(edited, bin=-1))} observations of edited and "
            f"{len(where(pristine, bin=-1))} of authentic scenes; with the same failure in both, "
            + ", ".join(
                f"{name} {verdict_auc(where(rows, regime=name)):.3f}"
                for name in pristine.regime.unique()
            ),
            verdicts(edited, pristine),
        ]
    )


def verdicts(edited: Frame, pristine: Frame) -> str:
    """Tabulate by failure how often a scene is called tampered, and what is falsely flagged."""
    lines = []
    for kind, rows in (("edited", edited), ("authentic", pristine)):
        for regime in rows.regime.unique():
            own = where(rows, regime=regime, bin=-1)
            called = own.verdict > 0.5
            values = called.mean(), own.flagged.mean(), (own.flagged * called).mean()
            lines.append([kind, regime, *(f"{value:.2f}" for value in values)])
    heads = ["scene", "failure", "called tampered", "% falsely flagged", "if called tampered"]
    return markdown(heads, lines)


def chart(rows: Frame, path: Path) -> None:
    """The reliability diagram, and the verdicts."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9, 4), layout="constrained")
    edited = rows[rows.edit != "none"]
    left.plot([0, 1], [0, 1], color="#999999", lw=1)
    for k, regime in enumerate(edited.regime.unique()):
        bins = bins_of(where(edited, regime=regime))
        style = {"marker": charts.MARKERS[k], "color": charts.COLORS[k], "ms": 4, "lw": 1}
        left.plot(bins.said, bins.true, label=regime, **style)
    left.set(xlabel="probability of tampering", ylabel="truly tampered")
    left.legend(fontsize=8)
    scenes = where(rows, bin=-1)
    for kind, color in (("edited", charts.COLORS[1]), ("authentic", charts.COLORS[0])):
        values = scenes.verdict[(scenes.edit == "none") == (kind == "authentic")]
        right.hist(values, bins=np.linspace(0, 1, 21), color=color, alpha=0.6, label=kind)
    right.set(xlabel="verdict: probability that anything was edited", ylabel="observations")
    right.legend(fontsize=8)
    charts.save(figure, path)


def main(args: FewArgs) -> None:
    """Measure every case; print and write the tables and the chart."""
    rows = measured(args, "calibration", (rows_of(case) for case in args.cases()))
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "calibration", text)
    chart(rows, args.out / "calibration.png")


if __name__ == "__main__":
    start(main, __doc__)
