"""Masks fused with a prior: the attributes after an export, and a prior that is sure and wrong.

    python experiments/fusion.py [--quick] [--out docs]

On scenes and objects that the classifier of the package never saw. The wrong prior marks a compact
authentic region of the size of the edit and is certain that the scene was edited. A fused result
may not be worse than `robust` on the same masks.
"""

import contextlib
import dataclasses
import functools
from collections.abc import Iterator

import numpy as np
from cases import UNSEEN, Case, detector_masks
from export import export
from methods import ALL_METHODS, seeded
from observations import CaseObservation, Prediction, observe_regimes
from runner import CASE_KEYS, Args, judge, measured, start
from tables import Frame, Row, markdown, pivot, write_section

from gsc_jax.benchmark.simulate import REGIMES, decoy_labels
from gsc_jax.estimators import METHODS, Prior
from gsc_jax.forensics.evidence import forensic_evidence

MASKS, ATTRIBUTES, WRONG = "robust", "robust + Gaussians", "robust + wrong prior"
BASELINES = ("FlashSplat", "GS-Checker official")
EXPORTER = "8 bits"
SURE = 0.99
"""Verdict and probability of the wrong prior."""
MAX_LOSS = 0.01
"""Loss of F1 from which a case counts as harmed."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class FusionArgs(Args):
    """Arguments of the experiment, by default for the unseen scenes."""

    scenes: tuple[str, ...] = UNSEEN
    seeds: int = 2


def attributes(case: Case) -> Prior:
    """Evidence from the attributes after an export, in the order of the rows before it."""
    saved, rows = export(case.gaussians, EXPORTER, seed=case.seed)
    evidence = forensic_evidence(saved)
    inverse = np.argsort(rows)
    return Prior(
        probability=evidence.probability[inverse],
        verdict=evidence.verdict,
        known=evidence.known[inverse],
        exact=evidence.exact,
    )


def wrong_prior(case: Case) -> Prior:
    """A prior that is certain of a compact authentic region of the size of the edit."""
    region = decoy_labels(case.gaussians, case.labels, seed=case.seed + 1)
    known = np.ones(len(region), bool)
    return Prior(probability=SURE * region, verdict=SURE, known=known)


def fused(observed: CaseObservation, *, prior: Prior) -> Prediction:
    """Prediction of `robust` with a prior."""
    finding = seeded(METHODS["robust"], observed.case.seed).estimate(observed.observation, prior)
    return Prediction(score=finding.attribute, labels=finding.labels)


def rows_of(case: Case) -> Iterator[Row]:
    """Measure `robust` with each prior, and the baselines, under every regime."""
    priors = {ATTRIBUTES: attributes(case)}
    with contextlib.suppress(ValueError):  # no authentic region is far enough from a large edit
        priors[WRONG] = wrong_prior(case)
    regimes = {name: one for name, one in REGIMES.items() if case.decoy.any() or not one.decoy}
    methods = {name: ALL_METHODS[name] for name in (*BASELINES, MASKS)}
    methods |= {name: functools.partial(fused, prior=prior) for name, prior in priors.items()}
    for row in judge(observe_regimes(case, detector_masks(case, regimes)), methods):
        verdict = priors[str(row["method"])].verdict if row["method"] in priors else np.nan
        yield {**row, "verdict": verdict}


def report(rows: Frame) -> str:
    """F1 by method and regime, and the losses against the masks alone."""
    by_method = rows.pivot_table(index=CASE_KEYS, columns="method", values="f1")
    lines = []
    for name in by_method.columns.intersection([ATTRIBUTES, WRONG]):
        change = (by_method[name] - by_method[MASKS]).dropna()
        harmed, helped = (change < -MAX_LOSS).sum(), (change > MAX_LOSS).sum()
        counts = (f"{harmed} of {len(change)}", f"{helped} of {len(change)}")
        lines.append([name, f"{change.mean():+.3f}", f"{change.min():+.3f}", *counts])
    head = ["", "mean change", "worst", f"worse by {MAX_LOSS}", f"better by {MAX_LOSS}"]
    return "\n\n".join(
        [
            f"**F1 per held-out view, unseen scenes; attributes after an export ({EXPORTER})**",
            pivot(rows, "method", "regime"),
            "**Change of the F1 by a prior, against the masks alone**",
            markdown(head, lines),
        ]
    )


def main(args: FusionArgs) -> None:
    """Measure every case; print and write the tables."""
    rows = measured(args, "fusion", (rows_of(case) for case in args.cases()))
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "fusion", text)


if __name__ == "__main__":
    start(main, __doc__)
