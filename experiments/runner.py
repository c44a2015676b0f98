"""The runner of the experiments: what a script covers, and how answers are judged and kept.

Every experiment is a list of cases, a set of mask sets per case ("regimes") and a set of methods.
The blending weights of a view serve all regimes at once, and one composite of all answers as
channels scores them in a held-out view.
"""

import dataclasses
import inspect
import itertools
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro
from cases import DATA, QUICK, Case, available, make_case
from looks import Answer, Look, Method
from methods import ALL_METHODS, labelled
from tables import Row, read_csv, write_csv
from tqdm import tqdm

from gsc_jax.benchmark.metrics import (
    auc,
    confusion,
    false_positive_area,
    mean_over_tampered_views,
)
from gsc_jax.benchmark.tamper import EDITS, Edit
from gsc_jax.evidence.masks import MIN_COVERAGE
from gsc_jax.io.files import existing_file
from gsc_jax.render.tiles import View, make_view
from gsc_jax.scene import Camera, Gaussians, InputError
from gsc_jax.splat import composite_with_alpha

DOCS = Path(__file__).resolve().parents[1] / "docs"
CHANNELS = 32
"""Answers composited at once."""
ITSELF = "the detector itself"
"""What lifting has to beat."""
TRUTH = "true labels"
"""The upper bound: 1 by definition, unless the model is distorted before it is looked at."""
REFERENCE = (ITSELF, TRUTH)
"""Rows that take no part in the contest."""
SAME = 2e-3
"""How well the F1 of these rows is reproduced on another machine."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Args:
    """What an experiment covers, and where its tables go.

    Attributes:
        quick: A small run, in minutes, whose numbers mean little: to see that all of it works.
        out: Folder of results.md, the charts and the tables.
        data: The real scenes; without them only made scenes are used.
        scenes: Which scenes; all that are there by default.
        edits: Which kinds of edit.
        seeds: How many seeds per scene and edit.
        first_seed: The first of them. The tables begin at 0; `robust` was tuned on 10 and 11.
        reprint: Measure nothing: make the tables and charts again of the CSV in the folder.
    """

    quick: bool = False
    out: Path = DOCS
    data: Path = DATA
    scenes: tuple[str, ...] = ()
    edits: tuple[Edit, ...] = EDITS
    seeds: int = 3
    first_seed: int = 0
    reprint: bool = False

    def cases(self, edits: Sequence[Edit] | None = None) -> Iterator[Case]:
        """The cases covered, scene by scene; in a quick run one edit of one made scene each."""
        scenes = (QUICK,) if self.quick else self.scenes or available(self.data)
        count = 1 if self.quick else self.seeds
        seeds = range(self.first_seed, self.first_seed + count)
        jobs = list(itertools.product(scenes, edits or self.edits, seeds))
        for scene, edit, seed in tqdm(jobs, desc="cases", disable=None):
            yield make_case(scene, edit, seed, self.data)

    def one_edit_each(self) -> Iterator[Case]:
        """The cases of an experiment that is long: one kind of edit per scene, taking turns."""
        for k, scene in enumerate(self.scenes or available(self.data)):
            if not (self.quick and k):
                one = dataclasses.replace(self, scenes=(scene,))
                yield from one.cases([self.edits[k % len(self.edits)]])


@dataclasses.dataclass(frozen=True, kw_only=True)
class ChosenArgs(Args):
    """As the others, and which methods.

    Attributes:
        methods: Measure these methods only, by the names in the tables; the rows of all others are
            kept from the CSV in the folder.
    """

    methods: tuple[str, ...] = ()

    def among(self, known: Mapping[str, Method]) -> dict[str, Method]:
        """Of the methods those asked for; all where none is."""
        unknown = [name for name in self.methods if name not in known]
        if unknown:
            raise InputError(f"--methods {unknown[0]!r}: expected some of {', '.join(known)}")
        return {name: known[name] for name in self.methods or known}


def measured(args: Args, name: str, per_case: Iterable[Iterable[Row]]) -> list[Row]:
    """The rows of all cases, kept in OUT/NAME.partial.csv on the way; or those measured before."""
    path, partial = args.out / f"{name}.csv", args.out / f"{name}.partial.csv"
    if args.reprint:
        return read_csv(existing_file(path, expected="rows measured before"))
    if args.quick and path.exists():
        raise InputError(f"{path}: is there; a quick run would replace it, give another --out")
    chosen = isinstance(args, ChosenArgs) and args.methods
    before = read_csv(existing_file(path, expected="rows of the others")) if chosen else []
    args.out.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    for more in per_case:
        rows += more
        write_csv(partial, rows)
    if not rows:
        raise InputError("nothing to measure: --scenes, --edits and --seeds leave no case")
    rows = beside(before, rows) if before else rows
    write_csv(partial, rows)
    partial.replace(path)
    return rows


def beside(before: Sequence[Row], rows: Sequence[Row]) -> list[Row]:
    """Rows of some methods after the rows of the others, measured before on the same cases."""
    if {_case(row) for row in before} != {_case(row) for row in rows}:
        raise InputError("--methods: the rows in the folder are of other cases; measure all anew")
    then, now = (
        [row["f1"] for row in some if row["method"] in REFERENCE] for some in (before, rows)
    )
    if len(then) != len(now) or not np.allclose(then, now, atol=SAME, equal_nan=True):
        raise InputError("--methods: the rows in the folder are of other masks; measure all anew")
    new = {row["method"] for row in rows if row["method"] not in REFERENCE}
    kept = [row for row in before if row["method"] not in new]
    return [*kept, *(row for row in rows if row["method"] in new)]


def _case(row: Row) -> tuple[object, ...]:
    return tuple(row[key] for key in ("scene", "edit", "seed", "regime"))


def start(main: Callable[[Any], None], description: str | None) -> None:
    """Run a script from the command line: its arguments are those of its `main`."""
    (takes,) = inspect.signature(main).parameters.values()
    try:
        main(tyro.cli(takes.annotation, description=description))
    except InputError as error:
        sys.exit(f"{Path(sys.argv[0]).name}: {error}")


@dataclasses.dataclass(frozen=True, kw_only=True)
class FewArgs(Args):
    """As the others, with one seed."""

    seeds: int = 1


def judge(looks: Mapping[str, Look], methods: Mapping[str, Method] = ALL_METHODS) -> Iterator[Row]:
    """Rows per regime: the detector itself, the true labels and every method.

    The detector is scored on the views that it was shown, all others on the held-out ones.
    """
    case = next(iter(looks.values())).case
    answers = {
        (regime, name): method(one)
        for regime, one in looks.items()
        for name, method in {TRUTH: lambda _: labelled(case.labels), **methods}.items()
    }
    masks = heldout_masks(case.gaussians, case.scene.heldout, list(answers.values()))
    for regime, one in looks.items():
        said = np.stack(list(one.observation.masks.values()))
        row = {**case.key, "regime": regime, "method": ITSELF, **by_view(said, one.case.truth)}
        yield {**row, "f1_gaussians": np.nan, "auc": np.nan}
    for (regime, name), predicted in zip(answers, masks, strict=True):
        yield {
            **case.key,
            "regime": regime,
            "method": name,
            **scores(case, answers[regime, name], predicted),
        }


def heldout_masks(
    gaussians: Gaussians, cameras: Sequence[Camera], answers: Sequence[Answer]
) -> list[np.ndarray]:
    """Tampered pixels per answer, each (U, H, W); answers on one scene share a composite."""
    masks: list[np.ndarray] = [np.zeros(0)] * len(answers)
    for scene in {id(answer.gaussians): answer.gaussians for answer in answers}.values():
        own = [k for k, answer in enumerate(answers) if answer.gaussians is scene]
        some = [answers[k] for k in own]
        views = [
            _flagged(make_view(gaussians if scene is None else scene, camera), some)
            for camera in cameras
        ]
        for k, mask in zip(own, np.stack(views, axis=1), strict=True):
            masks[k] = mask
    return masks


def _flagged(view: View, answers: Sequence[Answer]) -> np.ndarray:
    """Tampered pixels of a view, shape (answers, H, W)."""
    flagged = []
    for start in range(0, len(answers), CHANNELS):
        some = answers[start : start + CHANNELS]
        features = np.zeros((len(some[0].labels), CHANNELS), np.float32)
        features[:, : len(some)] = np.stack([answer.rendered for answer in some], axis=1)
        image, alpha = map(np.asarray, composite_with_alpha(view, jnp.asarray(features)))
        covered = alpha > MIN_COVERAGE
        for k, answer in enumerate(some):
            scale = 1.0 if answer.absolute else alpha
            flagged.append(covered & (image[..., k] > answer.level * scale))
    return np.stack(flagged)


def scores(case: Case, answer: Answer, predicted: np.ndarray) -> dict[str, float]:
    """Scores of an answer, with its masks (U, H, W) of the held-out views."""
    return {**by_view(predicted, case.heldout_truth), **by_gaussian(case, answer)}


def by_view(predicted: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """Scores of masks (V, H, W): IMDL-BenCo's, and the share of the pixels falsely flagged."""
    found = mean_over_tampered_views(list(predicted), list(truth))
    values = {name: getattr(found, name) for name in ("f1", "iou", "precision", "recall")}
    values["false_area"] = float(false_positive_area(list(predicted & ~truth)).mean())
    return {name: round(value, 4) for name, value in values.items()}


def by_gaussian(case: Case, answer: Answer) -> dict[str, float]:
    """Scores of the labels, weighted by opacity, and of the score behind them."""
    weights = np.asarray(jax.nn.sigmoid(jnp.asarray(case.gaussians.logit_opacities)))
    found = confusion(answer.labels, case.labels, weights=weights)
    return {"f1_gaussians": round(found.f1, 4), "auc": round(auc(answer.score, case.labels), 4)}
