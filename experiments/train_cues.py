"""Train what reads the cues of the Gaussians, and for every scene a model that never saw it.

    python experiments/train_cues.py [--keep .cues] [--out gsc_jax/forensics/classifier.npz]

Edits of all scenes with other seeds than those of the tables, exported so that host and object have
the same digits. The model that comes with the package learned from all scenes; for every scene
there is one that learned from the others, by which the tables judge it. A model is the mean of a
few networks. It is calibrated by what one that left out a scene more says of that scene, which
stands in for the mean and is a little less sure than it.
"""

import dataclasses
import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import optax
from cases import CUT, DATA, available, donor_name, edit_scene, load_scene
from export import exported
from runner import start
from tqdm import tqdm

from gsc_jax.benchmark.tamper import EDITS, Edit
from gsc_jax.forensics.classifier import (
    Layers,
    Model,
    as_arrays,
    calibration_in,
    judged,
    settled,
    worst_part,
)
from gsc_jax.forensics.features import CLIP, cues
from gsc_jax.io.files import atomic
from gsc_jax.scene import Gaussians, InputError

FIRST_SEED = 10
SEEDS = {"incorporation": 18, "modification": 36, "removal": 12}
"""How many of each kind of edit: the less it shows, the more there is to learn."""
WHOLE = 2
"""Seeds of whole scenes, by which the models are calibrated."""
MEMBERS = 3
"""Networks of a model, which differ by chance; their mean is more reliable than any of them."""
SAMPLE = 20_000
"""Rows of a whole scene that do so."""
MOST = 4000, 8000
"""Rows of a case that are learned from, tampered and authentic."""
SHARE = 0.3
"""Of a batch that is tampered."""
HIDDEN = (64, 32)
STEPS, BATCH = 1000, 2048
RATE, DECAY, DROPOUT, NOISE = 2e-3, 1e-2, 0.2, 0.3

Networks = tuple[Layers, ...]
"""The mean of their outputs counts."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Args:
    """What to train on.

    Attributes:
        share: Of the seeds of each kind of edit, for a smaller run.
        data: The real scenes.
        keep: Folder for what is worked out on the way, so that a second run is quick, and for the
            models that leave out a scene. Remove it after a change of the cues.
        out: The model that comes with the package.
    """

    share: float = 1.0
    data: Path = DATA
    keep: Path = Path(".cues")
    out: Path = Path("gsc_jax/forensics/classifier.npz")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Examples:
    """Rows of one case: cues (M, F) float16, whether tampered, and the share that truly is.

    Its scenes are the one that was edited, and the one that a pasted object was cut from.
    """

    scene: str
    edit: str
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
        return Examples(
            scene=scene,
            edit=edit,
            scenes=scenes_in(scene, edit, int(seed)),
            values=stored["values"],
            labels=stored["labels"],
            share=float(stored["share"]),
            names=tuple(map(str, stored["names"])),
        )


def scenes_in(scene: str, edit: str | None, seed: int) -> frozenset[str]:
    """The scene of a case, and the one that a pasted object was cut from."""
    pasted = donor_name(scene, seed) if edit == "incorporation" else ""
    return frozenset({scene, pasted.removeprefix(CUT)} if pasted.startswith(CUT) else {scene})


def trained(cases: Sequence[Examples], seed: int) -> Layers:
    """A network that tells tampered rows of these cases from authentic ones.

    Args:
        cases: Each kind of edit counts alike, and in it each case, however many rows it has.
        seed: Of the start, the batches and the noise.

    Returns:
        Its layers.
    """
    values = np.concatenate([case.values for case in cases])
    labels = np.concatenate([case.labels for case in cases])
    weights = np.concatenate(
        [
            weight * np.where(c.labels, SHARE / c.labels.sum(), (1 - SHARE) / (~c.labels).sum())
            for c, weight in zip(cases, balanced([c.edit for c in cases]), strict=True)
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


def balanced(kinds: Sequence[str]) -> np.ndarray:
    """Weights of cases under which each kind counts alike; their sum is 1."""
    counts = Counter(kinds)
    return np.array([1 / (len(counts) * counts[kind]) for kind in kinds])


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


def networks_of(cases: Sequence[Examples], scenes: Sequence[str]) -> dict[frozenset[str], Networks]:
    """Networks for every set of scenes that is left out: none, one, or, to calibrate, two."""
    left_out = [frozenset(some) for k in range(3) for some in itertools.combinations(scenes, k)]
    jobs = [(some, k) for some in left_out for k in range(MEMBERS if len(some) < 2 else 1)]
    networks: dict[frozenset[str], Networks] = {}
    for seed, (some, _) in enumerate(tqdm(jobs, desc="networks", disable=None)):
        one = trained([case for case in cases if not case.scenes & some], seed=seed)
        networks[some] = (*networks.get(some, ()), one)
    return networks


@dataclasses.dataclass(frozen=True, kw_only=True)
class Fold:
    """A model that never saw a scene, or the one that saw all.

    Attributes:
        heldout: The scene, None of the model that saw all.
        model: What is judged.
        others: By another scene, a network that saw neither: by these the model is calibrated.
    """

    heldout: str | None
    model: Model
    others: dict[str, Layers]


def fold_of(
    heldout: str | None,
    cases: Sequence[Examples],
    networks: Mapping[frozenset[str], Networks],
) -> Fold:
    """The networks that did not see a scene; what they say is not calibrated yet."""
    cases = [case for case in cases if heldout not in case.scenes]
    share = float(balanced([case.edit for case in cases]) @ [case.share for case in cases])
    without = frozenset([heldout] if heldout else [])
    model = Model(
        networks=networks[without],
        names=cases[0].names,
        calibration=(1.0, 0.0),
        base=float(np.log(share / (1 - share))),
        scene=(1.0, 0.0),
    )
    others = {scene: networks[without | {scene}][0] for scene in {case.scene for case in cases}}
    return Fold(heldout=heldout, model=model, others=others)


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


@dataclasses.dataclass(frozen=True, kw_only=True)
class Heard:
    """What a network said of a whole scene that it was not trained on.

    Attributes:
        edit: Kind of the edit, or none.
        raw: Settled raw log odds of some Gaussians, shape (M,).
        labels: Which of them are tampered, shape (M,) bool.
        worst: Mean raw log odds of the most suspicious part of the scene.
    """

    edit: Edit | None
    raw: np.ndarray
    labels: np.ndarray
    worst: float


def hear(
    scene: str, edit: Edit | None, seed: int, args: Args, folds: Sequence[Fold]
) -> dict[str | None, Heard]:
    """What networks that did not see a whole scene say of it, by the scene their fold holds out."""
    gaussians = load_scene(scene, args.data).gaussians
    labels, rng = np.zeros(len(gaussians), bool), np.random.default_rng(seed)
    if edit:
        edited = edit_scene(scene, edit, seed, args.data)
        gaussians, labels = edited.gaussians, edited.labels
    described = cues(saved(gaussians, seed))
    rows = rng.permutation(len(labels))[:SAMPLE]
    heard, seen = {}, scenes_in(scene, edit, seed)
    for fold in folds:
        if fold.heldout not in seen:
            model = dataclasses.replace(fold.model, networks=(fold.others[scene],))
            raw = settled(judged(described, model), described)
            worst = worst_part(raw, np.asarray(gaussians.means))
            heard[fold.heldout] = Heard(edit=edit, raw=raw[rows], labels=labels[rows], worst=worst)
    return heard


def calibrated(fold: Fold, heard: Sequence[Heard]) -> Fold:
    """The fold with what makes log odds of a Gaussian, and those of a scene, of what it says."""
    edited = [one for one in heard if one.edit]
    weights = balanced([str(one.edit) for one in edited])
    line = logistic(
        np.concatenate([one.raw for one in edited]),
        np.concatenate([one.labels for one in edited]),
        np.concatenate(
            [np.full(len(o.raw), w / len(o.raw)) for o, w in zip(edited, weights, strict=True)]
        ),
    )
    model = dataclasses.replace(fold.model, calibration=line)
    lines = [calibration_in(one.raw, model) for one in heard]
    worst = [factor * o.worst + shift for (factor, shift), o in zip(lines, heard, strict=True)]
    labels = np.array([one.edit is not None for one in heard])
    # Half of the scenes that are looked at are taken to be edited.
    weights = np.where(labels, 1 / labels.sum(), 1 / (~labels).sum())
    scene = logistic(np.array(worst), labels, weights, damping=1e-2)
    return dataclasses.replace(fold, model=dataclasses.replace(model, scene=scene))


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
    jobs: list[tuple[str, Edit, int]] = [
        (scene, edit, FIRST_SEED + k)
        for scene, edit in itertools.product(scenes, EDITS)
        for k in range(max(1, round(args.share * SEEDS[edit])))
    ]
    cases = [examples(*job, args.data, args.keep) for job in tqdm(jobs, desc="cases", disable=None)]
    networks = networks_of(cases, scenes)
    folds = [fold_of(heldout, cases, networks) for heldout in (None, *scenes)]
    whole = list(itertools.product(scenes, (*EDITS, None), range(FIRST_SEED, FIRST_SEED + WHOLE)))
    told = [hear(*job, args, folds) for job in tqdm(whole, desc="whole scenes", disable=None)]
    for fold in folds:
        model = calibrated(fold, [by[fold.heldout] for by in told if fold.heldout in by]).model
        save(args.keep / f"without-{fold.heldout}.npz" if fold.heldout else args.out, model)


if __name__ == "__main__":
    start(main, __doc__)
