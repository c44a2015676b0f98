"""Train and calibrate the classifier of Gaussians, and for every scene one that never saw it.

    python experiments/captures.py
    python experiments/train_classifier.py [--keep .cues] [--out gsc_jax/forensics/classifier.npz]

It learns of the cases of bank.py. The classifier of the package is trained on all sources; the
tables are measured with those that leave out a scene and its captures. A classifier is an ensemble
of networks. It is calibrated on whole cases, each scored by one network that was trained without
its host, and is slightly less sure than the ensemble. A first fit chooses the weight of the
novelty, a second one, with the discriminant, calibrates.
"""

import dataclasses
import itertools
import math
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from bank import BANK, NO_EDIT, BankCase, Kind, hosts, source_of, training_seeds
from cases import DATA, available
from classifier_examples import Examples, digest, kept, make_examples, stored_case
from runner import start
from scipy.optimize import minimize
from scipy.special import expit
from tqdm import tqdm

from gsc_jax.benchmark.tamper import EDITS
from gsc_jax.forensics.calibration import calibrate
from gsc_jax.forensics.classifier import (
    Classifier,
    Layers,
    smoothed_log_odds,
    with_places,
)
from gsc_jax.forensics.features import MAX_DEVIATION, compute_features, with_finite_scales
from gsc_jax.forensics.novelty import novelty
from gsc_jax.forensics.places import Places, find_places
from gsc_jax.io.files import atomic
from gsc_jax.scene import InputError

CALIBRATION_SEEDS: dict[Kind, int] = {**dict.fromkeys(EDITS, 2), NO_EDIT: 4}
"""Number of seeds of each host and kind that calibrate; authentic ones differ in their history."""
SAMPLE = 20_000
"""Gaussians of a whole case used for calibration."""
MEMBERS = 3
"""Networks of an ensemble."""
FALSE_ALARMS = 0.05
"""Share of the authentic cases of the calibration whose scene probability is 0.5 or more."""
CASES, TAMPERED, AUTHENTIC = 8, 76, 180
"""Cases of a batch, and tampered and authentic Gaussians of each."""
CENTRING = 0.01
"""Weight of the squared mean log odds of the authentic Gaussians of a scene."""
HIDDEN = (64, 32)
"""Units of the hidden layers."""
STEPS = 400
"""Steps of training; 1000 gave an AUC per Gaussian only 0.002 higher on 69 cases (by hand)."""
LEARNING_RATE, WEIGHT_DECAY, DROPOUT, NOISE = 2e-3, 1e-2, 0.4, 0.3

Networks = tuple[Layers, ...]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Args:
    """Arguments of the training.

    Attributes:
        data: The real scenes.
        bank: The captures; without them only scenes of cases.py are edited.
        keep: Folder of features, slow edits, networks and their outputs, with which a run that was
            stopped goes on, and of the classifiers that leave out a scene. Remove it after a change
            of the features, of an edit or of the bank.
        out: File of the classifier of the package.
    """

    data: Path = DATA
    bank: Path = BANK
    keep: Path = Path(".cues")
    out: Path = Path("gsc_jax/forensics/classifier.npz")


def train_network(cases: Sequence[Examples], seed: int) -> Layers:
    """Train one network; each kind of edit has equal weight, and within it each case."""
    weights, rng = balanced_weights([case.edit for case in cases]), np.random.default_rng(seed)
    layers = _initial_layers(rng, (cases[0].values.shape[1], *HIDDEN, 1))
    state = _optimiser().init(layers)
    for k in range(STEPS):
        some = rng.choice(len(cases), CASES, p=weights)
        values = np.stack([_sample(cases[one], rng) for one in some])
        key = jax.random.key(seed * STEPS + k, impl="unsafe_rbg")
        with jax.numpy_dtype_promotion("standard"):  # optax mixes integers and floats
            layers, state = _step(layers, state, values, key)
    return jax.tree.map(np.asarray, layers)


def _optimiser() -> optax.GradientTransformation:
    schedule = optax.cosine_decay_schedule(LEARNING_RATE, STEPS)
    return optax.adamw(schedule, weight_decay=WEIGHT_DECAY)


@jax.jit  # here, and not in `train_network`, so that networks of one shape compile once
def _step(
    layers: Layers, state: optax.OptState, values: np.ndarray, key: jax.Array
) -> tuple[Any, optax.OptState]:
    gradients = jax.grad(scene_loss)(layers, values, key)
    updates, state = _optimiser().update(gradients, state, layers)
    return optax.apply_updates(layers, updates), state


def _sample(case: Examples, rng: np.random.Generator) -> np.ndarray:
    """Features of `TAMPERED` tampered Gaussians of a case, then of `AUTHENTIC` ones, float32."""
    rows = (
        rng.choice(np.flatnonzero(case.labels), TAMPERED),
        rng.choice(np.flatnonzero(~case.labels), AUTHENTIC),
    )
    return case.values[np.concatenate(rows)].astype(np.float32)


def scene_loss(layers: Layers, values: jax.Array, key: jax.Array) -> jax.Array:
    """Cross entropy within scenes of features (scenes, Gaussians, F), in the order of `_sample`.

    The log odds are those above the mean of the authentic Gaussians of the scene: what a whole
    capture has in common tells nothing about its parts, and differs in the next one.
    """
    log_odds = noisy_log_odds(layers, values.reshape(-1, values.shape[2]), key)
    log_odds = log_odds.reshape(values.shape[:2])
    middle = log_odds[:, TAMPERED:].mean(axis=1, keepdims=True)
    above = log_odds - middle + math.log(TAMPERED / AUTHENTIC)
    labels = jnp.broadcast_to(jnp.arange(values.shape[1]) < TAMPERED, above.shape)
    return optax.sigmoid_binary_cross_entropy(above, labels).mean() + CENTRING * (middle**2).mean()


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
        own = [case for case in cases if not case.sources & some]
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
    cases = [case for case in cases if heldout not in case.sources]
    weights = balanced_weights([case.edit for case in cases])
    share = float(weights @ [case.share for case in cases])
    without = frozenset([heldout] if heldout else [])
    classifier = Classifier(
        networks=networks[without],
        names=cases[0].names,
        novelty=1.0,
        calibration=(1.0, 0.0),
        base=float(np.log(share / (1 - share))),
        scene=(1.0, 0.0),
    )
    scenes = {source_of(case.host) for case in cases}
    others = {scene: networks[without | {scene}][0] for scene in scenes}
    return Fold(heldout=heldout, classifier=classifier, others=others)


@dataclasses.dataclass(frozen=True, kw_only=True)
class SceneOutput:
    """A case: output of the networks and labels (N,), places, and their novelty (P,)."""

    edit: str
    networks: np.ndarray
    places: Places
    novelty: np.ndarray
    labels: np.ndarray

    def raw(self, classifier: Classifier) -> np.ndarray:
        """Raw log odds, as in `combined_log_odds`, shape (N,)."""
        return with_places(self.networks, self.places, classifier.novelty * self.novelty)

    def columns(self) -> np.ndarray:
        """Output of the networks and novelty of the Gaussians, shape (N, 2)."""
        return np.column_stack([self.networks, self.places.spread_out(self.novelty)])


Outputs = dict[str | None, SceneOutput]
"""By the scene that was left out."""


def scene_outputs(case: BankCase, host: str, folds: Sequence[Fold]) -> Outputs:
    """Outputs for a whole case by the held-out scene of each fold that did not see its sources."""
    features = compute_features(with_finite_scales(case.gaussians))
    places = find_places(features, np.asarray(case.gaussians.means, np.float32))
    novel, outputs = novelty(places), {}
    for fold in folds:
        if fold.heldout not in case.sources:
            one = dataclasses.replace(fold.classifier, networks=(fold.others[source_of(host)],))
            outputs[fold.heldout] = SceneOutput(
                edit=case.edit,
                networks=smoothed_log_odds(features, one),
                places=places,
                novelty=novel,
                labels=case.labels,
            )
    return outputs


def logistic_fit(
    values: np.ndarray, labels: np.ndarray, weights: np.ndarray, damping: float = 1e-4
) -> np.ndarray:
    """Factors (D,) and shift from values (M, D) to log odds of the labels, shape (D + 1,).

    By weighted logistic regression.
    """
    weights = weights / weights.sum()

    def loss(line: np.ndarray) -> tuple[float, np.ndarray]:
        log_odds = values @ line[:-1] + line[-1]
        losses = np.logaddexp(0, np.where(labels, -log_odds, log_odds))
        errors = weights * (expit(log_odds) - labels)
        slopes = np.append(errors @ values + 2 * damping * line[:-1], errors.sum())
        return float(weights @ losses + damping * (line[:-1] ** 2).sum()), slopes

    return minimize(loss, np.append(np.ones(values.shape[1]), 0.0), jac=True).x


def calibrated(classifier: Classifier, outputs: Sequence[SceneOutput]) -> Classifier:
    """The classifier with the weight of the novelty, calibrated for Gaussians and for scenes."""
    edited = [one for one in outputs if one.edit != NO_EDIT]
    factor, of_novelty, _ = _gaussian_fit(edited, [one.columns() for one in edited])
    classifier = dataclasses.replace(classifier, novelty=float(of_novelty / factor))
    line = _gaussian_fit(edited, [one.raw(classifier)[:, None] for one in edited])
    classifier = dataclasses.replace(classifier, calibration=tuple(line.tolist()))
    return dataclasses.replace(classifier, scene=_scene_fit(classifier, outputs))


def _scene_fit(classifier: Classifier, outputs: Sequence[SceneOutput]) -> tuple[float, float]:
    """Factor and shift from the span of a scene to log odds that it was edited."""
    is_edited = np.array([one.edit != NO_EDIT for one in outputs])
    found = [calibrate(one.raw(classifier), one.places, classifier) for one in outputs]
    spans = np.array([one.span for one in found])
    # The prior probability that a scene was edited is one half.
    weights = np.where(is_edited, 1 / is_edited.sum(), 1 / (~is_edited).sum())
    scale = float(logistic_fit(spans[:, None], is_edited, weights, damping=1e-2)[0])
    return scale, -scale * float(np.quantile(spans[~is_edited], 1 - FALSE_ALARMS))


def _gaussian_fit(edited: Sequence[SceneOutput], columns: Sequence[np.ndarray]) -> np.ndarray:
    """Factors of columns (N, D) for each edited case, and shift, from a sample of each."""
    values, labels, weights = [], [], []
    balanced = balanced_weights([one.edit for one in edited])
    for k, (one, own, weight) in enumerate(zip(edited, columns, balanced, strict=True)):
        rows = np.random.default_rng(k).permutation(len(one.labels))[:SAMPLE]
        values.append(own[rows])
        labels.append(one.labels[rows])
        weights.append(np.full(len(rows), weight / len(rows)))
    return logistic_fit(np.concatenate(values), np.concatenate(labels), np.concatenate(weights))


def save(path: Path, classifier: Classifier) -> None:
    """Store a classifier in the format of `from_arrays`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, allow_pickle=False, **as_arrays(classifier))


def as_arrays(classifier: Classifier) -> dict[str, np.ndarray]:
    """Arrays of a classifier by name, for `np.savez`."""
    arrays = {"shape": np.array([len(classifier.networks), len(classifier.networks[0])])}
    for i, layers in enumerate(classifier.networks):
        for k, (weights, bias) in enumerate(layers):
            arrays |= {f"weights{i}.{k}": weights, f"bias{i}.{k}": bias}
    others = ("names", "novelty", "calibration", "base", "scene")
    return arrays | {name: np.array(getattr(classifier, name)) for name in others}


def main(args: Args) -> None:
    """Compute the features, train the networks, calibrate and store the classifiers."""
    args.keep.mkdir(parents=True, exist_ok=True)
    scenes, names = available(args.data), hosts(args.bank, args.data)
    if len(scenes) < 3:
        raise InputError(
            f"{args.data}: no scenes; leaving out two of {len(scenes)} leaves none to train on. "
            "Get the real scenes, or use the classifier that comes with the package"
        )
    jobs = [
        (*job, seed) for job in itertools.product(names, EDITS) for seed in training_seeds(job[0])
    ]
    progress = tqdm(jobs, desc="cases", disable=None)
    made = [make_examples(*job, args.bank, args.data, args.keep) for job in progress]
    cases = [case for case in made if case.share > 0]
    trained = args.keep / digest(cases)  # networks of other examples are not read
    networks = kept(trained / "networks.pickle", lambda: train_networks(cases, scenes))
    folds = [make_fold(heldout, cases, networks) for heldout in (None, *scenes)]
    outputs = list(whole_outputs(folds, args, trained))
    for fold in folds:
        own = [by[fold.heldout] for by in outputs if fold.heldout in by]
        path = args.keep / f"without-{fold.heldout}.npz" if fold.heldout else args.out
        save(path, calibrated(fold.classifier, own))


def whole_outputs(
    folds: Sequence[Fold], args: Args, folder: Path
) -> Iterator[dict[str | None, SceneOutput]]:
    """Yield the outputs for whole cases of each host, edited and not; `folder` keeps them."""
    for host, edit, seed in tqdm(calibration_cases(args), desc="whole cases", disable=None):

        def compute(job: tuple[str, Kind, int] = (host, edit, seed)) -> Outputs:
            case = stored_case(*job, args.bank, args.data, args.keep)
            return scene_outputs(case, job[0], folds) if case else {}

        yield kept(folder / f"{host}_{edit}_{seed}.pickle", compute)


def calibration_cases(args: Args) -> list[tuple[str, Kind, int]]:
    """Host, kind of edit and seed of the whole cases."""
    return [
        (host, edit, training_seeds(host)[0] + k)
        for host in hosts(args.bank, args.data)
        for edit, count in CALIBRATION_SEEDS.items()
        for k in range(count)
    ]


if __name__ == "__main__":
    start(main, __doc__)
