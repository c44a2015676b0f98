"""The cyclic optimisation: Adam on the attribute, with the 2D loss first, then with both.

One `step` serves both paths. On the rendered path the 2D loss of a view is `loss_2d` of the
composited attribute, and its gradient comes through `composite`; this is the definition. On the
evidence path it is the same linear function with the view's evidence for coefficients; this is what
is used, and `tests/test_loop.py` holds both to the same trajectory.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from gsc_jax.evidence.lifting import Evidence
from gsc_jax.losses import loss_2d, loss_2d_from_evidence, loss_3d, partition
from gsc_jax.render.tiles import View
from gsc_jax.scene import Array
from gsc_jax.splat import composite


@functools.partial(
    jax.tree_util.register_dataclass,
    data_fields=["lambda1", "lambda2", "beta", "gamma", "contrastive_start", "learning_rate"],
    meta_fields=["per_feature"],
)
@dataclasses.dataclass(frozen=True, kw_only=True)
class LoopConfig:
    """Weights and schedule; all but `per_feature` may be traced, so `fit` can be vmapped over them.

    Attributes:
        lambda1: Reward for attribute inside the masks (eq. 10).
        lambda2: Price of attribute outside the masks (eq. 10).
        beta: Weight of the 2D loss (eq. 11).
        gamma: Weight of the 3D loss (eq. 11).
        contrastive_start: Iteration, counted from 0, at which the 3D loss joins; None: half-way.
        learning_rate: Of Adam.
        per_feature: The released code's sign per attribute instead of one per Gaussian.
    """

    lambda1: float = 1.0
    lambda2: float = 10.0
    beta: float = 1.0
    gamma: float = 10.0
    contrastive_start: int | None = None
    learning_rate: float = 1.0
    per_feature: bool = False


class State(NamedTuple):
    """The attribute and the optimiser, between two steps."""

    r: jax.Array
    optimizer: optax.OptState
    iteration: jax.Array


class StepInfo(NamedTuple):
    """What a step saw: the losses before it, and the sizes of G_h, G_m and G_l."""

    loss_2d: jax.Array
    loss_3d: jax.Array
    group_sizes: jax.Array


def init(r: Array) -> State:
    """The state before the first step.

    Args:
        r: Initial attribute, shape (N,).

    Returns:
        A state for `step`.
    """
    r = jnp.asarray(r, jnp.float32)
    return State(r, adam(1.0).init(r), jnp.int32(0))


def step(
    state: State,
    view_loss: Callable[[jax.Array], jax.Array],
    attributes: Array,
    *,
    config: LoopConfig,
) -> tuple[State, StepInfo]:
    """One iteration: one view, one update of the attribute (eq. 11).

    Args:
        state: The state before.
        view_loss: The 2D loss of a view as a function of the attribute, (N,) to scalar.
        attributes: What the 3D loss compares, shape (A, N).
        config: Weights and schedule.

    Returns:
        The state after, and what the step saw.
    """
    gamma = _gamma(config)(state.iteration)
    groups = jax.lax.stop_gradient(partition(state.r))

    def loss(r):
        flat = view_loss(r)
        compare = functools.partial(loss_3d, per_feature=config.per_feature)
        nothing = lambda r, *_: 0.0 * r[0]  # noqa: E731
        contrast = jax.lax.cond(gamma != 0, compare, nothing, r, attributes, groups)
        return config.beta * flat + gamma * contrast, (flat, contrast)

    gradient, losses = jax.grad(loss, has_aux=True)(state.r)
    # Adam's bias correction raises a float to an integer power; strict callers need not care.
    with jax.numpy_dtype_promotion("standard"):
        updates, optimizer = adam(config.learning_rate).update(gradient, state.optimizer)
    r = jnp.asarray(optax.apply_updates(state.r, updates))
    sizes = jnp.stack([jnp.sum(g) for g in (groups.high, groups.middle, groups.low)])
    info = StepInfo(loss_2d=losses[0], loss_3d=losses[1], group_sizes=sizes)
    return State(r, optimizer, state.iteration + 1), info


def _gamma(config: LoopConfig) -> optax.Schedule:
    """The weight of the 3D loss by iteration: nothing in the first phase, gamma in the second."""
    if config.contrastive_start is None:
        raise ValueError("contrastive_start must be an iteration; `fit` puts half-way for None")
    phases = [optax.constant_schedule(0.0), optax.constant_schedule(config.gamma)]
    return optax.join_schedules(phases, [config.contrastive_start])


def resolved(config: LoopConfig, iterations: int) -> LoopConfig:
    """The configuration with the iteration of the switch filled in: half-way where it is None."""
    if config.contrastive_start is not None:
        return config
    return dataclasses.replace(config, contrastive_start=iterations // 2)


def adam(learning_rate: float) -> optax.GradientTransformation:
    """Adam with the settings of the released code, which SA3D shares."""
    # The released code's epsilon: so small that every Gaussian moves at the full rate, however
    # little of it a view sees.
    return optax.adam(learning_rate, eps=1e-15)


def fit(
    evidence: Evidence, r: Array, attributes: Array, order: Array, *, config: LoopConfig
) -> tuple[jax.Array, StepInfo]:
    """Optimise on the evidence path: no rendering.

    Args:
        evidence: Of V views, shapes (V, N); the host may hold it, a view at a time is copied.
        r: Initial attribute, shape (N,).
        attributes: What the 3D loss compares, shape (A, N).
        order: View of each iteration, shape (iterations,), int32.
        config: Weights and schedule.

    Returns:
        The attribute, shape (N,), and the infos of all the iterations.
    """

    def look(index: int) -> tuple[Evidence]:
        return (jax.tree.map(lambda leaf: leaf[index], evidence),)

    return _iterate(_evidence_step, look, r, attributes, order, config)


def fit_rendered(
    look: Callable[[int], tuple[View, Array]],
    r: Array,
    attributes: Array,
    order: Array,
    *,
    config: LoopConfig,
) -> tuple[jax.Array, StepInfo]:
    """Optimise on the rendered path: render the attribute and differentiate, every iteration.

    Args:
        look: The view and the mask (H, W) of a number from `order`; called every iteration, so
            that only one view is held at a time.
        r: Initial attribute, shape (N,).
        attributes: What the 3D loss compares, shape (A, N).
        order: View of each iteration, shape (iterations,), int32.
        config: Weights and schedule.

    Returns:
        As `fit`.
    """
    return _iterate(_rendered_step, look, r, attributes, order, config)


def _iterate(one_step, look, r, attributes, order, config) -> tuple[jax.Array, StepInfo]:
    """`one_step` with what `look` shows, for every view of the order."""
    config = resolved(config, len(order))
    state, infos, attributes = init(r), [], jnp.asarray(attributes)
    for index in np.asarray(order):
        state, info = one_step(state, *look(int(index)), attributes, config)
        infos.append(info)
    return state.r, jax.tree.map(lambda *leaves: jnp.stack(leaves), *infos)


@jax.jit
def _evidence_step(state: State, evidence: Evidence, attributes: Array, config: LoopConfig):
    def view_loss(r):
        weights = {"lambda1": config.lambda1, "lambda2": config.lambda2}
        return loss_2d_from_evidence(r, evidence, **weights)

    return step(state, view_loss, attributes, config=config)


@jax.jit
def _rendered_step(state: State, view: View, mask: Array, attributes: Array, config: LoopConfig):
    def view_loss(r):
        rendered = composite(view, r[:, None])[..., 0]
        return loss_2d(rendered, mask, lambda1=config.lambda1, lambda2=config.lambda2)

    return step(state, view_loss, attributes, config=config)


def view_order(views: int, *, epochs: int, shuffle: bool = False, seed: int = 0) -> np.ndarray:
    """Which view each iteration looks at.

    Args:
        views: Number of views.
        epochs: How often each is looked at.
        shuffle: Draw a new order for each epoch instead of the fixed one.
        seed: Of the orders.

    Returns:
        Indices of views, shape (epochs * views,), int32.
    """
    rng = np.random.default_rng(seed)
    rounds = [rng.permutation(views) if shuffle else np.arange(views) for _ in range(epochs)]
    return np.concatenate([np.zeros(0, int), *rounds]).astype(np.int32)
