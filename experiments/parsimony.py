"""How little is enough: fewer views, pixels, iterations and Gaussians than the full run.

    python experiments/parsimony.py [--quick] [--out docs]

One edit of each scene, clean masks and the calibrated mixture; one resource is cut at a time. With
fewer iterations, all views vote, and fewer epochs or the evenly spread views of a part of one
follow; with none, the vote alone decides. With fewer Gaussians, those with the least blending
weight over all views leave the model before it is looked at; the masks are rendered from what is
left, or among all with those that left as not tampered.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence

import charts
import jax
import numpy as np
from cases import Case, calibrated_mixture, detector_masks, reduced
from looks import Answer, Look, look
from methods import ALL_METHODS, checker, labelled
from runner import FewArgs, heldout_masks, measured, start
from speed_accuracy import CLOSE
from tables import Row, markdown, mean, values_of, where, write_section

from gsc_jax.benchmark.metrics import mean_over_tampered_views
from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.estimators.gschecker import METHODS, MethodConfig

CHECKERS = {"GS-Checker official": METHODS["official"], "GS-Checker paper": METHODS["paper"]}
NAMES = (*CHECKERS, "FlashSplat", "robust")
ALONE, AMONG = "Gaussians", "Gaussians, shown among all"
RESOURCES = ("views", "pixels", "iterations", ALONE, AMONG)
SHARES = (0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
Rung = tuple[Row, Answer]
"""Which resource was cut to what share, and what a method then answers."""


def ladder(case: Case, masks: Mapping[str, np.ndarray], shares: Sequence[float]) -> Iterator[Rung]:
    """Every answer with one resource cut."""
    full, count = look(case, masks), len(case.scene.cameras)
    weight = np.sum(next(iter(full.values())).observation.evidence.total, axis=0)
    for share in shares:
        fewer = reduced(case, masks, max(1, round(share * count)))
        smaller = reduced(case, masks, count, share**0.5)
        yield from answers(look(*fewer) if share < 1 else full, resource="views", share=share)
        yield from answers(look(*smaller) if share < 1 else full, resource="pixels", share=share)
        yield from pruned(case, masks, weight, share)
    for share in (0.0, *shares):
        yield from shortened(full, share)


def answers(looks: Mapping[str, Look], **cut: object) -> Iterator[Rung]:
    """What every method says of what was looked at."""
    for regime, one in looks.items():
        for name in NAMES:
            yield {**cut, "regime": regime, "method": name}, ALL_METHODS[name](one)


def pruned(
    case: Case, masks: Mapping[str, np.ndarray], weight: np.ndarray, share: float
) -> Iterator[Rung]:
    """The answers for the Gaussians of the largest weight, rendered alone and among all."""
    kept = np.sort(np.argsort(-weight, kind="stable")[: round(share * len(weight))])
    model = case.gaussians.take(kept)
    looks = look(dataclasses.replace(case, gaussians=model), masks)
    for row, answer in answers(looks, share=share):
        yield {"resource": ALONE, **row}, dataclasses.replace(answer, gaussians=model)
        labels = np.zeros(len(weight), bool)
        labels[kept] = answer.labels
        yield {"resource": AMONG, **row}, labelled(labels)


def shortened(looks: Mapping[str, Look], share: float) -> Iterator[Rung]:
    """The answers of GS-Checker after fewer iterations."""
    for (regime, one), (name, config) in itertools.product(looks.items(), CHECKERS.items()):
        row = {"resource": "iterations", "share": share, "regime": regime, "method": name}
        yield row, stopped(one, config, share)


def stopped(one: Look, config: MethodConfig, share: float) -> Answer:
    """The answer after a share of the iterations; after none of them nothing is learned."""
    count = len(one.case.scene.cameras)
    steps = round(share * config.epochs * count)
    views = min(steps, count) or count
    chosen = [k * count // views for k in range(views)]
    evidence = jax.tree.map(lambda leaf: leaf[chosen], one.observation.evidence)
    observation = dataclasses.replace(one.observation, evidence=evidence)
    fewer = dataclasses.replace(one, case=reduced(one.case, {}, views)[0], observation=observation)
    rate = config.loop.learning_rate if steps else 0.0
    loop = dataclasses.replace(config.loop, learning_rate=rate)
    epochs = max(1, steps // count)
    return checker(dataclasses.replace(config, epochs=epochs, loop=loop))(fewer)


def rows_of(case: Case, shares: Sequence[float]) -> list[Row]:
    """Every resource, share, regime and method on one edit."""
    regimes = {"clean": REGIMES["clean"], "mixture": calibrated_mixture(case)}
    rungs = list(ladder(case, detector_masks(case, regimes), shares))
    masks = heldout_masks(case.gaussians, case.scene.heldout, [answer for _, answer in rungs])
    truth = list(case.heldout_truth)
    f1 = [mean_over_tampered_views(list(mask), truth).f1 for mask in masks]
    return [{**case.key, **row, "f1": f} for (row, _), f in zip(rungs, f1, strict=True)]


def enough(rows: Sequence[Row]) -> str:
    """The least share from which on all are as good as all, and the best one if it is better."""
    f1 = {share: mean(where(rows, share=share)) for share in sorted(values_of(rows, "share"))}
    if not f1:
        return "-"
    full, best = f1[1.0], max(f1, key=f1.__getitem__)
    short = max((share for share in f1 if f1[share] < full - CLOSE), default=-1.0)
    least = min(share for share in f1 if share > short)
    better = f", best {best:g}: +{f1[best] - full:.2f}" if f1[best] > full + CLOSE else ""
    return f"{least:g}{better}"


def table(rows: Sequence[Row]) -> str:
    """Scenes and methods down, resources across."""
    lines = []
    for scene, name in itertools.product(values_of(rows, "scene"), NAMES):
        own = where(rows, scene=scene, method=name)
        full = mean(where(own, share=1.0, resource="views"))
        cells = [enough(where(own, resource=resource)) for resource in RESOURCES]
        lines.append([scene, name, f"{full:.2f}", *cells])
    return markdown(["scene", "method", "F1 of all", *RESOURCES], lines)


def main(args: FewArgs) -> None:
    """Cut every case; print and write the tables and the chart."""
    shares = (0.2, 0.6, 1.0) if args.quick else SHARES
    cases = args.one_edit_each()
    rows = measured(args, "parsimony", (rows_of(case, shares) for case in cases))
    text = "\n\n".join(
        f"**Least share from which on F1 is at most {CLOSE} below that of all, {regime} masks; "
        f"and the best share where fewer is better**\n\n{table(where(rows, regime=regime))}"
        for regime in values_of(rows, "regime")
    )
    print(text)
    write_section(args.out / "results.md", "parsimony", text)
    panels = {
        f"{resource}, {regime}": where(rows, resource=resource, regime=regime)
        for regime in values_of(rows, "regime")
        for resource in RESOURCES
    }
    names = ("share of all", "F1")
    charts.curves(panels, args.out / "parsimony.png", x="share", labels=names, columns=5)


if __name__ == "__main__":
    start(main, __doc__)
