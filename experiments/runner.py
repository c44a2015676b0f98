"""Runner of the experiments: their arguments, measurement of predictions, and stored rows.

An experiment is a list of cases, a set of mask sets per case ("regimes") and a set of methods. The
blending weights of a view serve all regimes, and one composite with all predictions as channels
scores them in a held-out view.
"""

import dataclasses
import inspect
import itertools
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np
import pandas as pd
import tyro
from cases import DATA, QUICK, Case, available, make_case
from methods import ALL_METHODS, labelled
from observations import CaseObservation, Method, Prediction
from tables import ITSELF, REFERENCE, TRUTH, Frame, Row, read_csv, write_csv
from tqdm import tqdm

from gsc_jax.benchmark.metrics import Confusion, auc, mean_over_tampered_views
from gsc_jax.benchmark.tamper import EDITS, Edit
from gsc_jax.cli.cache import cache_folder, enable_compilation_cache
from gsc_jax.evidence.masks import MIN_COVERAGE
from gsc_jax.io.files import existing_file
from gsc_jax.render.tiles import View, make_view
from gsc_jax.scene import Camera, Gaussians, InputError
from gsc_jax.splat import composite_with_alpha

DOCS = Path(__file__).resolve().parents[1] / "docs"
CHANNELS = 32
"""Predictions composited at once."""
SAME = 2e-3
"""Largest difference of the F1 of these rows between machines."""
CASE_KEYS = ["scene", "edit", "seed", "regime"]
OTHER_CASES = "--methods: the rows in the folder are of other cases; measure all anew"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Args:
    """Arguments of an experiment.

    Attributes:
        quick: Do a small run, in minutes, whose numbers mean little: to see that all of it works.
        out: Folder of results.md, the charts and the tables.
        data: The real scenes; without them only made scenes are used.
        scenes: Scenes to use; all that are available by default.
        edits: Kinds of edit to use.
        seeds: Number of seeds per scene and edit.
        first_seed: First seed. The tables begin at 0; `robust` was tuned on 10 and 11.
        reprint: Measure nothing: make the tables and charts again from the CSV in the folder.
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
        """Make the cases of `jobs`."""
        for job in tqdm(self.jobs(edits), desc="cases", disable=None):
            yield make_case(*job, self.data)

    def jobs(self, edits: Sequence[Edit] | None = None) -> list[tuple[str, Edit, int]]:
        """Scene, edit and seed of each case; a quick run has one seed of one small made scene."""
        scenes = (QUICK,) if self.quick else self.scenes or available(self.data)
        count = 1 if self.quick else self.seeds
        seeds = range(self.first_seed, self.first_seed + count)
        return list(itertools.product(scenes, edits or self.edits, seeds))

    def one_edit_each(self) -> Iterator[Case]:
        """Cases of a long experiment: one kind of edit per scene, in rotation."""
        for k, scene in enumerate(self.scenes or available(self.data)):
            if not (self.quick and k):
                one = dataclasses.replace(self, scenes=(scene,))
                yield from one.cases([self.edits[k % len(self.edits)]])


@dataclasses.dataclass(frozen=True, kw_only=True)
class ChosenArgs(Args):
    """Arguments of an experiment that can be limited to some methods.

    Attributes:
        methods: Measure only these methods, by their names in the tables; the rows of all others
            are kept from the CSV in the folder.
    """

    methods: tuple[str, ...] = ()

    def among(self, known: Mapping[str, Method]) -> dict[str, Method]:
        """The requested methods; all by default."""
        unknown = [name for name in self.methods if name not in known]
        if unknown:
            raise InputError(f"--methods {unknown[0]!r}: expected some of {', '.join(known)}")
        return {name: known[name] for name in self.methods or known}


@dataclasses.dataclass(frozen=True, kw_only=True)
class FewArgs(Args):
    """Arguments of an experiment with one seed."""

    seeds: int = 1


def refuse_unused(args: Args, *names: str) -> None:
    """Raise InputError if an option was given that an experiment does not use."""
    defaults = {field.name: field.default for field in dataclasses.fields(args)}
    for name in names:
        if getattr(args, name) != defaults[name]:
            raise InputError(
                f"--{name.replace('_', '-')}: this experiment has its own; leave it out"
            )


def measured(args: Args, name: str, per_case: Iterable[Iterable[Row]]) -> Frame:
    """Measure all cases, with intermediate rows in OUT/NAME.partial.csv; or read OUT/NAME.csv."""
    path, partial = args.out / f"{name}.csv", args.out / f"{name}.partial.csv"
    if args.reprint:
        return read_csv(existing_file(path, expected="rows measured before"))
    if args.quick and path.exists():
        raise InputError(f"{path}: is there; a quick run would replace it, give another --out")
    chosen = isinstance(args, ChosenArgs) and args.methods
    before = read_csv(existing_file(path, expected="rows of the others")) if chosen else None
    args.out.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    for more in per_case:
        rows += more
        write_csv(partial, pd.DataFrame(rows))
        if before is not None and not _cases(pd.DataFrame(rows)) <= _cases(before):
            raise InputError(OTHER_CASES)  # now, and not after hours
    if not rows:
        raise InputError("nothing to measure: --scenes, --edits and --seeds leave no case")
    merged = pd.DataFrame(rows) if before is None else merge(before, pd.DataFrame(rows))
    write_csv(partial, merged)
    partial.replace(path)
    return merged


def merge(before: Frame, rows: Frame) -> Frame:
    """Append rows of some methods to rows of the others, measured before on the same cases."""
    if _cases(before) != _cases(rows):
        raise InputError(OTHER_CASES)
    measures = ["f1", "false_area"]  # F1 of authentic scenes does not exist
    then, now = (some.loc[some.method.isin(REFERENCE), measures] for some in (before, rows))
    if len(then) != len(now) or not np.allclose(then, now, atol=SAME, equal_nan=True):
        raise InputError("--methods: the rows in the folder are of other masks; measure all anew")
    new = rows[~rows.method.isin(REFERENCE)]
    return pd.concat([before[~before.method.isin(new.method)], new], ignore_index=True)


def _cases(rows: Frame) -> set[tuple[Any, ...]]:
    return set(rows[CASE_KEYS].itertuples(index=False, name=None))


def start(main: Callable[[Any], None], description: str | None) -> None:
    """Run a script from the command line: its arguments are those of its `main`.

    Compiled functions are stored, since each size of a scene needs its own: no time is measured
    with compilation.
    """
    (takes,) = inspect.signature(main).parameters.values()
    try:
        args = tyro.cli(takes.annotation, description=description)
        enable_compilation_cache(cache_folder())
        main(args)
    except InputError as error:
        sys.exit(f"{Path(sys.argv[0]).name}: {error}")


def judge(
    observed: Mapping[str, CaseObservation], methods: Mapping[str, Method] = ALL_METHODS
) -> Iterator[Row]:
    """Measure the detector itself, the true labels and every method under every regime.

    The detector is scored on the views that it was shown, all others on the held-out views.
    """
    case = next(iter(observed.values())).case
    predictions = {
        (regime, name): method(one)
        for regime, one in observed.items()
        for name, method in {TRUTH: lambda _: labelled(case.labels), **methods}.items()
    }
    masks = heldout_masks(case.gaussians, case.scene.heldout, list(predictions.values()))
    for regime, one in observed.items():
        own = np.stack(list(one.observation.masks.values()))
        row = {**case.key, "regime": regime, "method": ITSELF, **by_view(own, one.case.truth)}
        yield {**row, "f1_gaussians": np.nan, "auc": np.nan}
    for (key, prediction), mask in zip(predictions.items(), masks, strict=True):
        row = {**case.key, **dict(zip(("regime", "method"), key, strict=True))}
        yield {**row, **scores(case, prediction, mask)}


def heldout_masks(
    gaussians: Gaussians, cameras: Sequence[Camera], predictions: Sequence[Prediction]
) -> list[np.ndarray]:
    """Tampered pixels per prediction, each (U, H, W); predictions on one scene share composites."""
    masks: list[np.ndarray] = [np.zeros(0)] * len(predictions)
    for scene in {id(one.gaussians): one.gaussians for one in predictions}.values():
        own = [k for k, one in enumerate(predictions) if one.gaussians is scene]
        some = [predictions[k] for k in own]
        views = [
            _flagged(make_view(gaussians if scene is None else scene, camera), some)
            for camera in cameras
        ]
        for k, mask in zip(own, np.stack(views, axis=1), strict=True):
            masks[k] = mask
    return masks


def _flagged(view: View, predictions: Sequence[Prediction]) -> np.ndarray:
    """Tampered pixels of a view, shape (predictions, H, W)."""
    flagged = []
    for first in range(0, len(predictions), CHANNELS):
        some = predictions[first : first + CHANNELS]
        features = np.zeros((len(some[0].labels), CHANNELS), np.float32)
        features[:, : len(some)] = np.stack([one.rendered for one in some], axis=1)
        image, alpha = map(np.asarray, composite_with_alpha(view, jnp.asarray(features)))
        covered = alpha > MIN_COVERAGE
        for k, one in enumerate(some):
            scale = 1.0 if one.absolute else alpha
            flagged.append(covered & (image[..., k] > one.level * scale))
    return np.stack(flagged)


def scores(case: Case, prediction: Prediction, masks: np.ndarray) -> dict[str, float]:
    """Scores of a prediction, with its masks (U, H, W) of the held-out views."""
    return {**by_view(masks, case.heldout_truth), **by_gaussian(case, prediction)}


def by_view(masks: np.ndarray, truth: np.ndarray) -> dict[str, float]:
    """IMDL-BenCo's scores of masks (V, H, W), and the share of the pixels falsely flagged."""
    mean = mean_over_tampered_views(list(masks), list(truth))
    values = {name: getattr(mean, name) for name in ("f1", "iou", "precision", "recall")}
    values["false_area"] = float((masks & ~truth).mean())
    return {name: round(value, 4) for name, value in values.items()}


def by_gaussian(case: Case, prediction: Prediction) -> dict[str, float]:
    """F1 of the labels, weighted by opacity, and AUC of the score."""
    opacities = np.asarray(case.gaussians.opacities, np.float64)
    found, true = np.asarray(prediction.labels), np.asarray(case.labels)
    outcomes = found & true, found & ~true, ~found & true, ~found & ~true
    f1 = Confusion(*(float(opacities[outcome].sum()) for outcome in outcomes)).f1
    return {"f1_gaussians": round(f1, 4), "auc": round(auc(prediction.score, case.labels), 4)}
