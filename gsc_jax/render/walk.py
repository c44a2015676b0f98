"""The walk: blending weights of a group of tiles, a chunk of splats at a time, front to back."""

import dataclasses
import functools
import math
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from gsc_jax.render.projection import MIN_ALPHA
from gsc_jax.render.tiles import TILE, View
from gsc_jax.scene import Array
from gsc_jax.scene.parallel import LARGE, usable_cores

Value = TypeVar("Value")
MAX_ALPHA = 0.99
"""Largest opacity of a splat at a pixel, that of the INRIA rasteriser."""
MIN_TRANSMITTANCE = 1e-4
"""A pixel stops before its transmittance would fall below this, as in the INRIA rasteriser."""
CHUNK = 8
"""Splats per iteration: longer chunks stop later, shorter ones launch more operations."""
LOG_MIN_ALPHA = math.log(MIN_ALPHA)
EXP = (0.9999999, 0.1249991, 0.007810728, 0.0003242016, 9.717536e-06, 1.790013e-07)
"""Coefficients of the polynomial in x that is closest to exp(x / 8) for log(1/255) <= x <= 0."""


def exp_of_visible(x: jax.Array) -> jax.Array:
    """Compute exp(x) for log(1/255) <= x <= 0, with a relative error of 3e-6.

    The exponential function of XLA, for any x, took more than a third of the walk on a CPU.
    """
    a, b, c, d, e, f = EXP
    return (((a + x * (b + x * (c + x * (d + x * (e + x * f))))) ** 2) ** 2) ** 2


def alpha_at(splat: jax.Array, pixel: jax.Array) -> jax.Array:
    """Compute alpha = min(0.99, o exp(-sigma)), 0 below 1/255, of a splat (6,) at a pixel (2,)."""
    dx, dy = pixel[0] - splat[0], pixel[1] - splat[1]
    sigma = (splat[2] * dx + splat[3] * dy) ** 2 + (splat[4] * dy) ** 2
    log_alpha = splat[5] - sigma
    alpha = jnp.minimum(MAX_ALPHA, exp_of_visible(log_alpha))
    return jnp.where(log_alpha >= LOG_MIN_ALPHA, alpha, 0.0)


def blend_pixel(
    transmittance: jax.Array, alphas: Sequence[jax.Array]
) -> tuple[list[jax.Array], jax.Array]:
    """Compute the blending weights of the next splats of a pixel, and the transmittance behind.

    w_i = T_i alpha_i, and T_{i+1} = T_i - w_i. Slower in XLA on a CPU: a cumulative product, and
    an array of all weights, which XLA copies to change the order of its axes.
    """
    weights = []
    for alpha in alphas:
        weight = transmittance * alpha
        transmittance -= weight
        weights.append(jnp.where(transmittance >= MIN_TRANSMITTANCE, weight, 0.0))
    return weights, transmittance


# The axes are (tiles, pixels): on a CPU, XLA vectorises over the last one, the longer.
_alphas = jax.vmap(jax.vmap(alpha_at, (None, 0)))
_blend = jax.vmap(jax.vmap(blend_pixel))


def walk(view: View, group: tuple[Array, ...], visit: Callable, carry: Any) -> Any:
    """Walk the lists of a group of tiles until all of them end or every pixel has stopped.

    Each chunk updates the carry by `visit(carry, ids, weights, alphas)` with ids (tiles, C), and
    C weights and C alphas (tiles, pixels).
    """
    tiles, starts, counts = group
    pixels = pixel_centers(tiles, view.columns)
    transparent = view.splats.shape[0] - 1

    def advance(state):
        step, transmittance, carry = state
        place = step * CHUNK + jnp.arange(CHUNK, dtype=jnp.int32)
        listed = view.ids[starts[:, None] + place[None]]
        ids = jnp.where(place[None] < counts[:, None], listed, transparent)
        splats = view.splats[ids]
        alphas = [_alphas(splats[:, i], pixels) for i in range(CHUNK)]
        weights, transmittance = _blend(transmittance, alphas)
        # Without the barrier, XLA computes the weights again for each channel of `composite`.
        weights = jax.lax.optimization_barrier(weights)
        return step + 1, transmittance, visit(carry, ids, weights, alphas)

    def unfinished(state):
        step, transmittance, _ = state
        # A maximum is faster than `any` in XLA. The first list of a group is the longest.
        return (step * CHUNK < counts[0]) & (jnp.max(transmittance) >= MIN_TRANSMITTANCE)

    start = (jnp.int32(0), jnp.ones(pixels.shape[:2], jnp.float32), carry)
    return jax.lax.while_loop(unfinished, advance, start)[2]


def lift(weights: Sequence[jax.Array], values: jax.Array) -> jax.Array:
    """Sum values (tiles, D, pixels) over each tile, once by each of C weights: (tiles, C, D)."""
    sums = [jnp.einsum("tp,tdp->td", weight, values, precision="highest") for weight in weights]
    return jnp.stack(sums, axis=1)


def pixel_centers(tiles: Array, columns: Array) -> jax.Array:
    """Pixel centres of tiles, shape (tiles, 64, 2)."""
    corner = TILE * jnp.stack([tiles % columns, tiles // columns], axis=-1)
    y, x = jnp.divmod(jnp.arange(TILE * TILE), TILE)
    return (corner[:, None, :] + jnp.stack([x, y], axis=-1)[None]).astype(jnp.float32) + 0.5


def groups(view: View) -> tuple[Array, ...]:
    """Tiles, starts and counts by group, each of shape (groups, lockstep)."""
    return tuple(x.reshape(-1, view.lockstep) for x in (view.tiles, view.starts, view.counts))


def in_parts(function: Callable[[View, Any], Value], view: View, values: Any) -> list[Value]:
    """Apply a function to parts of the tiles, and to all values, in at most eight threads.

    One part under `jax.jit`, on an accelerator, and in a thread, which shares the cores with other
    views. The number of parts divides that of the groups, so that they share compiled code.
    """
    traced = any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((view, values)))
    alone = threading.current_thread() is threading.main_thread()  # else others use the cores
    here: Any = jax.config  # settings that hold for this thread only
    bound = here.jax_default_device or here.jax_disable_jit or here.jax_enable_x64
    if traced or bound or not alone or jax.default_backend() != "cpu":
        return [function(view, values)]
    rows = dict(zip(("tiles", "starts", "counts"), map(np.asarray, groups(view)), strict=True))
    most = min(2 if len(view.splats) > LARGE else 8, len(usable_cores()))  # each part has its sums
    count = math.gcd(len(rows["tiles"]), 1 << (most.bit_length() - 1))

    def part(first: int) -> Value:
        own = {name: groups[first::count].ravel() for name, groups in rows.items()}
        return jax.block_until_ready(function(dataclasses.replace(view, **own), values))

    with ThreadPoolExecutor(count) as pool:
        return list(pool.map(part, range(count)))


def image_of(parts: list[tuple[jax.Array, jax.Array]], width: int, height: int) -> jax.Array:
    """Join the tiles of all parts, as of `in_row_major_order`, into an image (height, width, D)."""
    return join_tiles(in_row_major_order(parts), width, height)


@jax.jit
def in_row_major_order(parts: list[tuple[jax.Array, jax.Array]]) -> jax.Array:
    """Sort the pixels (T, D, 64) of tiles by their numbers (T,), given in several parts.

    Padding has the number T, so that the result has T + 1 rows.
    """
    tiles, pixels = map(jnp.concatenate, zip(*parts, strict=True))
    return jnp.zeros((len(pixels) + 1, *pixels.shape[1:]), jnp.float32).at[tiles].set(pixels)


@functools.partial(jax.jit, static_argnums=1)
def split_tiles(image: Array, padded: int) -> jax.Array:
    """Split an image (H, W, D) into tiles in row-major order, then blank ones, (padded + 1, D, 64).

    The number of tiles is padded to that of a view, whose padding points to the last tile.
    """
    height, width, channels = image.shape
    rows, columns = -(-height // TILE), -(-width // TILE)
    margin = ((0, rows * TILE - height), (0, columns * TILE - width), (0, 0))
    cells = jnp.pad(image, margin).reshape(rows, TILE, columns, TILE, channels)
    tiles = cells.transpose(0, 2, 4, 1, 3).reshape(rows * columns, channels, TILE * TILE)
    return jnp.pad(tiles, ((0, padded + 1 - rows * columns), (0, 0), (0, 0)))


@functools.partial(jax.jit, static_argnums=(1, 2))
def join_tiles(tiles: jax.Array, width: int, height: int) -> jax.Array:
    """Join tiles in row-major order, as of `split_tiles`, into an image (height, width, D)."""
    rows, columns = -(-height // TILE), -(-width // TILE)
    cells = tiles[: rows * columns].reshape(rows, columns, -1, TILE, TILE).transpose(0, 3, 1, 4, 2)
    return cells.reshape(rows * TILE, columns * TILE, -1)[:height, :width]
