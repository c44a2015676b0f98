"""Train what reads the cues of the Gaussians, and for every scene a model that never saw it.

    python experiments/train_cues.py [--keep .cues] [--out gsc_jax/cues.npz]

Edits of all scenes with seeds that no table uses, exported so that host and object have the same
digits. A network is trained for every set of scenes that leaves one or two out. Those that leave
out one are averaged to the model that comes with the package; those that leave out a scene and
another one are averaged to the model of the first, by which the tables judge it. What a network
says of the scene that it alone was not trained on calibrates the average.
"""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax
from cases import CUT, DATA, available, donor_name, edit_scene, load_scene
from runner import start
from tqdm import tqdm

from gsc_jax.benchmark.export import exported
from gsc_jax.benchmark.tamper import EDITS, Edit
from gsc_jax.cues import CLIP, cues
from gsc_jax.errors import InputError
from gsc_jax.io.files import atomic
from gsc_jax.native import (
    Layers,
    Model,
    as_arrays,
    network,
    opinions,
    worst_part,
)
from gsc_jax.scene import Gaussians

FIRST_SEED = 10
WHOLE = 2
"""Seeds of whole scenes, which take long."""
MOST = 4000, 8000
"""Rows of a case that are learned from, tampered and authentic."""
SHARE = 0.3
"""Of a batch that is tampered."""
HIDDEN = (64, 32)
STEPS, BATCH = 1000, 2048
RATE, DECAY, DROPOUT, NOISE = 2e-3, 1e-2, 0.2, 0.3


@dataclasses.dataclass(frozen=True, kw_only=True)
class Args:
    """What to train on.

    Attributes:
        seeds: How many seeds per scene and edit, from 10 on.
        data: The real scenes.
        keep: Folder for what is worked out on the way, so that a second run is quick, and for the
            models that leave out a scene. Remove it after a change of the cues.
        out: The model that comes with the package.
    """

    seeds: int = 6
    data: Path = DATA
    keep: Path = Path(".cues")
    out: Path = Path("gsc_jax/cues.npz")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Examples:
    """Rows of one case: cues (M, F) float16, whether tampered, and the share that truly is.

    Its scenes are the one that was edited, and the one that a pasted object was cut from.
    """

    scene: str
    scenes: frozenset[str]
    values: np.ndarray
    labels: np.ndarray
    share: float
    names: tuple[str, ...]


def saved(gaussians: Gaussians, seed: int) -> Gaussians:
    """The scene as it is learned from: every other seed with 8 bits, and never as it was."""
    return exported(gaussians, as_=("8 bits", "float")[seed % 2], seed=seed)


def examples(scene: str, edit: Edit, seed: int, data: Path, keep: Path) -> Examples:
    """Describe a sample of the rows of a case, or read what was described before."""
    path = keep / f"{scene}-{edit}-{seed}.npz"
    if not path.exists():
        case = edit_scene(scene, edit, seed, data)
        rng = np.random.default_rng(seed)
        described = cues(saved(case.gaussians, seed))
        groups = [np.flatnonzero(case.labels), np.flatnonzero(~case.labels)]
        rows = np.concatenate([rng.permutation(g)[:m] for g, m in zip(groups, MOST, strict=True)])
        stored = {
            "values": described.values[rows].astype(np.float16),
            "labels": case.labels[rows],
            "share": case.labels.mean(),
            "names": np.array(described.names),
        }
        with atomic(path) as temporary, temporary.open("wb") as file:
            np.savez(file, **stored)
    return read_examples(path)


def read_examples(path: Path) -> Examples:
    """What `examples` described before; the file is named after scene, edit and seed."""
    scene, edit, seed = path.stem.split("-")
    with np.load(path) as stored:
        names = tuple(map(str, stored["names"]))
        values, labels = stored["values"], stored["labels"]
        pasted = donor_name(scene, int(seed)) if edit == "incorporation" else ""
        return Examples(
            scene=scene,
            scenes=frozenset({scene, pasted.removeprefix(CUT)}),
            values=values,
            labels=labels,
            share=float(stored["share"]),
            names=names,
        )


def trained(cases: Sequence[Examples], seed: int) -> Layers:
    """A network that tells tampered rows of these cases from authentic ones.

    Args:
        cases: Each counts alike, however many rows it has.
        seed: Of the start, the batches and the noise.

    Returns:
        Its layers.
    """
    values = np.concatenate([case.values for case in cases])
    labels = np.concatenate([case.labels for case in cases])
    weights = np.concatenate(
        [
            np.where(case.labels, SHARE / case.labels.sum(), (1 - SHARE) / (~case.labels).sum())
            for case in cases
        ]
    )
    along, rng = np.cumsum(weights) / weights.sum(), np.random.default_rng(seed)
    layers = _started(rng, (values.shape[1], *HIDDEN, 1))
    optimiser = optax.adamw(optax.cosine_decay_schedule(RATE, STEPS), weight_decay=DECAY)
    state = optimiser.init(layers)

    @jax.jit
    def step(layers, state, values, labels, key):
        def loss(layers):
            return optax.sigmoid_binary_cross_entropy(shaken(layers, values, key), labels).mean()

        updates, state = optimiser.update(jax.grad(loss)(layers), state, layers)
        return optax.apply_updates(layers, updates), state

    for k in range(STEPS):
        rows = np.minimum(np.searchsorted(along, rng.random(BATCH)), len(labels) - 1)
        batch = values[rows].astype(np.float32), labels[rows].astype(np.float32)
        layers, state = step(
            layers, state, *batch, jax.random.key(seed * STEPS + k, impl="unsafe_rbg")
        )
    return jax.tree.map(np.asarray, layers)


def _started(rng: np.random.Generator, sizes: Sequence[int]) -> Layers:
    return tuple(
        (rng.normal(0, m**-0.5, (m, n)).astype(np.float32), np.zeros(n, np.float32))
        for m, n in itertools.pairwise(sizes)
    )


def shaken(layers: Layers, values: jax.Array, key: jax.Array) -> jax.Array:
    """Raw log odds under noise and dropout, so that no single cue is relied upon, (N,)."""
    keys = jax.random.split(key, len(layers) + 1)
    values = jnp.clip(values + NOISE * jax.random.normal(keys[-1], values.shape), -CLIP, CLIP)
    for k, (weights, bias) in enumerate(layers):
        rate = DROPOUT / 2 if k == 0 else DROPOUT
        kept = jax.random.bernoulli(keys[k], 1 - rate, values.shape)
        values = jnp.where(kept, values / (1 - rate), 0.0) @ weights + bias[None]
        if k < len(layers) - 1:
            values = jax.nn.gelu(values)
    return values[:, 0]


def networks_of(cases: Sequence[Examples], scenes: Sequence[str]) -> dict[frozenset[str], Layers]:
    """A network for every one or two scenes that are left out, by these scenes."""
    left_out = [*itertools.combinations(scenes, 1), *itertools.combinations(scenes, 2)]
    return {
        frozenset(without): trained([c for c in cases if not c.scenes & set(without)], seed=k)
        for k, without in enumerate(tqdm(left_out, desc="networks", disable=None))
    }


@dataclasses.dataclass(frozen=True, kw_only=True)
class Fold:
    """A model that never saw a scene, or the one that saw all.

    Attributes:
        heldout: The scene, None of the model that saw all.
        networks: By another scene, the network that saw neither.
        model: All of them, calibrated.
    """

    heldout: str | None
    networks: dict[str, Layers]
    model: Model

    def without(self, scene: str) -> Model:
        """The calibrated model that is judged on one more scene, which it did not see."""
        return dataclasses.replace(self.model, networks=(self.networks[scene],))


def fold_of(
    heldout: str | None,
    cases: Sequence[Examples],
    networks: Mapping[frozenset[str], Layers],
) -> Fold:
    """Average and calibrate the networks that did not see a scene."""
    cases = [case for case in cases if heldout not in case.scenes]
    own = {
        scene: networks[frozenset({scene, heldout} - {None})]
        for scene in dict.fromkeys(case.scene for case in cases)
    }
    raw = [np.asarray(network(own[c.scene], jnp.asarray(c.values, jnp.float32))) for c in cases]
    weights = [
        np.where(c.labels, c.share / c.labels.sum(), (1 - c.share) / (~c.labels).sum())
        for c in cases
    ]
    labels = np.concatenate([case.labels for case in cases])
    share = float(np.mean([case.share for case in cases]))
    model = Model(
        networks=tuple(own.values()),
        names=cases[0].names,
        calibration=logistic(np.concatenate(raw), labels, np.concatenate(weights)),
        base=float(np.log(share / (1 - share))),
        scene=(1.0, 0.0),
    )
    return Fold(heldout=heldout, networks=own, model=model)


def logistic(
    values: np.ndarray, labels: np.ndarray, weights: np.ndarray, damping: float = 1e-4
) -> tuple[float, float]:
    """Factor and shift that make values the log odds of the labels."""
    from scipy.optimize import minimize

    def loss(line: np.ndarray) -> float:
        odds = line[0] * values + line[1]
        losses = np.logaddexp(0, np.where(labels, -odds, odds))
        return float(np.average(losses, weights=weights) + damping * line[0] ** 2)

    factor, shift = minimize(loss, np.array([1.0, 0.0]), method="Nelder-Mead").x
    return float(factor), float(shift)


def suspicions(scene: str, gaussians: Gaussians, folds: Sequence[Fold]) -> dict[str | None, float]:
    """How suspicious the worst part of a whole scene is to those that did not see it, by fold."""
    described = cues(gaussians)
    return {
        fold.heldout: worst_part(
            opinions(described, fold.without(scene)), np.asarray(gaussians.means)
        )
        for fold in folds
        if fold.heldout != scene
    }


def scene_lines(args: Args, scenes: Sequence[str], folds: Sequence[Fold]) -> list[Fold]:
    """The folds with what they need to call a whole scene tampered with."""
    kinds: tuple[Edit | None, ...] = (*EDITS, None)
    jobs: list[tuple[str, Edit | None, int]] = [
        (scene, edit, seed)
        for scene in scenes
        for edit in kinds
        for seed in range(FIRST_SEED, FIRST_SEED + WHOLE)
    ]
    told: list[tuple[bool, dict[str | None, float]]] = []
    for scene, edit, seed in tqdm(jobs, desc="whole scenes", disable=None):
        if edit:
            gaussians = edit_scene(scene, edit, seed, args.data).gaussians
        else:
            gaussians = load_scene(scene, args.data).gaussians
        told.append((bool(edit), suspicions(scene, saved(gaussians, seed), folds)))
    return [with_line(fold, told) for fold in folds]


def with_line(fold: Fold, told: Sequence[tuple[bool, Mapping[str | None, float]]]) -> Fold:
    """The fold whose model was fitted to what it said of whole scenes."""
    mine = [(edited, worst[fold.heldout]) for edited, worst in told if fold.heldout in worst]
    labels, values = np.array([e for e, _ in mine]), np.array([v for _, v in mine])
    # Half of the scenes that are looked at are taken to be edited.
    weights = np.where(labels, 1 / labels.sum(), 1 / (~labels).sum())
    line = logistic(values, labels, weights, damping=1e-2)
    return dataclasses.replace(fold, model=dataclasses.replace(fold.model, scene=line))


def save(path: Path, model: Model) -> None:
    """Store a model as `shipped_model` reads it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **as_arrays(model))


def main(args: Args) -> None:
    """Describe the cases, train the networks, and store the models."""
    args.keep.mkdir(parents=True, exist_ok=True)
    scenes = available(args.data)
    if len(scenes) < 3:
        raise InputError(
            f"{args.data}: holds no scenes, and with {len(scenes)} there is none to train on when "
            "two are left out; get the real ones, or use the model that comes with the package"
        )
    jobs = list(itertools.product(scenes, EDITS, range(FIRST_SEED, FIRST_SEED + args.seeds)))
    cases = [examples(*job, args.data, args.keep) for job in tqdm(jobs, desc="cases", disable=None)]
    networks = networks_of(cases, scenes)
    folds = [fold_of(heldout, cases, networks) for heldout in (None, *scenes)]
    for fold in scene_lines(args, scenes, folds):
        save(args.keep / f"without-{fold.heldout}.npz" if fold.heldout else args.out, fold.model)


if __name__ == "__main__":
    start(main, __doc__)
