"""The network that reads the cues of Gaussians: how suspicious each one looks, in log odds.

It was trained on edits of other scenes (experiments/train_cues.py) and sees one Gaussian at a time,
with what its cues say of the surroundings; opinions are then shared among neighbours, since edits
are compact, and calibrated. A model is the mean of a few such networks.
"""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from importlib.resources import as_file, files

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.forensics.features import Cues
from gsc_jax.scene.neighbours import parts

MODEL = "classifier.npz"
BLOCK = 2**15
"""Gaussians that the network reads at once."""
SETTLED = 4
"""How often an opinion is mixed half and half with those of the neighbours."""
RAW, SURE = 25.0, 12.0
"""Raw and calibrated log odds beyond which nothing is told apart."""
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
        calibration: Factor and shift that make log odds of the raw ones, once those are settled.
        base: Log odds that a Gaussian of an edited scene is tampered, before looking.
        scene: Factor and shift that make log odds of a scene of those of its most suspicious part.
    """

    networks: tuple[Layers, ...]
    names: tuple[str, ...]
    calibration: tuple[float, float]
    base: float
    scene: tuple[float, float]


def opinions(described: Cues, model: Model) -> np.ndarray:
    """Calibrated log odds of each Gaussian, of one mind with its neighbours, (N,) float32."""
    raw = settled(judged(described, model), described)
    factor, shift = calibration_in(raw, model)
    return np.clip(factor * raw + shift, -SURE, SURE)


def calibration_in(raw: np.ndarray, model: Model) -> tuple[float, float]:
    """Factor and shift that make log odds of the settled raw ones of one scene.

    Most of a scene is authentic: where most of it seems tampered, it is unlike all that was
    trained on, and only what is more suspicious than the rest says anything.
    """
    factor, shift = model.calibration
    return factor, shift - max(factor * float(np.median(raw)) + shift - model.base, 0.0)


def judged(described: Cues, model: Model) -> np.ndarray:
    """Raw log odds of each Gaussian by itself, shape (N,) float32, within +-`RAW`."""
    columns = [described.names.index(name) for name in model.names]
    return np.clip(raw_odds(described.values, model.networks, columns), -RAW, RAW)


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


@functools.cache
def shipped_model() -> Model:
    """The model that comes with the package; experiments/train_cues.py makes it."""
    with as_file(files("gsc_jax.forensics") / MODEL) as path, np.load(path) as stored:
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
