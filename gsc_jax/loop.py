"""The cyclic optimisation: Adam on the attribute, first with the 2D loss, then with both losses.

There are two ways with the same `step` and the same result. `fit_rendered` follows the definition:
it renders the attribute and differentiates `loss_2d` through `composite`. `fit` is faster: it
computes the same linear function from the evidence of the views.
"""

import dataclasses
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax

from gsc_jax.evidence.lifting import Evidence, EvidenceOfViews
from gsc_jax.losses import loss_2d, loss_2d_from_evidence, loss_3d, partition
from gsc_jax.render.tiles import View
from gsc_jax.scene import Array
from gsc_jax.scene.errors import check_ranges
from gsc_jax.scene.pytree import STATIC
from gsc_jax.splat import composite

Seen = Evidence | tuple[View, Array]
"""What a view tells of the attribute: its evidence, or how to render it, and its mask (H, W)."""
MAX_WEIGHT = 1e6
"""Largest weight and learning rate. Adam squares gradients, which are at most the weights times the
number of pixels; up to here the squares stay finite in float32."""


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True, kw_only=True)
class LoopConfig:
    """Weights and schedule; all but `per_feature` may be traced, so that `fit` can be vmapped.

    Attributes:
        lambda1: Weight of the attribute inside the masks (GS-Checker, eq. 10).
        lambda2: Weight of the attribute outside the masks (GS-Checker, eq. 10).
        beta: Weight of the 2D loss (GS-Checker, eq. 11).
        gamma: Weight of the 3D loss (GS-Checker, eq. 11).
        contrastive_start: First iteration, counted from 0, with the 3D loss; None: half of them.
        learning_rate: Learning rate of Adam.
        per_feature: Average one sign per attribute in eq. 8, as the released code does.

    Raises:
        ValueError: if a weight is not in [0, `MAX_WEIGHT`], or the start is no whole number.
    """

    lambda1: float = 1.0
    lambda2: float = 10.0
    beta: float = 1.0
    gamma: float = 10.0
    contrastive_start: int | None = None
    learning_rate: float = 1.0
    per_feature: bool = dataclasses.field(default=False, metadata=STATIC)

    def __post_init__(self) -> None:
        """Check the numbers; JAX also makes instances of traced values, which have none yet."""
        for name in ("lambda1", "lambda2", "beta", "gamma", "contrastive_start", "learning_rate"):
            if isinstance(getattr(self, name), int | float | np.number | str):
                whole = name == "contrastive_start"
                check_ranges(self, {name: (0, 2**31 - 1) if whole else (0.0, MAX_WEIGHT)})


class State(NamedTuple):
    """Attribute, optimiser and number of iterations between two steps."""

    r: jax.Array
    optimizer: optax.OptState
    iteration: jax.Array


class StepInfo(NamedTuple):
    """Losses before a step, and the sizes of G_h, G_m and G_l."""

    loss_2d: jax.Array
    loss_3d: jax.Array
    group_sizes: jax.Array


def init(r: Array) -> State:
    """Create the state before the first step from an initial attribute, shape (N,)."""
    r = jnp.asarray(r, jnp.float32)
    return State(r, adam(1.0).init(r), jnp.int32(0))


def step(
    state: State,
    view_loss: Callable[[jax.Array], jax.Array],
    attributes: Array,
    *,
    config: LoopConfig,
) -> tuple[State, StepInfo]:
    """Update the attribute once, with the loss of one view (GS-Checker, eq. 11).

    `view_loss` maps an attribute (N,) to the 2D loss; the attributes F of the 3D loss are (A, N).
    """
    if config.contrastive_start is None:
        raise ValueError("contrastive_start must be an iteration; `fit` replaces None by half-way")
    gamma = jnp.where(state.iteration < config.contrastive_start, 0.0, config.gamma)
    groups = jax.lax.stop_gradient(partition(state.r))

    def contrast(r):
        return loss_3d(r, attributes, groups, per_feature=config.per_feature)

    def loss_cyc(r):
        l_2d = view_loss(r)
        l_3d = jax.lax.cond(gamma != 0, contrast, lambda r: jnp.zeros((), r.dtype), r)
        return config.beta * l_2d + gamma * l_3d, (l_2d, l_3d)

    gradient, (l_2d, l_3d) = jax.grad(loss_cyc, has_aux=True)(state.r)
    # Adam's bias correction raises a float to an integer power, which strict promotion refuses.
    with jax.numpy_dtype_promotion("standard"):
        updates, optimizer = adam(config.learning_rate).update(gradient, state.optimizer)
    r = jnp.asarray(optax.apply_updates(state.r, updates))
    sizes = jnp.stack([jnp.sum(g) for g in (groups.high, groups.middle, groups.low)])
    info = StepInfo(loss_2d=l_2d, loss_3d=l_3d, group_sizes=sizes)
    return State(r, optimizer, state.iteration + 1), info


def resolved(config: LoopConfig, iterations: int) -> LoopConfig:
    """Replace a `contrastive_start` of None by half of the iterations."""
    if config.contrastive_start is not None:
        return config
    return dataclasses.replace(config, contrastive_start=iterations // 2)


def adam(learning_rate: float) -> optax.GradientTransformation:
    """Adam with the epsilon of the released code, which SA3D shares.

    The epsilon is so small that every Gaussian moves at the full rate, whatever its visible weight.
    """
    return optax.adam(learning_rate, eps=1e-15)


def fit(
    evidence: EvidenceOfViews, r: Array, attributes: Array, order: Array, *, config: LoopConfig
) -> tuple[jax.Array, StepInfo]:
    """Optimise the attribute on evidence, without rendering.

    Args:
        evidence: Evidence of V views, shapes (V, N), of which one view at a time is read.
        r: Initial attribute, shape (N,).
        attributes: Attributes F of the 3D loss, shape (A, N).
        order: View of each iteration, shape (iterations,), int32.
        config: Weights and schedule.

    Returns:
        The attribute, shape (N,), and the info of all iterations.
    """
    return _iterate(evidence.view, r, attributes, order, config)


def fit_rendered(
    view_of: Callable[[int], tuple[View, Array]],
    r: Array,
    attributes: Array,
    order: Array,
    *,
    config: LoopConfig,
) -> tuple[jax.Array, StepInfo]:
    """Optimise as `fit` does, by rendering and differentiating the attribute in every iteration.

    `view_of` gives a view and its mask (H, W) in each iteration, so that one is in memory.
    """
    return _iterate(view_of, r, attributes, order, config)


def _iterate(
    seen_in: Callable[[int], Seen], r: Array, attributes: Array, order: Array, config: LoopConfig
) -> tuple[jax.Array, StepInfo]:
    config, attributes = resolved(config, len(order)), jnp.asarray(attributes)
    state, infos = init(r), []
    for index in np.asarray(order).tolist():
        state, info = _step(state, seen_in(index), attributes, config)
        infos.append(info)
    return state.r, jax.tree.map(lambda *leaves: jnp.stack(leaves), *infos)


@jax.jit
def _step(state: State, seen: Seen, attributes: Array, config: LoopConfig):
    def view_loss(r):
        weights = {"lambda1": config.lambda1, "lambda2": config.lambda2}
        if isinstance(seen, Evidence):
            return loss_2d_from_evidence(r, seen, **weights)
        view, mask = seen
        return loss_2d(composite(view, r[:, None])[..., 0], mask, **weights)  # of M^R in eq. 9

    return step(state, view_loss, attributes, config=config)


def view_order(views: int, *, epochs: int, shuffle: bool = False, seed: int = 0) -> np.ndarray:
    """View of each iteration, (epochs * views,) int32; `shuffle` draws an order for each epoch."""
    rng = np.random.default_rng(seed)
    rounds = [rng.permutation(views) if shuffle else np.arange(views) for _ in range(epochs)]
    return np.concatenate([np.zeros(0, int), *rounds]).astype(np.int32)
