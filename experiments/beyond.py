"""What each part of the estimator is worth, and what did not make it into it.

    python experiments/beyond.py [--quick] [--out docs]

One edit of each scene. The steps that led to `robust`, from the share of what the views saw that
was flagged, each judged on the same evidence under all failures; then `robust` with one
part switched off, and with parts that were tried: neighbours by colour and size as well as by place
(the paper's contrast, made local), and only the compact parts of what is labelled.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import charts
import numpy as np
from cases import Case, calibrated_mixture, detector_masks
from looks import Answer, Look, Method, look
from methods import checker, labelled
from runner import REFERENCE, ChosenArgs, judge, measured, start
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from tables import Row, markdown, pivot, values_of, where, write_section

from gsc_jax.benchmark.simulate import REGIMES
from gsc_jax.estimators.robust.estimator import RobustConfig, find_robust, looks_of
from gsc_jax.scene.neighbours import nearest_neighbours

FULL = "robust"
DEFAULT = RobustConfig()
OFTEN = 0.99
"""Quantile of the flag rates that counts as the best of them."""
ISLAND = 0.1
"""Share of the largest connected part from which on another one is kept."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class BeyondArgs(ChosenArgs):
    """As the others, with one seed."""

    seeds: int = 1


def rates_of(one: Look, inverted: np.ndarray | None = None) -> np.ndarray:
    """Share of the looks at each Gaussian in which it was flagged, shape (N,); unseen is 0."""
    looked, flagged = looks_of(one.observation.evidence, slice(None), DEFAULT.trust)
    if inverted is not None:
        flagged = np.where(inverted[:, None], looked - flagged, flagged)
    return flagged.sum(axis=0) / np.maximum(looked.sum(axis=0), 1e-30)


def flag_rate(one: Look) -> Answer:
    """Flagged in more than half of what was seen of it."""
    return labelled(rates_of(one) > 0.5)


def turned(one: Look) -> np.ndarray:
    """Views that flag most of what they see, and whose flags the other views contradict."""
    looked, flagged = looks_of(one.observation.evidence, slice(None), DEFAULT.trust)
    others = (flagged.sum(axis=0) - flagged) / np.maximum(looked.sum(axis=0) - looked, 1e-30)
    centred = looked * (others - np.average(others, axis=1, weights=looked + 1e-30)[:, None])
    against = (centred * (flagged / np.maximum(looked, 1e-30))).sum(axis=1) < 0
    return against & (flagged.sum(axis=1) > 0.5 * looked.sum(axis=1))


def flag_rate_turned(one: Look) -> Answer:
    """The same with inverted views turned."""
    return labelled(rates_of(one, turned(one)) > 0.5)


def flag_rate_relative(one: Look) -> Answer:
    """Flagged at least half as often as what is flagged most often."""
    rates = rates_of(one, turned(one))
    flagged = rates[rates > 0.1]
    best = np.quantile(flagged, OFTEN) if flagged.size else 1.0
    return labelled(rates > 0.5 * best)


def by_colour_too(one: Look) -> Answer:
    """`robust` whose neighbours are near in place, colour and size."""
    gaussians = one.case.gaussians
    means = np.asarray(gaussians.means)
    looks = [np.asarray(gaussians.sh[:, 0]), np.asarray(gaussians.log_scales).mean(1)[:, None]]
    spacing = np.median(
        np.linalg.norm(
            means - means[nearest_neighbours(means, np.arange(len(means)), 8)[:, 7]], axis=1
        )
    )
    columns = [means / spacing, *(2 * (c - c.mean(0)) / np.maximum(c.std(0), 1e-9) for c in looks)]
    config = dataclasses.replace(DEFAULT, seed=one.case.seed)
    found = find_robust(one.observation.evidence, np.concatenate(columns, axis=1), config)
    return labelled(found.labels)


def compact(one: Look) -> Answer:
    """`robust` without what is labelled far from the rest."""
    answer = checker(DEFAULT)(one)
    chosen = np.flatnonzero(answer.labels)
    if len(chosen) <= DEFAULT.neighbours:
        return answer
    points = np.asarray(one.case.gaussians.means)[chosen]
    near = nearest_neighbours(points, np.arange(len(points)), DEFAULT.neighbours)
    edges = np.repeat(np.arange(len(points)), near.shape[1]), near.ravel()
    graph = coo_array((np.ones(near.size, np.int8), edges), shape=(len(points), len(points)))
    _, part = connected_components(graph, directed=False)
    weight = np.bincount(part, np.sum(one.observation.evidence.total, axis=0)[chosen])
    labels = np.zeros_like(answer.labels)
    labels[chosen] = (weight >= ISLAND * weight.max())[part]
    return labelled(labels)


def without(**changed: Any) -> Method:
    """`robust` with some of its configuration changed."""
    return checker(dataclasses.replace(DEFAULT, **changed))


VARIANTS: Mapping[str, Method] = {
    "flag rate over a half": flag_rate,
    "+ inverted views turned": flag_rate_turned,
    "+ relative to the best rate": flag_rate_relative,
    "two latent classes": without(classes=(2,), rivals=False, smoothing=0.0),
    "latent classes": without(rivals=False, smoothing=0.0),
    "+ rivals": without(smoothing=0.0),
    FULL: checker(DEFAULT),
    "robust: no inverted views": without(inversion=False),
    "robust: no rivals": without(rivals=False),
    "robust: 8 classes": without(classes=(8,)),
    "robust: up to 12 classes": without(classes=(4, 8, 12)),
    "robust: 16 neighbours": without(neighbours=16),
    "robust: neighbours by colour too": by_colour_too,
    "robust: compact": compact,
    "robust: no doubt": without(doubt=0.0),
}


def rows_of(case: Case, methods: Mapping[str, Method]) -> list[Row]:
    """Every variant under every failure."""
    regimes = {**REGIMES, "mixture": calibrated_mixture(case)}
    return list(judge(look(case, detector_masks(case, regimes)), methods))


def differences(rows: list[Row]) -> str:
    """What each variant changes: mean, least and largest difference over cases and failures."""
    lines = []
    for name in values_of(rows, "method"):
        if name not in (FULL, *REFERENCE):
            pairs = zip(where(rows, method=name), where(rows, method=FULL), strict=True)
            change = [variant["f1"] - full["f1"] for variant, full in pairs]
            lines.append([name, *(f"{f(change):+.3f}" for f in (np.mean, np.min, np.max))])
    return markdown(["variant", "mean", "least", "largest"], lines)


def report(rows: list[Row]) -> str:
    """The tables."""
    return "\n\n".join(
        [
            "**F1 of the steps, and of `robust` with one thing changed, by failure**",
            pivot(rows, "method", "regime", reference=REFERENCE, digits=3),
            "**F1 minus that of `robust`, case by case and failure by failure**",
            differences(rows),
        ]
    )


def main(args: BeyondArgs) -> None:
    """Judge every variant on every case; print and write the tables and the chart."""
    methods = args.among(VARIANTS)
    cases = args.one_edit_each()
    rows = measured(args, "beyond", (rows_of(case, methods) for case in cases))
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "beyond", text)
    charts.grid(rows, args.out / "beyond.png", across="regime")


if __name__ == "__main__":
    start(main, __doc__)
