"""The contribution of each part of `robust`, and of parts that were tried and left out.

    python experiments/beyond.py [--quick] [--out docs]

One edit of each scene. The steps that lead from the flagged share of the evidence to `robust`, each
measured on the same evidence under all failures; then `robust` with one part switched off, and with
parts that were tried: neighbours by colour and size as well as by position (the paper's contrast,
made local), and only the compact parts of what is labelled.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import charts
import numpy as np
from cases import Case, calibrated_mixture, detector_masks
from methods import labelled, predict_with
from observations import CaseObservation, Method, Prediction, observe_regimes
from runner import ChosenArgs, judge, measured, start
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from tables import REFERENCE, Frame, Row, changes, pivot, write_section

from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.estimators import RobustEstimator
from gsc_jax.estimators.robust.gaussian_visibility import visibility
from gsc_jax.scene.neighbours import nearest_neighbours

FULL = "robust"
DEFAULT = RobustEstimator()
TOP_QUANTILE = 0.99
"""Quantile of the flag rates that stands for the best of them."""
MIN_PART = 0.1
"""Least weight of a connected part that is kept, relative to the heaviest part."""


def totals(one: CaseObservation) -> tuple[np.ndarray, np.ndarray]:
    """Visibility of every Gaussian in every view, and its flagged part, shapes (V, N)."""
    return visibility(one.observation.evidence, slice(None), DEFAULT.half_weight)


def flag_rates(one: CaseObservation, inverted: np.ndarray | None = None) -> np.ndarray:
    """Flagged share of the visibility of each Gaussian, shape (N,); 0 where unseen."""
    seen, flagged = totals(one)
    if inverted is not None:
        flagged = np.where(inverted[:, None], seen - flagged, flagged)
    return flagged.sum(axis=0) / np.maximum(seen.sum(axis=0), 1e-30)


def flag_rate(one: CaseObservation) -> Prediction:
    """Label Gaussians that are flagged in more than half of their visibility."""
    return labelled(flag_rates(one) > 0.5)


def inverted_views(one: CaseObservation) -> np.ndarray:
    """Mask of the views that flag most of what they see, against the other views, shape (V,)."""
    seen, flagged = totals(one)
    others = (flagged.sum(axis=0) - flagged) / np.maximum(seen.sum(axis=0) - seen, 1e-30)
    centred = seen * (others - np.average(others, axis=1, weights=seen + 1e-30)[:, None])
    against = (centred * (flagged / np.maximum(seen, 1e-30))).sum(axis=1) < 0
    return against & (flagged.sum(axis=1) > 0.5 * seen.sum(axis=1))


def flag_rate_turned(one: CaseObservation) -> Prediction:
    """`flag_rate` with inverted views turned."""
    return labelled(flag_rates(one, inverted_views(one)) > 0.5)


def flag_rate_relative(one: CaseObservation) -> Prediction:
    """Label Gaussians with at least half of the highest flag rate, inverted views turned."""
    rates = flag_rates(one, inverted_views(one))
    flagged = rates[rates > 0.1]
    best = np.quantile(flagged, TOP_QUANTILE) if flagged.size else 1.0
    return labelled(rates > 0.5 * best)


def by_colour_too(one: CaseObservation) -> Prediction:
    """`robust` with neighbours by position, colour and size."""
    gaussians = one.case.gaussians
    means = np.asarray(gaussians.means)
    others = [np.asarray(gaussians.sh[:, 0]), np.asarray(gaussians.log_scales).mean(1)[:, None]]
    eighth = nearest_neighbours(means, np.arange(len(means)), 8)[:, 7]
    spacing = np.median(np.linalg.norm(means - means[eighth], axis=1))
    scaled = [2 * (c - c.mean(0)) / np.maximum(c.std(0), 1e-9) for c in others]
    columns = np.concatenate([means / spacing, *scaled], axis=1)
    estimator = dataclasses.replace(DEFAULT, seed=one.case.seed)
    return labelled(estimator.estimate_from_evidence(one.observation.evidence, columns).labels)


def compact(one: CaseObservation) -> Prediction:
    """`robust` without small labelled parts apart from the heaviest one."""
    prediction = predict_with(DEFAULT)(one)
    chosen = np.flatnonzero(prediction.labels)
    if len(chosen) <= DEFAULT.neighbours:
        return prediction
    points = np.asarray(one.case.gaussians.means)[chosen]
    near = nearest_neighbours(points, np.arange(len(points)), DEFAULT.neighbours)
    edges = np.repeat(np.arange(len(points)), near.shape[1]), near.ravel()
    graph = coo_array((np.ones(near.size, np.int8), edges), shape=(len(points), len(points)))
    _, part = connected_components(graph, directed=False)
    weight = np.bincount(part, np.sum(one.observation.evidence.total, axis=0)[chosen])
    labels = np.zeros_like(prediction.labels)
    labels[chosen] = (weight >= MIN_PART * weight.max())[part]
    return labelled(labels)


def robust_with(**fields: Any) -> Method:
    """`robust` with some of its fields changed."""
    return predict_with(dataclasses.replace(DEFAULT, **fields))


VARIANTS: Mapping[str, Method] = {
    "flag rate over a half": flag_rate,
    "+ inverted views turned": flag_rate_turned,
    "+ relative to the best rate": flag_rate_relative,
    "two latent classes": robust_with(classes=(2,), distractors=False, smoothing=0.0),
    "latent classes": robust_with(distractors=False, smoothing=0.0),
    "+ distractors": robust_with(smoothing=0.0),
    FULL: predict_with(DEFAULT),
    "robust: no inverted views": robust_with(inversion=False),
    "robust: no distractors": robust_with(distractors=False),
    "robust: the best of 2 fits": robust_with(restarts=1),
    "robust: the best 5 of 8 fits": robust_with(restarts=4),
    "robust: the best 17 of 32 fits": robust_with(restarts=16),
    "robust: 8 classes": robust_with(classes=(8,)),
    "robust: up to 12 classes": robust_with(classes=(4, 8, 12)),
    "robust: 16 neighbours": robust_with(neighbours=16),
    "robust: neighbours by colour too": by_colour_too,
    "robust: compact": compact,
    "robust: no `min_verdict`": robust_with(min_verdict=0.0),
}
"""Variants by their names in the tables."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class BeyondArgs(ChosenArgs):
    """Arguments of the experiment, with one seed."""

    seeds: int = 1


def rows_of(case: Case, methods: Mapping[str, Method]) -> list[Row]:
    """Measure every variant under every failure."""
    regimes = {**REGIMES, "mixture": calibrated_mixture(case)}
    return list(judge(observe_regimes(case, detector_masks(case, regimes)), methods))


def report(rows: Frame) -> str:
    """All tables."""
    variants = [name for name in rows.method.unique() if name not in (FULL, *REFERENCE)]
    return "\n\n".join(
        [
            "**F1 of the steps, and of `robust` with one thing changed, by failure**",
            pivot(rows, "method", "regime", digits=3),
            "**F1 minus that of `robust`, case by case and failure by failure**",
            changes(rows, dict.fromkeys(variants, FULL)),
        ]
    )


def main(args: BeyondArgs) -> None:
    """Measure every variant on every case; print and write the tables and the chart."""
    methods = args.among(VARIANTS)
    cases = args.one_edit_each()
    rows = measured(args, "beyond", (rows_of(case, methods) for case in cases))
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "beyond", text)
    charts.grid(rows, args.out / "beyond.png", across="regime")


if __name__ == "__main__":
    start(main, __doc__)
