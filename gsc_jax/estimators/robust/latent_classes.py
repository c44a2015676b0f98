"""Latent classes: Gaussians that the detector treats alike, each class with a flag rate per view.

Two classes, tampered and authentic, cannot explain an authentic thing that a detector flags from
many sides; several can. A class k is flagged in view j with probability q_kj, whatever that view's
mask did: found the object, missed it, was inverted, or took something else for it. EM fits the
rates (Dempster, Laird and Rubin 1977; latent classes: Goodman 1974; raters that err: Dawid and
Skene 1979), from several starts at once, and the data chooses how many classes there are by the
Bayesian information criterion (Schwarz 1978).
"""

import dataclasses
import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.scene import Array, pytree

RATE_FLOOR = 0.02
"""A rate is never 0 or 1: a single surprise must not exclude a class."""
TOLERANCE = 1e-4
"""Gain in log likelihood per Gaussian at which EM has arrived."""
MAX_ITERATIONS = 100
FEWEST = 16
"""Views are padded to a power of two from here, so that another number seldom compiles anew."""


@pytree
class Classes:
    """A fitted mixture of K classes; of unused ones the share is 0.

    Attributes:
        rates: Probability of being flagged, by class and view, shape (K, V).
        shares: Share of those it was fitted to in each class, shape (K,).
    """

    rates: Array
    shares: Array


@pytree
class Fit:
    """The classes, and how they were reached.

    Attributes:
        classes: Of the best start with the best number of classes.
        belongs: Probability that a Gaussian is of each class, shape (K, S).
        criterion: Log likelihood less the price of the parameters, for every start, shape (R,).
        iterations: Of EM, for every start, shape (R,).
    """

    classes: Classes
    belongs: Array
    criterion: Array
    iterations: Array


def fit_classes(
    flagged: Array, clear: Array, *, counts: Sequence[int], restarts: int = 2, seed: int = 0
) -> Fit:
    """Fit latent classes to how often Gaussians are flagged in each view.

    Args:
        flagged: Effective number of times that a Gaussian was flagged, shape (V, S).
        clear: The same for not flagged, shape (V, S).
        counts: Numbers of classes to choose from.
        restarts: Starts for each of them.
        seed: Of the starts.

    Returns:
        The fit; deterministic.

    Raises:
        ValueError: if there is nothing to choose from, or no Gaussian.
    """
    if not counts or min(counts) < 1 or restarts < 1:
        raise ValueError(f"expected numbers of classes and restarts, got {counts} and {restarts}")
    if not np.shape(flagged)[1]:
        raise ValueError("expected the evidence of at least one Gaussian, got none")
    views = np.shape(flagged)[0]
    blind = ((0, max(FEWEST, 1 << (views - 1).bit_length()) - views), (0, 0))
    flagged, clear = (jnp.pad(jnp.asarray(x, jnp.float32), blind) for x in (flagged, clear))
    used = np.repeat(counts, restarts)[:, None] > np.arange(max(counts), dtype=np.int32)
    keys = jax.random.split(jax.random.key(seed), len(used))
    fit = _fit_all(flagged, clear, jnp.asarray(used, jnp.float32), keys)
    classes = dataclasses.replace(fit.classes, rates=fit.classes.rates[:, :views])
    return dataclasses.replace(fit, classes=classes)


@jax.jit
def _fit_all(flagged: Array, clear: Array, used: Array, keys: Array) -> Fit:
    fitted, criterion, iterations = jax.vmap(functools.partial(_fit_one, flagged, clear))(
        used, keys
    )
    best = jnp.argmax(criterion)
    classes = jax.tree.map(lambda leaf: leaf[best], fitted)
    belongs = jax.nn.softmax(_log_joint(classes, flagged, clear), axis=0)
    return Fit(classes=classes, belongs=belongs, criterion=criterion, iterations=iterations)


def _fit_one(flagged: Array, clear: Array, used: Array, key: Array) -> tuple[Classes, Array, Array]:
    """EM from one start, until the likelihood no longer rises: classes, criterion, iterations."""
    size = flagged.shape[1]

    def arrived(state: tuple[Classes, Array, Array, Array]) -> Array:
        _, likelihood, before, iteration = state
        return (likelihood - before > TOLERANCE) & (iteration < MAX_ITERATIONS)

    def step(state: tuple[Classes, Array, Array, Array]) -> tuple[Classes, Array, Array, Array]:
        classes, likelihood, _, iteration = state
        joint = _log_joint(classes, flagged, clear)
        total = jax.nn.logsumexp(joint, axis=0)
        classes = _maximise(jnp.exp(joint - total[None]), flagged, clear, used)
        return classes, jnp.mean(total), likelihood, iteration + 1

    start = Classes(
        rates=_spread(flagged, clear, len(used), key),
        shares=used / jnp.sum(used),
    )
    begin = (start, jnp.float32(-1e30), jnp.float32(-jnp.inf), jnp.int32(0))
    classes, likelihood, _, iterations = jax.lax.while_loop(arrived, step, begin)
    views = jnp.sum(jnp.any(flagged + clear > 0, axis=1), dtype=jnp.float32)
    parameters = jnp.sum(used) * (views + 1)
    price = 0.5 * parameters * jnp.log(jnp.float32(size))
    return classes, size * likelihood - price, iterations


def _log_joint(classes: Classes, flagged: Array, clear: Array) -> Array:
    """Log probability of class and evidence, shape (K, S)."""
    evidence = jnp.log(classes.rates) @ flagged + jnp.log1p(-classes.rates) @ clear
    return jnp.log(classes.shares)[:, None] + evidence


def _maximise(belongs: Array, flagged: Array, clear: Array, used: Array) -> Classes:
    """The M step: rates with half a count of each outcome added, shares with one Gaussian."""
    positive, negative = belongs @ flagged.T, belongs @ clear.T
    rates = (positive + 0.5) / (positive + negative + 1.0)
    members = used * (jnp.sum(belongs, axis=1) + 1.0)
    return Classes(
        rates=jnp.clip(rates, RATE_FLOOR, 1 - RATE_FLOOR), shares=members / jnp.sum(members)
    )


def _spread(flagged: Array, clear: Array, count: int, key: Array) -> Array:
    """Rates to start from: the mean, and Gaussians far from those before (k-means++; 2007)."""
    looks = flagged + clear
    rate = (flagged + 0.3) / (looks + 0.6)
    common = jnp.sum(flagged, axis=1) / jnp.maximum(jnp.sum(looks, axis=1), 1e-9)

    def distance(to: Array) -> Array:
        return jnp.sum(looks * (rate - to[:, None]) ** 2, axis=0)

    def pick(k: int, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        rates, nearest = state
        gumbel = jax.random.gumbel(jax.random.fold_in(key, k), nearest.shape)
        chosen = jnp.argmax(jnp.log(nearest + 1e-12) + gumbel)
        # What the chosen one has not seen it cannot say: there, what is common stands in.
        own = jnp.where(looks[:, chosen] > 0.2 * jnp.max(looks), rate[:, chosen], common)
        start = 0.8 * own + 0.2 * common
        return rates.at[k].set(start), jnp.minimum(nearest, distance(start))

    rates = jnp.tile(common, (count, 1))
    rates, _ = jax.lax.fori_loop(1, count, pick, (rates, distance(common)))
    return jnp.clip(rates, RATE_FLOOR, 1 - RATE_FLOOR)
