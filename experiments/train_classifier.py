"""Train and calibrate the classifier of Gaussians, and for every scene one that never saw it.

    python experiments/train_classifier.py [--keep .cues] [--out gsc_jax/forensics/classifier.npz]

The classifier of the package is trained on all scenes; the tables are measured with those that
leave out a scene. A classifier is an ensemble of networks. It is calibrated on whole scenes, each
by a network that was trained without that scene, too, and is slightly less sure than the ensemble.
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
from cases import DATA, available, edit_scene, load_scene
from classifier_examples import FIRST_SEED, Examples, make_examples, requantised, scenes_in
from runner import start
from scipy.optimize import minimize
from tqdm import tqdm

from gsc_jax.benchmark.tamper import EDITS, Edit
from gsc_jax.forensics.calibration import peak_log_odds, scene_calibration
from gsc_jax.forensics.classifier import Classifier, Layers, as_arrays, smoothed_log_odds
from gsc_jax.forensics.features import MAX_DEVIATION, compute_features
from gsc_jax.io.files import atomic
from gsc_jax.scene import InputError

SEEDS = {"incorporation": 18, "modification": 36, "removal": 12}
"""Number of seeds per kind of edit: more for edits that are harder to detect."""
CALIBRATION_SEEDS = 2
"""Seeds of the whole scenes for calibration."""
SAMPLE = 20_000
"""Gaussians of a whole scene used for calibration."""
MEMBERS = 3
"""Networks of an ensemble."""
TAMPERED_SHARE = 0.3
"""Share of a batch that is tampered."""
HIDDEN = (64, 32)
"""Units of the hidden layers."""
STEPS, BATCH = 1000, 2048
LEARNING_RATE, WEIGHT_DECAY, DROPOUT, NOISE = 2e-3, 1e-2, 0.2, 0.3

Networks = tuple[Layers, ...]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Args:
    """Arguments of the training.

    Attributes:
        share: Share of the seeds of each kind of edit, for a smaller run.
        data: The real scenes.
        keep: Folder of the features, for a second run, and of the classifiers that leave out a
            scene. Remove it after a change of the features.
        out: File of the classifier of the package.
    """

    share: float = 1.0
    data: Path = DATA
    keep: Path = Path(".cues")
    out: Path = Path("gsc_jax/forensics/classifier.npz")


def train_network(cases: Sequence[Examples], seed: int) -> Layers:
    """Train one network; each kind of edit has equal weight, and within it each case."""
    values = np.concatenate([case.values for case in cases])
    labels = np.concatenate([case.labels for case in cases])
    weights, rng = _row_weights(cases), np.random.default_rng(seed)
    cumulative = np.cumsum(weights) / weights.sum()
    layers = _initial_layers(rng, (values.shape[1], *HIDDEN, 1))
    schedule = optax.cosine_decay_schedule(LEARNING_RATE, STEPS)
    optimiser = optax.adamw(schedule, weight_decay=WEIGHT_DECAY)
    state = optimiser.init(layers)

    @jax.jit
    def step(layers, state, values, labels, key):
        def loss(layers):
            log_odds = noisy_log_odds(layers, values, key)
            return optax.sigmoid_binary_cross_entropy(log_odds, labels).mean()

        updates, state = optimiser.update(jax.grad(loss)(layers), state, layers)
        return optax.apply_updates(layers, updates), state

    for k in range(STEPS):
        rows = np.minimum(np.searchsorted(cumulative, rng.random(BATCH)), len(labels) - 1)
        key = jax.random.key(seed * STEPS + k, impl="unsafe_rbg")
        batch = values[rows].astype(np.float32), labels[rows].astype(np.float32)
        layers, state = step(layers, state, *batch, key)
    return jax.tree.map(np.asarray, layers)


def _row_weights(cases: Sequence[Examples]) -> np.ndarray:
    share, weights = TAMPERED_SHARE, balanced_weights([case.edit for case in cases])
    return np.concatenate(
        [
            weight * np.where(c.labels, share / c.labels.sum(), (1 - share) / (~c.labels).sum())
            for c, weight in zip(cases, weights, strict=True)
        ]
    )


def balanced_weights(kinds: Sequence[str]) -> np.ndarray:
    """Weights of cases with equal sums for all kinds; their total is 1."""
    counts = Counter(kinds)
    return np.array([1 / (len(counts) * counts[kind]) for kind in kinds])


def _initial_layers(rng: np.random.Generator, sizes: Sequence[int]) -> Layers:
    return tuple(
        (rng.normal(0, m**-0.5, (m, n)).astype(np.float32), np.zeros(n, np.float32))
        for m, n in itertools.pairwise(sizes)
    )


def noisy_log_odds(layers: Layers, values: jax.Array, key: jax.Array) -> jax.Array:
    """Output of a network with noise and dropout, so that it relies on no single feature, (N,)."""
    keys = jax.random.split(key, len(layers) + 1)
    noise = NOISE * jax.random.normal(keys[-1], values.shape)
    values = jnp.clip(values + noise, -MAX_DEVIATION, MAX_DEVIATION)
    for k, (weights, bias) in enumerate(layers):
        rate = DROPOUT / 2 if k == 0 else DROPOUT
        kept = jax.random.bernoulli(keys[k], 1 - rate, values.shape)
        values = jnp.where(kept, values / (1 - rate), 0.0) @ weights + bias[None]
        if k < len(layers) - 1:
            values = jax.nn.gelu(values)
    return values[:, 0]


def train_networks(
    cases: Sequence[Examples], scenes: Sequence[str]
) -> dict[frozenset[str], Networks]:
    """Train networks without each set of no, one or two scenes; the latter are for calibration."""
    left_out = [frozenset(some) for k in range(3) for some in itertools.combinations(scenes, k)]
    jobs = [some for some in left_out for _ in range(MEMBERS if len(some) < 2 else 1)]
    networks: dict[frozenset[str], Networks] = {}
    for seed, some in enumerate(tqdm(jobs, desc="networks", disable=None)):
        own = [case for case in cases if not case.scenes & some]
        networks[some] = (*networks.get(some, ()), train_network(own, seed=seed))
    return networks


@dataclasses.dataclass(frozen=True, kw_only=True)
class Fold:
    """A classifier that never saw the scene `heldout`, or that saw all with None.

    The network `others[scene]` was trained without that scene, too, for calibration.
    """

    heldout: str | None
    classifier: Classifier
    others: dict[str, Layers]


def make_fold(
    heldout: str | None, cases: Sequence[Examples], networks: Mapping[frozenset[str], Networks]
) -> Fold:
    """Fold with a classifier that is not calibrated yet."""
    cases = [case for case in cases if heldout not in case.scenes]
    weights = balanced_weights([case.edit for case in cases])
    share = float(weights @ [case.share for case in cases])
    without = frozenset([heldout] if heldout else [])
    classifier = Classifier(
        networks=networks[without],
        names=cases[0].names,
        calibration=(1.0, 0.0),
        base=float(np.log(share / (1 - share))),
        scene=(1.0, 0.0),
    )
    others = {scene: networks[without | {scene}][0] for scene in {case.scene for case in cases}}
    return Fold(heldout=heldout, classifier=classifier, others=others)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SceneOutput:
    """Smoothed raw log odds and labels (M,) of a sample of a scene, and its peak log odds."""

    edit: Edit | None
    raw: np.ndarray
    labels: np.ndarray
    peak: float


def scene_outputs(
    scene: str, edit: Edit | None, seed: int, args: Args, folds: Sequence[Fold]
) -> dict[str | None, SceneOutput]:
    """Outputs for a whole scene by the held-out scene of each fold that did not see it."""
    gaussians = load_scene(scene, args.data).gaussians
    labels = np.zeros(len(gaussians), bool)
    if edit:
        edited = edit_scene(scene, edit, seed, args.data)
        gaussians, labels = edited.gaussians, edited.labels
    features = compute_features(requantised(gaussians, seed))
    rows = np.random.default_rng(seed).permutation(len(labels))[:SAMPLE]
    outputs = {}
    for fold in folds:
        if fold.heldout not in scenes_in(scene, edit, seed):
            one = dataclasses.replace(fold.classifier, networks=(fold.others[scene],))
            raw = smoothed_log_odds(features, one)
            peak = peak_log_odds(raw, np.asarray(gaussians.means))
            outputs[fold.heldout] = SceneOutput(
                edit=edit, raw=raw[rows], labels=labels[rows], peak=peak
            )
    return outputs


def logistic_fit(
    values: np.ndarray, labels: np.ndarray, weights: np.ndarray, damping: float = 1e-4
) -> tuple[float, float]:
    """Factor and shift from values to log odds of the labels, by weighted logistic regression."""

    def loss(line: np.ndarray) -> float:
        log_odds = line[0] * values + line[1]
        losses = np.logaddexp(0, np.where(labels, -log_odds, log_odds))
        return float(np.average(losses, weights=weights) + damping * line[0] ** 2)

    factor, shift = minimize(loss, np.array([1.0, 0.0]), method="Nelder-Mead").x
    return float(factor), float(shift)


def calibrated(classifier: Classifier, outputs: Sequence[SceneOutput]) -> Classifier:
    """The classifier calibrated for Gaussians of edited scenes, and for scenes."""
    edited = [one for one in outputs if one.edit]
    weights = balanced_weights([str(one.edit) for one in edited])
    per_row = [np.full(len(o.raw), w / len(o.raw)) for o, w in zip(edited, weights, strict=True)]
    raw, labels = (np.concatenate([getattr(o, name) for o in edited]) for name in ("raw", "labels"))
    line = logistic_fit(raw, labels, np.concatenate(per_row))
    classifier = dataclasses.replace(classifier, calibration=line)
    lines = [scene_calibration(one.raw, classifier) for one in outputs]
    peaks = [factor * o.peak + shift for (factor, shift), o in zip(lines, outputs, strict=True)]
    is_edited = np.array([one.edit is not None for one in outputs])
    # The prior probability that a scene was edited is one half.
    weights = np.where(is_edited, 1 / is_edited.sum(), 1 / (~is_edited).sum())
    scene = logistic_fit(np.array(peaks), is_edited, weights, damping=1e-2)
    return dataclasses.replace(classifier, scene=scene)


def save(path: Path, classifier: Classifier) -> None:
    """Store a classifier in the format of `from_arrays`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **as_arrays(classifier))


def main(args: Args) -> None:
    """Compute the features, train the networks, calibrate and store the classifiers."""
    args.keep.mkdir(parents=True, exist_ok=True)
    scenes = available(args.data)
    if len(scenes) < 3:
        raise InputError(
            f"{args.data}: no scenes; leaving out two of {len(scenes)} leaves none to train on. "
            "Get the real scenes, or use the classifier that comes with the package"
        )
    jobs: list[tuple[str, Edit, int]] = [
        (scene, edit, FIRST_SEED + k)
        for scene, edit in itertools.product(scenes, EDITS)
        for k in range(max(1, round(args.share * SEEDS[edit])))
    ]
    progress = tqdm(jobs, desc="cases", disable=None)
    cases = [make_examples(*job, args.data, args.keep) for job in progress]
    networks = train_networks(cases, scenes)
    folds = [make_fold(heldout, cases, networks) for heldout in (None, *scenes)]
    seeds = range(FIRST_SEED, FIRST_SEED + CALIBRATION_SEEDS)
    whole = list(itertools.product(scenes, (*EDITS, None), seeds))
    progress = tqdm(whole, desc="whole scenes", disable=None)
    outputs = [scene_outputs(*job, args, folds) for job in progress]
    for fold in folds:
        own = [by[fold.heldout] for by in outputs if fold.heldout in by]
        path = args.keep / f"without-{fold.heldout}.npz" if fold.heldout else args.out
        save(path, calibrated(fold.classifier, own))


if __name__ == "__main__":
    start(main, __doc__)
