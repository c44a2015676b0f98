"""Latent classes: Gaussians that the detector treats alike, with one flag rate per class and view.

Two classes, tampered and authentic, cannot explain an authentic region that a detector flags in
many views; several classes can. Class k is flagged in view j with probability q_kj, whatever the
mask of that view did: find the edit, miss it, be inverted, or flag something else. EM fits the
rates (Dempster, Laird and Rubin 1977; latent classes: Goodman 1974; unreliable raters: Dawid and
Skene 1979) from several starts, which the BIC (Schwarz 1978) compares.
"""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.scene import Array, pytree

RATE_FLOOR = 0.02
"""Distance of rates from 0 and 1, so that a single unlikely view does not exclude a class."""
TOLERANCE = 1e-4
"""EM stops when the mean log likelihood per Gaussian rises by less."""
MAX_ITERATIONS = 100
SHARE_ITERATIONS = 20
"""Iterations of EM for the shares of classes in the whole scene."""
MIN_PADDED_VIEWS = 16
"""Views are padded to a power of two from here on, to avoid compiling for each number of views."""

_Pixels = tuple[Array, Array]
"""Effective numbers of flagged and of clear pixels."""


@pytree
class Classes:
    """A mixture of K latent classes.

    `rates` (K, V): how likely a view flags a class; `shares` (K,) of the Gaussians, 0 if unused.
    """

    rates: Array
    shares: Array


@pytree
class Fit:
    """Latent classes of R starts, best first, and how probable each is for a Gaussian, (R, K, S).

    The Bayesian information criterion (higher is better) and the EM iterations of each start, (R,).
    """

    classes: Classes
    responsibilities: Array
    criterion: Array
    iterations: Array


def fit_classes(
    flagged: Array, clear: Array, *, counts: Sequence[int], restarts: int = 8, seed: int = 0
) -> Fit:
    """Fit latent classes to how often Gaussians are flagged in each view; all starts, best first.

    `flagged` and `clear` (V, S) are effective numbers of pixels per view and Gaussian. The numbers
    of classes in `counts` are candidates, each with `restarts` starts drawn by the seed. No
    candidate, no start or no Gaussian raises ValueError.
    """
    if not counts or min(counts) < 1 or restarts < 1:
        raise ValueError(f"expected numbers of classes and restarts, got {counts} and {restarts}")
    if not np.shape(flagged)[1]:
        raise ValueError("expected the evidence of at least one Gaussian, got none")
    views = np.shape(flagged)[0]
    padding = ((0, max(MIN_PADDED_VIEWS, 1 << (views - 1).bit_length()) - views), (0, 0))
    flagged, clear = (jnp.pad(jnp.asarray(x, jnp.float32), padding) for x in (flagged, clear))
    used = np.repeat(counts, restarts)[:, None] > np.arange(max(counts), dtype=np.int32)
    keys = jax.random.split(jax.random.key(seed), len(used))
    # Transposed once, here: if XLA transposes a matrix in each product, that takes twice as long.
    by_view, by_gaussian = (flagged, clear), (flagged.T, clear.T)
    fit = _fit_all(by_view, by_gaussian, jnp.asarray(used, jnp.float32), keys)
    classes = dataclasses.replace(fit.classes, rates=fit.classes.rates[..., :views])
    return dataclasses.replace(fit, classes=classes)


@jax.jit
def _fit_all(by_view: _Pixels, by_gaussian: _Pixels, used: Array, keys: Array) -> Fit:
    # One after the other: side by side, all starts take as many iterations as the slowest one.
    fits = jax.lax.map(lambda start: _fit_one(by_view, by_gaussian, *start), (used, keys))
    return jax.tree.map(lambda leaf: leaf[jnp.argsort(-fits.criterion)], fits)


def _fit_one(by_view: _Pixels, by_gaussian: _Pixels, used: Array, key: Array) -> Fit:
    """Run EM from one start until convergence; the arrays `by_gaussian` (S, V) are transposes."""
    flagged, clear = by_view
    size = flagged.shape[1]

    def improves(state: tuple[Classes, Array, Array, Array]) -> Array:
        _, likelihood, before, iteration = state
        return (likelihood - before > TOLERANCE) & (iteration < MAX_ITERATIONS)

    def step(state: tuple[Classes, Array, Array, Array]) -> tuple[Classes, Array, Array, Array]:
        classes, likelihood, _, iteration = state
        joint = _log_joint(classes, flagged, clear)
        most = jnp.max(joint, axis=0, keepdims=True)
        relative = jnp.exp(joint - most)
        total = jnp.sum(relative, axis=0, keepdims=True)
        classes = _maximise(relative / total, *by_gaussian, used)
        return classes, jnp.mean(most + jnp.log(total)), likelihood, iteration + 1

    start = Classes(rates=_start_rates(flagged, clear, len(used), key), shares=used / jnp.sum(used))
    first = (start, jnp.float32(-1e30), jnp.float32(-jnp.inf), jnp.int32(0))
    classes, likelihood, _, iterations = jax.lax.while_loop(improves, step, first)
    views = jnp.sum(jnp.any(flagged + clear > 0, axis=1), dtype=jnp.float32)
    parameters = jnp.sum(used) * (views + 1)
    return Fit(
        classes=classes,
        responsibilities=jax.nn.softmax(_log_joint(classes, flagged, clear), axis=0),
        criterion=size * likelihood - 0.5 * parameters * jnp.log(jnp.float32(size)),
        iterations=iterations,
    )


def _log_joint(classes: Classes, flagged: Array, clear: Array) -> Array:
    """Log probability of class and evidence, shape (K, S)."""
    evidence = jnp.log(classes.rates) @ flagged + jnp.log1p(-classes.rates) @ clear
    return jnp.log(classes.shares)[:, None] + evidence


def _maximise(responsibilities: Array, flagged: Array, clear: Array, used: Array) -> Classes:
    """M step for `flagged` and `clear` (S, V): half a pseudo-count per outcome, one per share."""
    positive, negative = responsibilities @ flagged, responsibilities @ clear
    rates = (positive + 0.5) / (positive + negative + 1.0)
    members = used * (jnp.sum(responsibilities, axis=1) + 1.0)
    rates = jnp.clip(rates, RATE_FLOOR, 1 - RATE_FLOOR)
    return Classes(rates=rates, shares=members / jnp.sum(members))


def _start_rates(flagged: Array, clear: Array, count: int, key: Array) -> Array:
    """Start rates: the mean, then Gaussians far from those before (k-means++; 2007)."""
    pixels = flagged + clear
    rate = (flagged + 0.3) / (pixels + 0.6)
    mean = jnp.sum(flagged, axis=1) / jnp.maximum(jnp.sum(pixels, axis=1), 1e-9)

    def distance(to: Array) -> Array:
        return jnp.sum(pixels * (rate - to[:, None]) ** 2, axis=0)

    def pick(k: int, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        rates, nearest = state
        gumbel = jax.random.gumbel(jax.random.fold_in(key, k), nearest.shape)
        chosen = jnp.argmax(jnp.log(nearest + 1e-12) + gumbel)
        # The mean replaces the rates of views that hardly see the chosen Gaussian.
        own = jnp.where(pixels[:, chosen] > 0.2 * jnp.max(pixels), rate[:, chosen], mean)
        start = 0.8 * own + 0.2 * mean
        return rates.at[k].set(start), jnp.minimum(nearest, distance(start))

    rates, _ = jax.lax.fori_loop(1, count, pick, (jnp.tile(mean, (count, 1)), distance(mean)))
    return jnp.clip(rates, RATE_FLOOR, 1 - RATE_FLOOR)


def nearest_classes(
    responsibilities: np.ndarray, shares: np.ndarray, represents: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Assign S Gaussians to their most probable class: the C classes used, members (C, S) bool.

    Half of the sample is drawn from what is flagged, so that an edit has a large share of it. By
    these `shares` (K,), Gaussians that no view of the edit shows would belong to its class, too. So
    EM estimates those of the whole scene (Saerens, Latinne and Decaestecker 2002).
    """
    used = np.flatnonzero(shares > 0)
    likelihood = responsibilities[used] / shares[used, None]
    members = responsibilities[used]
    for _ in range(SHARE_ITERATIONS):
        population = members @ represents / represents.sum()
        members = likelihood * population[:, None]
        members /= members.sum(axis=0)
    classes, nearest = np.unique(members.argmax(axis=0), return_inverse=True)
    return used[classes], nearest == np.arange(len(classes))[:, None]
