"""Least resources: fewer views, pixels, iterations and Gaussians than the full run.

    python experiments/parsimony.py [--quick] [--out docs]

One edit of each scene, clean masks and the calibrated mixture; one resource is reduced at a time.
With fewer iterations, all views vote, followed by fewer epochs or by evenly spread views of a part
of one; with none, the vote alone decides. With fewer Gaussians, those of the least blending weight
over all views are removed before the model is observed; the masks are rendered from the rest, or
from all with the removed ones as authentic.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence

import charts
import numpy as np
from cases import Case, calibrated_mixture, detector_masks, reduced
from methods import ALL_METHODS, labelled, predict_with
from observations import CaseObservation, Prediction, observe_regimes
from runner import FewArgs, heldout_masks, measured, start
from speed_accuracy import CLOSE
from tables import Frame, Row, markdown, where, write_section

from gsc_jax.benchmark.metrics import mean_over_tampered_views
from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.estimators.gschecker import OFFICIAL, PAPER, GSChecker
from gsc_jax.evidence.lifting import Evidence

CHECKERS = {"GS-Checker official": OFFICIAL, "GS-Checker paper": PAPER}
NAMES = (*CHECKERS, "FlashSplat", "robust")
ALONE, AMONG = "Gaussians", "Gaussians, shown among all"
RESOURCES = ("views", "pixels", "iterations", ALONE, AMONG)
SHARES = (0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 1.0)
Step = tuple[Row, Prediction]
"""A resource with its share, and the prediction of a method."""


def reductions(
    case: Case, masks: Mapping[str, np.ndarray], shares: Sequence[float]
) -> Iterator[Step]:
    """All predictions with one resource reduced."""
    full, count = observe_regimes(case, masks), len(case.scene.cameras)
    weight = np.sum(next(iter(full.values())).observation.evidence.total, axis=0)
    for share in shares:
        fewer = reduced(case, masks, max(1, round(share * count)))
        smaller = reduced(case, masks, count, share**0.5)
        for resource, part in (("views", fewer), ("pixels", smaller)):
            observed = observe_regimes(*part) if share < 1 else full
            yield from predictions(observed, resource=resource, share=share)
        yield from pruned(case, masks, weight, share)
    for share in (0.0, *shares):
        yield from shortened(full, share)


def predictions(observed: Mapping[str, CaseObservation], **reduction: object) -> Iterator[Step]:
    """Predictions of every method under every regime."""
    for regime, one in observed.items():
        for name in NAMES:
            yield {**reduction, "regime": regime, "method": name}, ALL_METHODS[name](one)


def pruned(
    case: Case, masks: Mapping[str, np.ndarray], weight: np.ndarray, share: float
) -> Iterator[Step]:
    """Predictions for the Gaussians of the largest weight, rendered alone and among all."""
    kept = np.sort(np.argsort(-weight, kind="stable")[: round(share * len(weight))])
    model = case.gaussians.take(kept)
    observed = observe_regimes(dataclasses.replace(case, gaussians=model), masks)
    for row, prediction in predictions(observed, share=share):
        yield {"resource": ALONE, **row}, dataclasses.replace(prediction, gaussians=model)
        labels = np.zeros(len(weight), bool)
        labels[kept] = prediction.labels
        yield {"resource": AMONG, **row}, labelled(labels)


def shortened(observed: Mapping[str, CaseObservation], share: float) -> Iterator[Step]:
    """Predictions of GS-Checker after fewer iterations."""
    for (regime, one), (name, full) in itertools.product(observed.items(), CHECKERS.items()):
        row = {"resource": "iterations", "share": share, "regime": regime, "method": name}
        yield row, stopped(one, full, share)


def stopped(one: CaseObservation, estimator: GSChecker, share: float) -> Prediction:
    """Prediction after a share of the iterations; with share 0 nothing is optimised."""
    count = len(one.case.scene.cameras)
    steps = round(share * estimator.epochs * count)
    views = min(steps, count) or count
    chosen = [k * count // views for k in range(views)]
    every = one.observation.evidence
    evidence = Evidence(total=every.total[chosen], tampered=every.tampered[chosen])
    cameras = tuple(one.observation.cameras[k] for k in chosen)
    observation = dataclasses.replace(one.observation, evidence=evidence, cameras=cameras)
    fewer = dataclasses.replace(one, case=reduced(one.case, {}, views)[0], observation=observation)
    rate = estimator.loop.learning_rate if steps else 0.0
    loop = dataclasses.replace(estimator.loop, learning_rate=rate)
    epochs = max(1, steps // count)
    return predict_with(dataclasses.replace(estimator, epochs=epochs, loop=loop))(fewer)


def rows_of(case: Case, shares: Sequence[float]) -> list[Row]:
    """Measure every resource, share, regime and method on one edit."""
    regimes = {"clean": REGIMES["clean"], "mixture": calibrated_mixture(case)}
    steps = list(reductions(case, detector_masks(case, regimes), shares))
    masks = heldout_masks(case.gaussians, case.scene.heldout, [one for _, one in steps])
    truth = list(case.heldout_truth)
    f1 = [mean_over_tampered_views(list(mask), truth).f1 for mask in masks]
    return [{**case.key, **row, "f1": f} for (row, _), f in zip(steps, f1, strict=True)]


def enough(rows: Frame) -> str:
    """Least share from which on F1 is that of the full run, and the best share if it is higher."""
    if rows.empty:
        return "-"
    f1 = rows.groupby("share").f1.mean()
    full, best = f1[1.0], f1.idxmax()
    worse = f1.index[f1 < full - CLOSE].max()
    least = f1.index[f1.index > (-1.0 if np.isnan(worse) else worse)].min()
    better = f", best {best:g}: +{f1[best] - full:.2f}" if f1[best] > full + CLOSE else ""
    return f"{least:g}{better}"


def table(rows: Frame) -> str:
    """Scenes and methods down, resources across."""
    lines = []
    for scene, name in itertools.product(rows.scene.unique(), NAMES):
        own = where(rows, scene=scene, method=name)
        full = where(own, share=1.0, resource="views").f1.mean()
        cells = [enough(where(own, resource=resource)) for resource in RESOURCES]
        lines.append([scene, name, f"{full:.2f}", *cells])
    return markdown(["scene", "method", "F1 of all", *RESOURCES], lines)


def main(args: FewArgs) -> None:
    """Measure every case; print and write the tables and the chart."""
    shares = (0.2, 0.6, 1.0) if args.quick else SHARES
    cases = args.one_edit_each()
    rows = measured(args, "parsimony", (rows_of(case, shares) for case in cases))
    text = "\n\n".join(
        f"**Least share with an F1 at most {CLOSE} below that of the full run, {regime} masks; and "
        f"the best share where fewer is better**\n\n{table(where(rows, regime=regime))}"
        for regime in rows.regime.unique()
    )
    print(text)
    write_section(args.out / "results.md", "parsimony", text)
    panels = {
        f"{resource}, {regime}": where(rows, resource=resource, regime=regime)
        for regime in rows.regime.unique()
        for resource in RESOURCES
    }
    names = ("share of all", "F1")
    charts.curves(panels, args.out / "parsimony.png", x="share", labels=names, columns=5)


if __name__ == "__main__":
    start(main, __doc__)
