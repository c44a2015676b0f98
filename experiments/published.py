"""Tables 1, 2 and 3 of the paper under masks like its own, beside its figures, with `robust`.

    python experiments/published.py [--quick] [--out docs]

The masks have the failures `detector_strengths.PUBLISHED`, which `published_fit.py` found on other
edits of two of the scenes. Of Table 2 only the distortions of the model can be measured: masks that
are simulated from the truth have no images.
"""

import dataclasses
from collections.abc import Iterator, Mapping

import jax
import jax.numpy as jnp
import robustness
from cases import Case, detector_masks
from detector_strengths import PUBLISHED
from distort import DISTORTIONS
from editing import BOUNDARY, PAPER
from methods import ALL_METHODS, sagd
from observations import Method, observe_regimes
from published_fit import FULL, MEASURED, NO_3D, VOTE
from runner import ChosenArgs, judge, measured, start
from tables import TRUTH, Frame, Row, markdown, spread, where, write_section

METHODS: Mapping[str, Method] = {
    "inverse projection": ALL_METHODS["inverse projection"],
    "mode vote": ALL_METHODS["mode vote"],
    "SAGD vote": ALL_METHODS["SAGD vote"],
    BOUNDARY: sagd,
    "SA3D": ALL_METHODS["SA3D"],
    "SA3D, gate": ALL_METHODS["SA3D, gate"],
    "FlashSplat": ALL_METHODS["FlashSplat"],
    f"{FULL}: {VOTE}": MEASURED[VOTE],
    f"{FULL}: {NO_3D}": MEASURED[NO_3D],
    f"{FULL} official": MEASURED[FULL],
    f"{FULL} paper": ALL_METHODS[f"{FULL} paper"],
    "robust": ALL_METHODS["robust"],
}
DISTORTED = ("scales", "opacities")
"""Distortions of the model."""
IN_TABLE_1 = {
    "inverse projection": "inverse projection",
    "SAGD vote": BOUNDARY,
    BOUNDARY: BOUNDARY,
    "SA3D": "SA3D",
    "SA3D, gate": "SA3D",
    f"{FULL} official": f"{FULL} paper",
    f"{FULL} paper": f"{FULL} paper",
}
"""Rows of the paper's Table 1, by method here."""
TABLE_1 = {name: PAPER[row] for name, row in IN_TABLE_1.items()}
TABLE_2 = {
    name: {kind: robustness.PAPER[kind][row] for kind in ("none", *DISTORTED)}
    for name, row in IN_TABLE_1.items()
    if row in robustness.PAPER["none"]
}
TABLE_3 = {f"{FULL}: {VOTE}": 0.8485, f"{FULL}: {NO_3D}": 0.8788, f"{FULL} official": 0.8842}
"""F1 in the paper's Table 3, over all edits."""


def rows_of(case: Case, methods: Mapping[str, Method]) -> Iterator[Row]:
    """Measure these methods on an edit, and on a modification also with a distorted model."""
    masks = detector_masks(case, {"published": PUBLISHED[case.edit]})
    for name in ("none", *(DISTORTED if case.edit == "modification" else ())):
        model = DISTORTIONS[name].of_model(case.gaussians, seed=case.seed)
        distorted = dataclasses.replace(case, gaussians=jax.tree.map(jnp.asarray, model))
        for row in judge(observe_regimes(distorted, masks), methods):
            yield {**row, "distortion": name}


def beside(
    rows: Frame, across: str, figures: Mapping[str, Mapping[str, float]], metric: str = "f1"
) -> str:
    """A table of F1 by method, and for each column the paper's figure and our difference to it."""
    columns = list(dict.fromkeys(rows[across]))
    heads = ["method"]
    for column in columns:
        heads += [column, "paper", "difference"]
    lines = []
    for name in rows.method.unique():
        line: list[str] = []
        for column in columns:
            own = where(rows, **{"method": name, across: column})
            mean, paper = float(own[metric].mean()), figures.get(name, {}).get(column)
            line.append(f"{mean:.2f} ± {spread(own, metric):.2f}")
            line += ["", ""] if paper is None else [f"{paper:.2f}", f"{mean - paper:+.2f}"]
        lines.append([name, *line])
    return markdown(heads, lines)


def report(rows: Frame) -> str:
    """The three tables."""
    rows = rows[rows.method != TRUTH]
    plain = where(rows, distortion="none")
    checker = plain[plain.method.isin([*TABLE_3, "robust"])].assign(edits="all edits")
    quoted = {name: {"all edits": f1} for name, f1 in TABLE_3.items()}
    modified = where(rows, edit="modification")
    return "\n\n".join(
        [
            "**Table 1: F1 by kind of edit**",
            beside(plain, "edit", TABLE_1),
            "**Table 2: F1 on modifications, noise on the model** (strengths as under "
            '"Noise and blur"; the paper states none)',
            beside(modified[modified.method.isin([*TABLE_2, "robust"])], "distortion", TABLE_2),
            "**Table 3: F1 of parts of GS-Checker**",
            beside(checker, "edits", quoted),
        ]
    )


@dataclasses.dataclass(frozen=True, kw_only=True)
class PublishedArgs(ChosenArgs):
    """Arguments of this experiment, whose slowest methods render in every step."""

    seeds: int = 2


def main(args: PublishedArgs) -> None:
    """Measure every case; print and write the tables."""
    methods = args.among(METHODS)
    rows = measured(args, "published", (list(rows_of(case, methods)) for case in args.cases()))
    text = report(rows)
    print(text)
    write_section(args.out / "results.md", "published", text)


if __name__ == "__main__":
    start(main, __doc__)
