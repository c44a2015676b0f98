"""Classifier of Gaussians: raw log odds from small networks, novelty and a discriminant.

The networks were trained on edits by experiments/train_classifier.py and see one Gaussian at a
time. Since edits are compact, their output is smoothed over neighbours. Novelty is not trained, and
adds what the networks do not know of sources that they never saw. The discriminant learns from both
what is different in the scene at hand.
"""

import dataclasses
import functools
from collections.abc import Mapping
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.forensics.discriminant import discriminant
from gsc_jax.forensics.features import Features
from gsc_jax.forensics.novelty import novelty
from gsc_jax.forensics.places import Places
from gsc_jax.scene.parallel import blocks

BLOCK = 2**15
"""Gaussians per call of the networks; one size, so that they compile once."""
SMOOTHING_STEPS = 4
"""Number of averages with the mean over the neighbours."""
DISCRIMINANT = 0.8
"""Weight of the discriminant in the raw log odds."""
MAX_RAW_LOG_ODDS = 25.0
"""Clip raw log odds to this magnitude: the sigmoid is 0 or 1 in float32 beyond it."""

Layers = tuple[tuple[np.ndarray, np.ndarray], ...]
"""Weights (inputs, outputs) and biases (outputs,) of each layer."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Classifier:
    """An ensemble of networks with its calibration.

    Attributes:
        networks: Networks whose mean output is the raw log odds.
        names: Names of the features, in the order of the inputs.
        novelty: Weight of the novelty in the raw log odds.
        calibration: Factor and shift from raw log odds to log odds of a Gaussian.
        base: Log odds that a Gaussian of an edited scene is tampered, without any evidence.
        scene: Factor and shift from the peak above the median to log odds of an edited scene.
    """

    networks: tuple[Layers, ...]
    names: tuple[str, ...]
    novelty: float
    calibration: tuple[float, float]
    base: float
    scene: tuple[float, float]


def combined_log_odds(features: Features, places: Places, classifier: Classifier) -> np.ndarray:
    """Raw log odds of N Gaussians by networks, novelty and discriminant, shape (N,) float32."""
    novel = classifier.novelty * novelty(places)
    return with_places(smoothed_log_odds(features, classifier), places, novel)


def with_places(networks: np.ndarray, places: Places, novel: np.ndarray | float) -> np.ndarray:
    """Log odds (N,) plus weighted novelty (P,), plus the discriminant starting from both, (N,)."""
    added = discriminant(places, places.averaged(networks) + novel)
    return networks + places.spread_out(novel + DISCRIMINANT * added)


def smoothed_log_odds(features: Features, classifier: Classifier) -> np.ndarray:
    """Output of the networks, smoothed over the neighbours, at least its median, shape (N,).

    What looks less tampered than the middle of the scene is no less suspicious: a pasted object may
    come from a capture that is nearer to the authentic ones of the training than its host.
    """
    same = classifier.names == features.names  # selecting columns copies all values
    columns = slice(None) if same else [features.names.index(name) for name in classifier.names]
    parts = blocks(len(features.neighbourhoods.nearest), BLOCK)
    raw = [raw_log_odds(features.rows(part)[:, columns], classifier.networks) for part in parts]
    smoothed = np.clip(np.concatenate(raw), -MAX_RAW_LOG_ODDS, MAX_RAW_LOG_ODDS)
    for _ in range(SMOOTHING_STEPS):
        smoothed = 0.5 * (smoothed + features.neighbourhoods.mean(smoothed))
    return np.maximum(smoothed, np.median(smoothed))


def raw_log_odds(values: np.ndarray, networks: tuple[Layers, ...]) -> np.ndarray:
    """Mean output of networks for features (N, F) of N <= `BLOCK` Gaussians, shape (N,) float32."""
    padded = np.pad(values, ((0, BLOCK - len(values)), (0, 0)))
    return np.asarray(_ensemble(networks, padded))[: len(values)]


@jax.jit
def _ensemble(networks: tuple[Layers, ...], values: jax.Array) -> jax.Array:
    return jnp.mean(jnp.stack([network(layers, values) for layers in networks]), axis=0)


def network(layers: Layers, values: jax.Array) -> jax.Array:
    """Multilayer perceptron with GELU activations, from features (N, F) to log odds (N,)."""
    for weights, bias in layers[:-1]:
        values = jax.nn.gelu(values @ weights + bias[None])
    weights, bias = layers[-1]
    return (values @ weights + bias[None])[:, 0]


@functools.cache
def default_classifier() -> Classifier:
    """The classifier that comes with the package."""
    with np.load(Path(__file__).with_name("classifier.npz")) as stored:
        return from_arrays(stored)


def from_arrays(stored: Mapping[str, np.ndarray]) -> Classifier:
    """Classifier from the arrays that `experiments/train_classifier.py` stores."""
    count, depth = stored["shape"]
    networks = tuple(
        tuple((stored[f"weights{i}.{k}"], stored[f"bias{i}.{k}"]) for k in range(depth))
        for i in range(count)
    )
    others = {name: tuple(stored[name].tolist()) for name in ("calibration", "scene", "names")}
    base, weight = float(stored["base"]), float(stored["novelty"])
    return Classifier(networks=networks, base=base, novelty=weight, **others)
