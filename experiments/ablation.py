"""Table 3 of the paper, extended: the contribution of each part of GS-Checker.

    python experiments/ablation.py [--quick] [--out docs]

Both configurations of GS-Checker, with one change at a time, on the same evidence: under clean
masks and under the calibrated mixture of failures. The last table renders the same labels, and the
true labels, by the three rules that turn labels into masks.
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from typing import Any

import charts
import numpy as np
from cases import Case, calibrated_mixture, detector_masks
from methods import labelled, predict_with, without_3d
from observations import CaseObservation, Method, Prediction, observe_regimes
from runner import Args, judge, measured, start
from tables import (
    TRUTH,
    Frame,
    Row,
    changes,
    pivot,
    where,
    with_columns,
    write_section,
)

from gsc_jax.benchmark.metrics import mean_over_tampered_views
from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.estimators.gschecker import OFFICIAL, PAPER, GSChecker
from gsc_jax.evidence.masks import Labelled, view_mask

CHECKERS = {"paper": PAPER, "official": OFFICIAL}
QUOTED = {
    "paper: the vote alone": "0.85 / 0.74",
    "paper: no 3D loss": "0.88 / 0.78",
    "paper": "0.88 / 0.79",
}
"""F1 / IoU in the paper's Table 3, on its own data: not comparable with ours."""
COMMON = "that of all"
"""Mask rule of the comparison of variants: `share` of the labels."""
RULES = ("attribute", "share", "per-view")


def with_loop(estimator: GSChecker, **fields: Any) -> GSChecker:
    """The estimator with these fields of its loop changed."""
    return dataclasses.replace(estimator, loop=dataclasses.replace(estimator.loop, **fields))


def variants(name: str) -> Iterator[tuple[str, Method]]:
    """A configuration of GS-Checker, and one change at a time."""
    full = CHECKERS[name]
    yield name, predict_with(full)
    yield f"{name}: the vote alone", functools.partial(vote_alone, full)
    yield f"{name}: no 3D loss", predict_with(without_3d(full))
    for share in (0.0, 0.25, 0.75):
        yield f"{name}: 3D loss from {share:.0%}", functools.partial(switched, full, share)
    for lambda2 in (1.0, 3.0):
        yield f"{name}: lambda2 {lambda2:g}", predict_with(with_loop(full, lambda2=lambda2))
    other = not full.loop.per_feature
    sign = "a sign per feature" if other else "a sign per Gaussian"
    standardised = dataclasses.replace(full, attributes="standardised")
    yield f"{name}: {sign}", predict_with(with_loop(full, per_feature=other))
    yield f"{name}: standardised features", predict_with(standardised)
    yield f"{name}: standardised, gamma 1000", predict_with(with_loop(standardised, gamma=1000.0))
    for epochs in (1, 2, 5, 10):
        if epochs != full.epochs:
            counted = f"{epochs} epoch{'s' if epochs > 1 else ''}"
            yield f"{name}: {counted}", predict_with(dataclasses.replace(full, epochs=epochs))


def switched(estimator: GSChecker, share: float, observed: CaseObservation) -> Prediction:
    """Predict with a 3D loss that starts after a share of the iterations."""
    start = round(share * estimator.epochs * len(observed.case.scene.cameras))
    return predict_with(with_loop(estimator, contrastive_start=start))(observed)


def vote_alone(estimator: GSChecker, observed: CaseObservation) -> Prediction:
    """Predict by the initial attribute, without optimisation."""
    voted = np.asarray(estimator.initial_attribute(observed.observation)) > 0
    return labelled(voted & observed.observation.evidence.seen)


def rules_of(observed: Mapping[str, CaseObservation]) -> Iterator[Row]:
    """Measure the masks of each rule from the labels of a configuration and from the true ones."""
    for regime, one in observed.items():
        case = one.case
        findings = {name: own.estimate(one.observation) for name, own in CHECKERS.items()}
        scored = {TRUTH: (case.labels.astype(np.float32), case.labels)}
        scored |= {name: (finding.tamper, finding.labels) for name, finding in findings.items()}
        for name, (tamper, labels) in scored.items():
            for rule in RULES:
                masks = [
                    view_mask(case.gaussians, camera, Labelled(tamper, labels), rule=rule)
                    for camera in case.scene.heldout
                ]
                f1 = mean_over_tampered_views(masks, list(case.heldout_truth)).f1
                yield {**case.key, "regime": regime, "method": name, "rule": rule, "f1": f1}


def rows_of(case: Case) -> Iterator[Row]:
    """Measure every variant by the common rule, and every rule for both configurations."""
    regimes = {"clean": REGIMES["clean"], "mixture": calibrated_mixture(case)}
    observed = observe_regimes(case, detector_masks(case, regimes))
    methods = dict(variant for name in CHECKERS for variant in variants(name))
    for row in judge(observed, methods):
        yield {**row, "rule": COMMON}
    yield from rules_of(observed)


def report(rows: Frame) -> str:
    """All tables."""
    rules = rows[rows.rule != COMMON]
    rows = where(rows, rule=COMMON)
    mixture = where(rows, regime="mixture")
    varied = {name: name.split(":")[0] for name in mixture.method.unique() if ":" in name}
    return "\n\n".join(
        [
            "**F1 by kind of edit, mixture of failures** (last column: the paper's Table 3, F1 / "
            "IoU, from other scenes and another detector)",
            with_columns(pivot(mixture, "method", "edit"), {"paper, all edits": QUOTED}),
            "**F1 minus that of the same method unchanged, case by case, mixture**",
            changes(mixture, varied),
            "**F1 by masks**",
            pivot(rows, "method", "regime", total=False),
            "**F1 by the rule that makes masks of labels, mixture of failures**",
            pivot(where(rules, regime="mixture"), "method", "rule", best=None, total=False),
        ]
    )


def main(args: Args) -> None:
    """Measure every variant on every case; print and write the tables and the chart."""
    rows = measured(args, "ablation", (rows_of(case) for case in args.cases()))
    text = report(rows)
    rows = where(rows, rule=COMMON)
    print(text)
    write_section(args.out / "results.md", "ablation", text)
    charts.grid(where(rows, regime="mixture"), args.out / "ablation.png", across="scene")


if __name__ == "__main__":
    start(main, __doc__)
