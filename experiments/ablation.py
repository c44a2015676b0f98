"""Table 3 of the paper, and what else it leaves open: what each part of GS-Checker is worth.

    python experiments/ablation.py [--quick] [--out docs]

Both readings of the method, with one thing changed at a time, on the same evidence: under clean
masks and under the calibrated mixture of failures. The second table renders the same labels by the
three rules that make a mask of them, and the true labels beside them.
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping
from typing import Any

import charts
import numpy as np
from cases import Case, calibrated_mixture, detector_masks
from looks import Answer, Look, Method, look
from methods import checker, labelled, without_3d
from runner import REFERENCE, TRUTH, Args, judge, measured, start
from tables import Row, markdown, pivot, values_of, where, write_section

from gsc_jax.benchmark.metrics import mean_over_tampered_views
from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.estimators.gschecker import CONSENSUS, METHODS, MethodConfig, find
from gsc_jax.evidence.masks import view_mask

PAPER = {
    "paper: the vote alone": "0.85 / 0.74",
    "paper: no 3D loss": "0.88 / 0.78",
    "paper": "0.88 / 0.79",
}
"""F1 / IoU in the paper's Table 3, on its own data: beside ours, not comparable."""
COMMON = "that of all"
"""The rule by which the variants are compared: `share` of the labels."""
RULES = ("attribute", "share", "per-view")


def changed(config: MethodConfig, **of_loop: Any) -> MethodConfig:
    """The configuration with these fields of its loop changed."""
    return dataclasses.replace(config, loop=dataclasses.replace(config.loop, **of_loop))


def variants(name: str) -> Iterator[tuple[str, Method]]:
    """A reading of the method, and one change at a time."""
    full = METHODS[name]
    yield name, checker(full)
    yield f"{name}: the vote alone", functools.partial(vote_alone, consensus=name)
    yield f"{name}: no 3D loss", checker(without_3d(full))
    for share in (0.0, 0.25, 0.75):
        yield f"{name}: 3D loss from {share:.0%}", functools.partial(switched, full, share)
    for lambda2 in (1.0, 3.0):
        yield f"{name}: lambda2 {lambda2:g}", checker(changed(full, lambda2=lambda2))
    other = not full.loop.per_feature
    sign = "a sign per feature" if other else "a sign per Gaussian"
    standardised = dataclasses.replace(full, attributes="standardised")
    yield f"{name}: {sign}", checker(changed(full, per_feature=other))
    yield f"{name}: standardised features", checker(standardised)
    yield f"{name}: standardised, gamma 1000", checker(changed(standardised, gamma=1000.0))
    for epochs in (1, 2, 5, 10):
        if epochs != full.epochs:
            counted = f"{epochs} epoch{'s' if epochs > 1 else ''}"
            yield f"{name}: {counted}", checker(dataclasses.replace(full, epochs=epochs))


def switched(config: MethodConfig, share: float, look: Look) -> Answer:
    """The method whose 3D loss joins after a share of the iterations."""
    iterations = config.epochs * len(look.case.scene.cameras)
    return checker(changed(config, contrastive_start=round(share * iterations)))(look)


def vote_alone(look: Look, *, consensus: str) -> Answer:
    """The initial attribute, not optimised."""
    voted = np.asarray(CONSENSUS[consensus](look.observation.votes)) > 0
    return labelled(voted & look.observation.evidence.seen)


def looks_of(case: Case) -> dict[str, Look]:
    """A case under clean masks and under the mixture."""
    regimes = {"clean": REGIMES["clean"], "mixture": calibrated_mixture(case)}
    return look(case, detector_masks(case, regimes))


def rules_of(looks: Mapping[str, Look]) -> Iterator[Row]:
    """What each rule makes of the labels of a method, and of the true ones."""
    for regime, one in looks.items():
        case = one.case
        truth = case.labels.astype(np.float32)
        found = {
            name: find(case.gaussians, case.scene.cameras, one.observation, config)
            for name, config in METHODS.items()
        }
        scored = {name: (finding.tamper, finding.labels) for name, finding in found.items()}
        for name, (tamper, labels) in {TRUTH: (truth, case.labels), **scored}.items():
            for rule in RULES:
                masks = [
                    view_mask(case.gaussians, camera, tamper, labels, rule=rule)
                    for camera in case.scene.heldout
                ]
                f1 = mean_over_tampered_views(masks, list(case.heldout_truth)).f1
                yield {**case.key, "regime": regime, "method": name, "rule": rule, "f1": f1}


def rows_of(case: Case) -> Iterator[Row]:
    """Every variant by the common rule, and every rule for the methods as they are."""
    looks = looks_of(case)
    methods = dict(variant for name in METHODS for variant in variants(name))
    for row in judge(looks, methods):
        yield {**row, "rule": COMMON}
    yield from rules_of(looks)


def differences(mixture: list[Row]) -> str:
    """What each variant changes: mean, least and largest difference over the cases."""
    lines = []
    for name in values_of(mixture, "method"):
        full = name.split(":")[0]
        if name in REFERENCE or name == full:
            continue
        pairs = zip(where(mixture, method=name), where(mixture, method=full), strict=True)
        change = [variant["f1"] - unchanged["f1"] for variant, unchanged in pairs]
        lines.append([name, *(f"{f(change):+.3f}" for f in (np.mean, np.min, np.max))])
    return markdown(["variant", "mean", "least", "largest"], lines)


def report(rows: list[Row]) -> str:
    """The tables."""
    rules = [row for row in rows if row["rule"] != COMMON]
    rows = where(rows, rule=COMMON)
    mixture = where(rows, regime="mixture")
    return "\n\n".join(
        [
            "**F1 by kind of edit, mixture of failures** (last column: the paper's Table 3, F1 / "
            "IoU, from other scenes and another detector)",
            pivot(
                mixture, "method", "edit", reference=REFERENCE, extra={"paper, all edits": PAPER}
            ),
            "**F1 minus that of the same method unchanged, case by case, mixture**: what two "
            "digits hide",
            differences(mixture),
            "**F1 by masks**",
            pivot(rows, "method", "regime", reference=REFERENCE, total=False),
            "**F1 by the rule that makes masks of labels, mixture of failures**",
            pivot(where(rules, regime="mixture"), "method", "rule", best=None, total=False),
        ]
    )


def main(args: Args) -> None:
    """Judge every variant on every case; print and write the tables and the chart."""
    rows = measured(args, "ablation", (rows_of(case) for case in args.cases()))
    text = report(rows)
    rows = where(rows, rule=COMMON)
    print(text)
    write_section(args.out / "results.md", "ablation", text)
    charts.grid(where(rows, regime="mixture"), args.out / "ablation.png", across="scene")


if __name__ == "__main__":
    start(main, __doc__)
