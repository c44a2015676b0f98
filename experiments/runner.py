"""The runner of the experiments: look once, let every method judge the same evidence, score it.

Every experiment is a list of cases, a set of mask sets per case ("regimes") and a set of methods.
The blending weights of a view serve all regimes at once, and one composite of all answers as
channels scores them in a held-out view.
"""

import dataclasses
import functools
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
from tables import Row, read_csv, write_csv
from tqdm import tqdm

from gsc_jax.benchmark.baselines import (
    SA3D_LEVEL,
    flashsplat,
    inverse,
    mode_vote,
    sa3d,
    sagd_boundary,
    sagd_vote,
)
from gsc_jax.benchmark.metrics import (
    auc,
    confusion,
    false_positive_area,
    iou,
    mean_over_tampered_views,
)
from gsc_jax.benchmark.tamper import EDITS, Edit
from gsc_jax.decide import MIN_COVERAGE
from gsc_jax.errors import InputError
from gsc_jax.evidence import Evidence
from gsc_jax.io.files import existing_file
from gsc_jax.method import METHODS, MethodConfig, find
from gsc_jax.observe import Observation
from gsc_jax.projection import project_centers
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.splat import accumulate, composite, composite_with_alpha
from gsc_jax.tiles import View, make_view
from gsc_jax.vote import cast_votes, no_votes, tally

DOCS = Path(__file__).resolve().parents[1] / "docs"
CHANNELS = 32
"""Answers composited at once."""
ITSELF = "the detector itself"
"""What lifting has to beat."""
TRUTH = "true labels"
"""The upper bound: 1 by definition, unless the model is distorted before it is looked at."""
REFERENCE = (ITSELF, TRUTH)
"""Rows that take no part in the contest."""


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
        reprint: Measure nothing: make the tables and charts again of the CSV in the folder.
    """

    quick: bool = False
    out: Path = DOCS
    data: Path = DATA
    scenes: tuple[str, ...] = ()
    edits: tuple[Edit, ...] = EDITS
    seeds: int = 3
    reprint: bool = False

    def cases(self, edits: Sequence[Edit] | None = None) -> Iterator[Case]:
        """The cases covered, scene by scene; in a quick run one edit of one made scene each."""
        scenes = (QUICK,) if self.quick else self.scenes or available(self.data)
        count = 1 if self.quick else self.seeds
        jobs = list(itertools.product(scenes, edits or self.edits, range(count)))
        for scene, edit, seed in tqdm(jobs, desc="cases", disable=None):
            yield make_case(scene, edit, seed, self.data)

    def one_edit_each(self) -> Iterator[Case]:
        """The cases of an experiment that is long: one kind of edit per scene, taking turns."""
        for k, scene in enumerate(self.scenes or available(self.data)):
            if not (self.quick and k):
                one = dataclasses.replace(self, scenes=(scene,))
                yield from one.cases([self.edits[k % len(self.edits)]])


def measured(args: Args, name: str, per_case: Iterable[Iterable[Row]]) -> list[Row]:
    """The rows of all cases, kept in OUT/NAME.partial.csv on the way; or those measured before."""
    path, partial = args.out / f"{name}.csv", args.out / f"{name}.partial.csv"
    if args.reprint:
        return read_csv(existing_file(path, expected="rows measured before"))
    if args.quick and path.exists():
        raise InputError(f"{path}: is there; a quick run would replace it, give another --out")
    args.out.mkdir(parents=True, exist_ok=True)
    rows: list[Row] = []
    for more in per_case:
        rows += more
        write_csv(partial, rows)
    if not rows:
        raise InputError("nothing to measure: --scenes, --edits and --seeds leave no case")
    partial.replace(path)
    return rows


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


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Shared:
    """What the looks at one case share: the views, for a method that has to render, and each other.

    Attributes:
        views: The views of the cameras.
        looks: The looks by regime.
    """

    views: list[View]
    looks: dict[str, "Look"]


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Look:
    """What one set of masks makes of a case: all that a method may know.

    Attributes:
        case: The case; its truth is for the metrics, and for the upper bound.
        regime: Name of the mask set.
        observation: Evidence, votes and masks.
        shared: With the other mask sets.
    """

    case: Case
    regime: str
    observation: Observation
    shared: Shared


@dataclasses.dataclass(frozen=True, kw_only=True)
class Answer:
    """What a method says: flagged in a view is where the rendered feature / alpha > level.

    Attributes:
        score: A number per Gaussian, larger where more tampered, shape (N,).
        labels: Tampered Gaussians, shape (N,).
        feature: What is rendered, shape (N,); by default the labels.
        level: Above which a pixel is tampered.
        absolute: Do not divide by alpha.
        gaussians: The scene as a method leaves it that cuts Gaussians; by default the case's.
    """

    score: np.ndarray
    labels: np.ndarray
    feature: np.ndarray | None = None
    level: float = 0.5
    absolute: bool = False
    gaussians: Gaussians | None = None

    @property
    def rendered(self) -> np.ndarray:
        """The feature, or the labels where there is none."""
        return np.asarray(self.labels if self.feature is None else self.feature, np.float32)


Method = Callable[[Look], Answer]


def look(case: Case, masks: Mapping[str, np.ndarray]) -> dict[str, Look]:
    """Lift every set of masks (V, H, W) of a case, the blending weights computed once."""
    gaussians, cameras, names = case.gaussians, case.scene.cameras, list(masks)
    views = [make_view(gaussians, camera) for camera in cameras]
    total = np.zeros((len(cameras), len(gaussians)), np.float32)
    tampered = np.zeros((len(names), *total.shape), np.float32)
    votes = dict.fromkeys(names, no_votes(len(gaussians)))
    for j, (camera, view) in enumerate(zip(cameras, views, strict=True)):
        flagged = np.stack([masks[name][j] for name in names])
        maps = jnp.asarray(np.concatenate([np.ones_like(flagged[:1]), flagged]), jnp.float32)
        sums = np.asarray(accumulate(view, jnp.moveaxis(maps, 0, -1))).T
        total[j], tampered[:, j] = sums[0], np.minimum(sums[1:], sums[:1])
        centers, depths = project_centers(gaussians.means, camera.viewmat, camera.K)
        for name, mask in zip(names, flagged, strict=True):
            votes[name] += tally(cast_votes(centers, depths, mask)[None])
    shared = Shared(views=views, looks={})
    for name, own in zip(names, tampered, strict=True):
        observation = Observation(
            evidence=Evidence(total=total, tampered=own),
            votes=votes[name],
            masks=dict(zip([camera.name for camera in cameras], masks[name], strict=True)),
            detections={},
        )
        shared.looks[name] = Look(case=case, regime=name, observation=observation, shared=shared)
    return shared.looks


def labelled(labels: np.ndarray) -> Answer:
    """The answer of a method that only labels."""
    labels = np.asarray(labels)
    return Answer(score=labels.astype(np.float32), labels=labels)


def checker(config: MethodConfig, *, own_rule: bool = False) -> Method:
    """GS-Checker under a configuration; judged by its labels, or by the score that it renders."""

    def method(look: Look) -> Answer:
        seeded = dataclasses.replace(config, seed=look.case.seed)
        found = find(look.case.gaussians, look.case.scene.cameras, look.observation, seeded)
        rendered = {"feature": found.tamper, "level": config.threshold} if own_rule else {}
        return Answer(score=found.attribute, labels=found.labels, **rendered)

    return method


def without_3d(config: MethodConfig) -> MethodConfig:
    """The configuration with no 3D contrastive loss."""
    return dataclasses.replace(config, loop=dataclasses.replace(config.loop, gamma=0.0))


def _sa3d(look: Look) -> Answer:
    r = sa3d(look.observation.evidence)
    return Answer(score=r, labels=r > 0)


def _sa3d_own(look: Look) -> Answer:
    r = sa3d(look.observation.evidence)
    return Answer(score=r, labels=r > 0, feature=r, level=SA3D_LEVEL, absolute=True)


def _sa3d_gate(look: Look) -> Answer:
    r = _gated(look.shared)[look.regime]
    return Answer(score=r, labels=r > 0)


def sa3d_gate_alone(look: Look) -> Answer:
    """SA3D with its gate, nothing remembered: what it costs by itself."""
    r = _gated.__wrapped__(look.shared)[look.regime]
    return Answer(score=r, labels=r > 0)


@functools.lru_cache(maxsize=1)
def _gated(shared: Shared) -> dict[str, np.ndarray]:
    """Scores of SA3D with its gate, all regimes at once: it renders before every step."""
    observations = [look.observation for look in shared.looks.values()]
    masks = [list(observation.masks.values()) for observation in observations]

    def overlap(index: int, r: np.ndarray) -> np.ndarray:
        rendered = np.asarray(composite(shared.views[index], jnp.asarray(r.T)))
        return np.array([iou(rendered[..., k], own[index]) for k, own in enumerate(masks)])

    tampered = np.stack([observation.evidence.tampered for observation in observations])
    evidence = Evidence(total=observations[0].evidence.total, tampered=tampered)
    return dict(zip(shared.looks, sa3d(evidence, overlap=overlap), strict=True))


def _flashsplat(look: Look, *, gamma: float) -> Answer:
    evidence = look.observation.evidence
    total, tampered = (np.sum(part, axis=0) for part in (evidence.total, evidence.tampered))
    share = tampered / np.where(total > 0, total, 1)
    return Answer(score=share, labels=flashsplat(evidence, gamma=gamma))


def _share_of_votes(look: Look) -> np.ndarray:
    votes = look.observation.votes
    cast = np.asarray(votes.tampered + votes.authentic)
    return np.asarray(votes.tampered) / np.maximum(cast, 1)


def _voted(rule: Callable[..., np.ndarray]) -> Method:
    def method(look: Look) -> Answer:
        return Answer(score=_share_of_votes(look), labels=rule(look.observation.votes))

    return method


def sagd(look: Look) -> Answer:
    """SAGD with its boundary decomposition, folded over the views: too slow for every regime."""
    case, labels = look.case, sagd_vote(look.observation.votes)
    gaussians, masks = case.gaussians, look.observation.masks
    for camera in case.scene.cameras if labels.any() else []:
        gaussians = sagd_boundary(gaussians, labels, camera, masks[camera.name])
    return Answer(score=_share_of_votes(look), labels=labels, gaussians=gaussians)


ALL_METHODS: Mapping[str, Method] = {
    "inverse projection": _voted(inverse),
    "mode vote": _voted(mode_vote),
    "SAGD vote": _voted(sagd_vote),
    "SA3D": _sa3d,
    "SA3D, own rule": _sa3d_own,
    "SA3D, gate": _sa3d_gate,
    "FlashSplat": functools.partial(_flashsplat, gamma=0.0),
    "FlashSplat, gamma 0.4": functools.partial(_flashsplat, gamma=0.4),
    "GS-Checker official": checker(METHODS["official"]),
    "GS-Checker official, own rule": checker(METHODS["official"], own_rule=True),
    "GS-Checker official, no 3D loss": checker(without_3d(METHODS["official"])),
    "GS-Checker paper": checker(METHODS["paper"]),
}
"""Every method of the tables, judged by its labels; by what it renders itself where it says so."""


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
