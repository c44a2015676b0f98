"""Which failures of a 2D detector give the figures of the paper? A search, per kind of edit.

    python experiments/published_fit.py [--quick] [--out docs]

The paper gives the F1 of four methods on the same masks (Table 1) and of GS-Checker with parts
left out (Table 3), but not the masks. Failures of the simulated detector are drawn at random, then
around the best ones, and every draw is measured with the same methods, on edits with seeds of their
own. `detector_strengths.PUBLISHED` holds the best draws; `published.py` measures them on other
edits.
"""

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd
from ablation import vote_alone
from cases import MADE, Case, detector_masks
from editing import PAPER
from methods import ALL_METHODS
from observations import Method, observe_regimes
from runner import Args, judge, measured, start
from tables import REFERENCE, Frame, Row, markdown, where, write_section

from gsc_jax.benchmark.simulate import Failures
from gsc_jax.estimators.gschecker import OFFICIAL

FULL, VOTE, NO_3D = "GS-Checker", "the vote alone", "no 3D loss"
MEASURED: Mapping[str, Method] = {
    "inverse projection": ALL_METHODS["inverse projection"],
    "SAGD": ALL_METHODS["SAGD vote"],
    "SA3D": ALL_METHODS["SA3D, gate"],
    FULL: ALL_METHODS["GS-Checker official"],
    VOTE: functools.partial(vote_alone, OFFICIAL),
    NO_3D: ALL_METHODS["GS-Checker official, no 3D loss"],
}
"""Methods of the cells. SAGD without its boundary decomposition, which is too slow for a search."""
TABLE_1 = {
    "inverse projection": PAPER["inverse projection"],
    "SAGD": PAPER["SAGD, boundary"],
    "SA3D": PAPER["SA3D"],
    FULL: PAPER["GS-Checker paper"],
}
"""F1 by method and kind of edit in the paper's Table 1."""
TABLE_3 = {VOTE: 0.8485 - 0.8842, NO_3D: 0.8788 - 0.8842}
"""F1 minus that of the full method in the paper's Table 3, which does not separate the edits."""
RANGES = {
    "boundary": (0.0, 6.0),
    "misses": (0.0, 0.6),
    "blobs": (0.0, 4.0),
    "blob_size": (0.03, 0.12),
    "decoy": (0.0, 1.0),
    "inverted": (0.0, 0.3),
}
"""What the search draws from."""
BEST, STEP = 4, 0.12
"""Draws that the second round varies, and the standard deviation as a share of the range."""
TOGETHER = 12
"""Draws that share the blending weights of a view."""
CLOSE = 0.1
"""Largest error of a cell that counts as reached."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class FitArgs(Args):
    """Arguments of the search; its seeds and the tables' are different ones.

    Attributes:
        draws: Draws of the first round; the second has half as many.
    """

    scenes: tuple[str, ...] = MADE
    seeds: int = 2
    first_seed: int = 20
    draws: int = 48


def first_draws(count: int, seed: int = 0) -> list[Failures]:
    """Draw failures from `RANGES`. A third of the strengths is 0, as most detectors lack some."""
    rng = np.random.default_rng(seed)
    low, high = np.array(list(RANGES.values())).T
    values = rng.uniform(low, high, (count, len(RANGES)))
    absent = (rng.random(values.shape) < 1 / 3) & (low == 0)
    return [_failures(row) for row in np.where(absent, 0, values)]


def draws_near(best: Sequence[Failures], count: int, seed: int = 1) -> list[Failures]:
    """Vary failures by a few percent of the ranges."""
    rng = np.random.default_rng(seed)
    low, high = np.array(list(RANGES.values())).T
    middles = [[getattr(best[k % len(best)], name) for name in RANGES] for k in range(count)]
    steps = rng.normal(0, STEP, (count, len(RANGES))) * (high - low)
    return [_failures(row) for row in np.clip(middles + steps, low, high)]


def _failures(values: np.ndarray) -> Failures:
    return Failures(**{name: round(float(v), 3) for name, v in zip(RANGES, values, strict=True)})


def rows_of(case: Case, draws: Sequence[Failures]) -> list[Row]:
    """F1 of every method under every draw, a row a draw."""
    rows = []
    for first in range(0, len(draws), TOGETHER):
        some = draws[first : first + TOGETHER]
        named = {str(k): failures for k, failures in enumerate(some)}
        observed = observe_regimes(case, detector_masks(case, named))
        f1 = {(r["regime"], r["method"]): r["f1"] for r in judge(observed, MEASURED)}
        for name, failures in named.items():
            strengths = {key: getattr(failures, key) for key in RANGES}
            scores = {method: f1[name, method] for method in (*REFERENCE[:1], *MEASURED)}
            rows.append({**case.key, **strengths, **scores})
    return rows


def search(args: FitArgs) -> Iterator[list[Row]]:
    """Rows of both rounds, case by case."""
    count = 4 if args.quick else args.draws
    rows: list[Row] = []
    for case in args.cases():
        rows += rows_of(case, first_draws(count))
        yield rows[-count:]
    frame = pd.DataFrame(rows)
    near = {}
    for edit in frame.edit.unique():
        ranked = distances(where(frame, edit=edit)).head(BEST)
        best = [Failures(**{key: row[key] for key in RANGES}) for _, row in ranked.iterrows()]
        near[edit] = draws_near(best, count // 2)
    for case in args.cases():
        yield rows_of(case, near[case.edit])


def targets(edit: str) -> dict[str, float]:
    """F1 of the cells of one kind of edit; those of Table 3 relative to the full method."""
    return {name: figures[edit] for name, figures in TABLE_1.items()} | TABLE_3


def distances(rows: Frame) -> Frame:
    """Draws of one kind of edit, nearest first: errors by cell, and their root mean square."""
    keys = list(RANGES)
    means = rows.groupby(keys, sort=False)[list(MEASURED)].mean().reset_index()
    for name, target in targets(rows.edit.iloc[0]).items():
        reached = means[name] - (means[FULL] if name in TABLE_3 else 0)
        means[f"error, {name}"] = reached - target
    errors = means[[f"error, {name}" for name in MEASURED]]
    means["distance"] = np.sqrt((errors**2).mean(axis=1))
    return means.sort_values("distance", kind="stable", ignore_index=True)


def cells(ranked: Frame) -> list[list[str]]:
    """By cell: the error of the nearest draw, the least of any, and the cells that exclude it."""
    lines = []
    for name in MEASURED:
        own = ranked[f"error, {name}"].abs()
        apart = [
            other
            for other in MEASURED
            if np.maximum(own, ranked[f"error, {other}"].abs()).min() > CLOSE
        ]
        lines.append([name, f"{ranked[f'error, {name}'][0]:+.2f}", f"{own.min():.2f}", apart])
    return [[*line[:3], ", ".join(line[3]) or "none"] for line in lines]


def report(rows: Frame) -> str:
    """The best draws, how well they are determined, and the cells that exclude each other."""
    best, parts = [], []
    for edit in rows.edit.unique():
        ranked = distances(where(rows, edit=edit))
        near = ranked[ranked.distance <= 1.25 * ranked.distance[0]]
        spans = [f"{ranked[k][0]:g} ({near[k].min():g} to {near[k].max():g})" for k in RANGES]
        best.append([edit, *spans, f"{ranked.distance[0]:.3f}"])
        heads = [edit, "error, nearest draw", "least error of a draw", "not together with"]
        parts.append(markdown(heads, cells(ranked)))
    draws = len(rows) // len(rows.groupby(["scene", "edit", "seed"]))
    return "\n\n".join(
        [
            f"**The nearest of {draws} draws per kind of edit**, in brackets the range among those "
            "at most a quarter further away; distance: root mean square of the errors of six cells",
            markdown(["edit", *RANGES, "distance"], best),
            "**Errors by cell**: F1 minus the paper's; the last column names the cells that no "
            f"draw reaches within {CLOSE} together with this one (itself, where none reaches it)",
            *parts,
        ]
    )


def main(args: FitArgs) -> None:
    """Search; print and write the tables."""
    rows = measured(args, "published_fit", search(args))
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "published_fit", text)


if __name__ == "__main__":
    start(main, __doc__)
