"""Evidence without a 2D detector: how likely each Gaussian is tampered, by the Gaussians alone.

A small network, trained on edits of other scenes (experiments/train_cues.py), reads the cues of
each Gaussian; exact traces, which need no learning, are added to it. Both together are the prior of
the robust estimator, or all there is where no masks are.
"""

import dataclasses
import functools
import math
from collections.abc import Mapping, Sequence
from importlib.resources import as_file, files

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.cues import NEIGHBOURS, Cues, cues
from gsc_jax.finding import Finding
from gsc_jax.neighbourhoods import parts
from gsc_jax.robust import Prior, RobustConfig, both
from gsc_jax.scene import Gaussians, invalid_rows
from gsc_jax.traces import NEIGHBOURS as ASKED
from gsc_jax.traces import Trace, combined, traces

MODEL = "cues.npz"
BLOCK = 2**15
"""Gaussians that the network reads at once."""
SETTLED = 4
"""How often an opinion is mixed half and half with those of the neighbours."""
SURE = 12.0
"""Log odds beyond which nothing is told apart."""
LEVEL = 0.3
"""Chosen on seeds 10 and 11 by the F1 of what is labelled."""
PART = 64
"""Gaussians of the part of a scene whose mean log odds speak for the whole of it."""

Layers = tuple[tuple[np.ndarray, np.ndarray], ...]
"""Weights (inputs, outputs) and biases (outputs,) of each layer."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Model:
    """What reads cues.

    Attributes:
        networks: The mean of their outputs are raw log odds.
        names: Of the cues that they take, in their order.
        calibration: Factor and shift that make log odds of the raw ones.
        base: Log odds that a Gaussian of an edited scene is tampered, before looking.
        scene: Factor and shift that make log odds of a scene of those of its most suspicious part.
    """

    networks: tuple[Layers, ...]
    names: tuple[str, ...]
    calibration: tuple[float, float]
    base: float
    scene: tuple[float, float]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Native:
    """What the Gaussians themselves say.

    Attributes:
        known: Rows that could be described, shape (N,) bool.
        learned: What the network says, as log odds, shape (N,) float32.
        learned_verdict: What it says of the scene.
        log_odds: That a Gaussian is tampered, after the exact traces, shape (N,) float32; of the
            base rate where nothing is known of a row.
        base: Log odds before looking: more than these speaks for an edit.
        worst: Mean log odds of the part that is most suspicious, exact traces left aside.
        verdict: Probability that anything was tampered with.
        traces: Exact traces, those that found nothing among them.
    """

    known: np.ndarray
    learned: np.ndarray
    learned_verdict: float
    log_odds: np.ndarray
    base: float
    worst: float
    verdict: float
    traces: tuple[Trace, ...]

    @property
    def prior(self) -> Prior:
        """What this is to the robust estimator: edits need not show, so silence says nothing."""
        certain = min(max(self.verdict, 0.5), 1 - 1e-6)
        traced = any(trace.found for trace in self.traces)
        return Prior(
            log_odds=self.log_odds,
            scene=math.log(certain / (1 - certain)),
            exact=combined(self.traces) if traced else None,
        )

    @property
    def without_traces(self) -> "Native":
        """What the network alone says."""
        return dataclasses.replace(
            self, log_odds=self.learned, verdict=self.learned_verdict, traces=()
        )

    @property
    def probability(self) -> np.ndarray:
        """That a Gaussian is tampered, shape (N,) float32."""
        return np.asarray(jax.nn.sigmoid(self.log_odds))


def native_evidence(
    gaussians: Gaussians, *, model: Model | None = None, exact: bool = True
) -> Native:
    """Ask the Gaussians themselves.

    Args:
        gaussians: N Gaussians.
        model: Replaces the one that comes with the package.
        exact: Whether to look for exact traces, too, which a re-export may wash out.

    Returns:
        The evidence. The order of the rows matters only where it is a trace.
    """
    model = model or shipped_model()
    host = jax.tree.map(np.asarray, gaussians)
    known = ~np.any(list(invalid_rows(host).values()), axis=0)
    sound = np.flatnonzero(known)
    learned = np.full(len(host), model.base, np.float32)
    worst, neighbours = model.base, None
    if len(sound) > NEIGHBOURS:
        usable = host.take(sound)
        learned[sound], nearest = _learned(usable, model)
        neighbours = np.tile(np.arange(len(host))[:, None], (1, ASKED))
        neighbours[sound] = sound[nearest]
        worst = worst_part(learned[sound], usable.means)
    found = traces(host, neighbours=neighbours) if exact else ()
    factor, shift = model.scene
    verdict = float(jax.nn.sigmoid(factor * worst + shift))
    certain = max((float(trace.score.max(initial=0)) for trace in found), default=0.0)
    return Native(
        known=known,
        learned=learned,
        learned_verdict=verdict,
        log_odds=with_traces(learned, found),
        base=model.base,
        worst=worst,
        verdict=1 - (1 - verdict) * (1 - certain),
        traces=tuple(found),
    )


def _learned(usable: Gaussians, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """The opinion on each, (N,), and who is near it, (N, `ASKED`); the cues are let go."""
    described = cues(usable)
    return opinions(described, model), described.around.nearest[:, :ASKED].copy()


def find_native(native: Native, config: RobustConfig, against: float = 0.0) -> Finding:
    """What is tampered where no view flags anything, or there is none.

    That the calibrated probabilities are mostly small says how often scenes like this one are
    misjudged. Given that something was edited, it is what stands out here: Gaussians are labelled
    that are more suspicious than a share `LEVEL` of the way from the base rate to the worst part.
    Where an exact trace says what was edited, more than even odds are asked of the rest.

    Args:
        native: What the Gaussians say, N of them.
        config: Of the estimator, of which the threshold and the doubt matter here.
        against: Log odds by which views that flag nothing speak against any edit.

    Returns:
        The finding; its attribute is the log odds, counted from that level.
    """
    certain = both(native.verdict, -against)
    level = native.base + LEVEL * max(native.worst - native.base, 0.0)
    if any(trace.found for trace in native.traces):
        level = max(level, 0.0)
    attribute = np.where(native.known, native.log_odds - level, 0).astype(np.float32)
    tamper = np.where(native.known, jax.nn.sigmoid(attribute), 0).astype(np.float32)
    labels = (tamper > config.threshold) & (certain >= config.doubt)
    return Finding(
        attribute=attribute,
        tamper=tamper * (certain >= config.doubt),
        labels=labels,
        group_sizes=np.zeros((0, 3), np.int32),
        verdict=certain,
        warnings=_doubts(native, labels, certain),
    )


def _doubts(native: Native, labels: np.ndarray, certain: float) -> list[str]:
    """What a user should know before believing the labels."""
    if not native.known.any():
        return ["No Gaussian could be described, so nothing is said of any."]
    if not labels.any():
        return ["Nothing about the Gaussians speaks for an edit."]
    if certain < 0.5:
        return [
            "What is labelled is what stands out most, as something does in untouched scenes, too: "
            "perhaps nothing was tampered with."
        ]
    return []


def opinions(described: Cues, model: Model) -> np.ndarray:
    """Log odds of each Gaussian, of one mind with its neighbours, shape (N,) float32.

    Most of a scene is authentic: where most of it seems tampered, it is unlike all that was
    trained on, and only what is more suspicious than the rest says anything.
    """
    log_odds = settled(judged(described, model), described)
    return log_odds - max(float(np.median(log_odds)) - model.base, 0.0)


def judged(described: Cues, model: Model) -> np.ndarray:
    """Calibrated log odds of each Gaussian by itself, shape (N,) float32."""
    columns = [described.names.index(name) for name in model.names]
    factor, shift = model.calibration
    raw = raw_odds(described.values, model.networks, columns)
    return np.clip(factor * raw + shift, -SURE, SURE)


def raw_odds(
    values: np.ndarray, networks: tuple[Layers, ...], columns: Sequence[int] | slice = slice(None)
) -> np.ndarray:
    """Raw log odds (N,) of columns of cues (N, F), whatever N by one compiled function."""
    raw = np.empty(len(values), np.float32)
    for start in range(0, len(values), BLOCK):
        block = values[start : start + BLOCK, columns]
        padded = np.pad(block, ((0, BLOCK - len(block)), (0, 0)))
        raw[start : start + BLOCK] = opinion(networks, padded)[: len(block)]
    return raw


@jax.jit
def opinion(networks: tuple[Layers, ...], values: jax.Array) -> jax.Array:
    """Raw log odds (N,) of cues (N, F): the mean over some networks."""
    return jnp.mean(jnp.stack([network(layers, values) for layers in networks]), axis=0)


def network(layers: Layers, values: jax.Array) -> jax.Array:
    """Raw log odds (N,) of cues (N, F): a perceptron with GELU between the layers."""
    for weights, bias in layers[:-1]:
        values = jax.nn.gelu(values @ weights + bias[None])
    weights, bias = layers[-1]
    return (values @ weights + bias[None])[:, 0]


def settled(log_odds: np.ndarray, described: Cues) -> np.ndarray:
    """Opinions after each was mixed with those of the neighbours: edits are compact."""
    for _ in range(SETTLED):
        log_odds = 0.5 * (log_odds + described.around.mean @ log_odds)
    return log_odds


def worst_part(log_odds: np.ndarray, means: np.ndarray) -> float:
    """Mean log odds of the part of a scene where they are highest."""
    return max(float(log_odds[rows].mean()) for rows in parts(means, PART))


def with_traces(log_odds: np.ndarray, found: Sequence[Trace]) -> np.ndarray:
    """Log odds of the noisy-or of both: either alone is enough."""
    if not found:
        return log_odds
    score = np.minimum(combined(found), 1 - 1e-6)
    with np.errstate(divide="ignore"):  # a score of 0 leaves the log odds as they are
        return np.minimum(np.logaddexp(log_odds, np.log(score)) - np.log1p(-score), SURE)


@functools.cache
def shipped_model() -> Model:
    """The model that comes with the package; experiments/train_cues.py makes it."""
    with as_file(files("gsc_jax") / MODEL) as path, np.load(path) as stored:
        return from_arrays(stored)


def from_arrays(stored: Mapping[str, np.ndarray]) -> Model:
    """A model of the arrays that `as_arrays` made of it."""
    count, depth = stored["shape"]
    networks = tuple(
        tuple((stored[f"weights{i}.{k}"], stored[f"bias{i}.{k}"]) for k in range(depth))
        for i in range(count)
    )
    return Model(
        networks=networks,
        names=tuple(map(str, stored["names"])),
        calibration=(float(stored["calibration"][0]), float(stored["calibration"][1])),
        base=float(stored["base"]),
        scene=(float(stored["scene"][0]), float(stored["scene"][1])),
    )


def as_arrays(model: Model) -> dict[str, np.ndarray]:
    """The arrays of a model, to be stored."""
    arrays = {"shape": np.array([len(model.networks), len(model.networks[0])])}
    for i, layers in enumerate(model.networks):
        for k, (weights, bias) in enumerate(layers):
            arrays |= {f"weights{i}.{k}": weights, f"bias{i}.{k}": bias}
    return {
        **arrays,
        "names": np.array(model.names),
        "calibration": np.array(model.calibration),
        "base": np.array(model.base),
        "scene": np.array(model.scene),
    }
