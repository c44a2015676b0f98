"""The walk: blending weights of a group of tiles, a chunk of splats at a time, front to back."""

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from gsc_jax.render.projection import MIN_ALPHA
from gsc_jax.render.tiles import TILE, View
from gsc_jax.scene import Array

MAX_ALPHA = 0.99
"""Largest opacity of a splat at a pixel, that of the INRIA rasteriser."""
MIN_TRANSMITTANCE = 1e-4
"""A pixel stops before its transmittance would fall below this, as in the INRIA rasteriser."""
CHUNK = 8
"""Splats per iteration of the loop: longer chunks spend more on the cumulative product, shorter
ones on launching operations."""


def alpha_at(splat: jax.Array, pixel: jax.Array) -> jax.Array:
    """Compute alpha = min(0.99, o exp(-sigma)), or 0 below 1/255, of a splat at a pixel (2,).

    The splat has shape (6,): mean x y, whitening a b c, and log opacity.
    """
    dx, dy = pixel[0] - splat[0], pixel[1] - splat[1]
    sigma = (splat[2] * dx + splat[3] * dy) ** 2 + (splat[4] * dy) ** 2
    alpha = jnp.exp(splat[5] - sigma)
    return jnp.where(alpha >= MIN_ALPHA, jnp.minimum(MAX_ALPHA, alpha), 0.0)


def blend_pixel(transmittance: jax.Array, alphas: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Compute the weights (C,) of the next splats of a pixel, and the transmittance behind them.

    alpha_i prod_{j<i} (1 - alpha_j) is the difference of two successive products, with a relative
    rounding error of 1e-5 at alpha = 1/255. It is exactly 0 where alpha is 0, because the products
    are formed one factor at a time and subtracted before the transmittance is multiplied in.
    """
    through = jnp.cumprod(1.0 - alphas)
    before = jnp.concatenate([jnp.ones_like(through[:1]), through[:-1]])
    stays = transmittance * through >= MIN_TRANSMITTANCE
    return jnp.where(stays, transmittance * (before - through), 0.0), transmittance * through[-1]


# The axes are (tiles, splats, pixels): on a CPU, XLA vectorises over the last one, the longest.
_alphas = jax.vmap(jax.vmap(jax.vmap(alpha_at, (None, 0)), (0, None)))
_blend = jax.vmap(jax.vmap(blend_pixel, (0, 1), (1, 0)))


def walk(view: View, group: tuple[Array, ...], visit: Callable, carry: Any) -> Any:
    """Walk the lists of a group of tiles until all of them end or every pixel has stopped.

    Each chunk updates the carry by `visit(carry, ids, weights, alphas)` with ids (tiles, C), and
    weights and alphas (tiles, C, pixels).
    """
    tiles, starts, counts = group
    pixels = pixel_centers(tiles, view.columns)
    transparent = view.splats.shape[0] - 1

    def advance(state):
        step, transmittance, carry = state
        place = step * CHUNK + jnp.arange(CHUNK)
        listed = view.ids[starts[:, None] + place[None]]
        ids = jnp.where(place[None] < counts[:, None], listed, transparent)
        alphas = _alphas(view.splats[ids], pixels)
        weights, transmittance = _blend(transmittance, alphas)
        # Without the barrier, XLA moves a transposition of the weights into the contraction that
        # follows in `accumulate`, which then is slow on a CPU.
        weights = jax.lax.optimization_barrier(weights)
        return step + 1, transmittance, visit(carry, ids, weights, alphas)

    def unfinished(state):
        step, transmittance, _ = state
        # A maximum is faster than `any` in XLA. The first list of a group is the longest.
        return (step * CHUNK < counts[0]) & (jnp.max(transmittance) >= MIN_TRANSMITTANCE)

    start = (jnp.int32(0), jnp.ones(pixels.shape[:2]), carry)
    return jax.lax.while_loop(unfinished, advance, start)[2]


def pixel_centers(tiles: Array, columns: Array) -> jax.Array:
    """Pixel centres of tiles, shape (tiles, 64, 2)."""
    corner = TILE * jnp.stack([tiles % columns, tiles // columns], axis=-1)
    y, x = jnp.divmod(jnp.arange(TILE * TILE), TILE)
    return (corner[:, None, :] + jnp.stack([x, y], axis=-1)[None]).astype(jnp.float32) + 0.5


def groups(view: View) -> tuple[Array, ...]:
    """Tiles, starts and counts by group, each of shape (groups, lockstep)."""
    return tuple(x.reshape(-1, view.lockstep) for x in (view.tiles, view.starts, view.counts))


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
