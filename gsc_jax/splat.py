"""Splatting as linear algebra: `composite` computes W c, `accumulate` its adjoint W^T m.

W is the matrix of blending weights of a view. For a pixel p and the splats i that cover it, front
to back, W_pi = alpha_i prod_{j<i} (1 - alpha_j) (Kerbl et al. 2023, eq. 3; GS-Checker, eq. 9). It
depends on the scene and the camera only and is never stored: a group of 8 x 8 pixel tiles walks its
depth-sorted lists in lockstep, a chunk of splats at a time. The equations are written for one pixel
and vmapped. JAX cannot reverse the early-ending loop, so `composite` has a custom backward pass:
`accumulate` where only the features change, and else `derivatives`, which walks the same lists.
`tests/test_splat.py` and `tests/test_gradients.py` compare them with a float64 reference.
"""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.custom_derivatives import CustomVJPPrimal, SymbolicZero

from gsc_jax.render.projection import MIN_ALPHA, NEAR
from gsc_jax.render.spherical_harmonics import colors
from gsc_jax.render.tiles import TILE, View, make_view, require_view_of
from gsc_jax.scene import Array, Camera, Gaussians

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


# XLA vectorises over the last axis on a CPU, which therefore has to be that of the pixels:
# (tiles, splats, pixels).
_alphas = jax.vmap(jax.vmap(jax.vmap(alpha_at, (None, 0)), (0, None)))
_blend = jax.vmap(jax.vmap(blend_pixel, (0, 1), (1, 0)))


def _walk(view: View, group: tuple[Array, ...], visit: Callable, carry: Any) -> Any:
    """Walk the lists of a group of tiles until all of them end or every pixel has stopped.

    Each chunk updates the carry by `visit(carry, ids, weights, alphas)` with ids (tiles, C), and
    weights and alphas (tiles, C, pixels).
    """
    tiles, starts, counts = group
    pixels = _pixel_centers(tiles, view.grid[1])
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


def _pixel_centers(tiles: Array, columns: int) -> jax.Array:
    """Pixel centres of tiles, shape (tiles, 64, 2)."""
    corner = TILE * jnp.stack([tiles % columns, tiles // columns], axis=-1)
    y, x = jnp.divmod(jnp.arange(TILE * TILE), TILE)
    return (corner[:, None, :] + jnp.stack([x, y], axis=-1)[None]).astype(jnp.float32) + 0.5


def _groups(view: View) -> tuple[Array, ...]:
    return tuple(x.reshape(-1, view.lockstep) for x in (view.tiles, view.starts, view.counts))


def _require_rows(view: View, features: Array) -> None:
    count = view.splats.shape[0] - 1
    if features.ndim != 2 or features.shape[0] != count:
        raise ValueError(f"features must be ({count}, D), got {features.shape}")


@jax.custom_vjp
@jax.jit
def composite(view: View, features: jax.Array) -> jax.Array:
    """Blend features (N, D) front to back to an image (H, W, D): W c (GS-Checker, eq. 9).

    The image is 0 on pixels that no Gaussian covers. Differentiable with respect to the features,
    where the gradient is `accumulate`, and to `view.splats`.
    """
    _require_rows(view, features)
    padded = jnp.pad(features, ((0, 1), (0, 0)))

    def visit(image, ids, weights, _):
        # XLA fuses this product and sum; an einsum would become a batch of tiny matrix products.
        return image + jnp.sum(weights[:, :, None, :] * padded[ids][..., None], axis=1)

    def blend(group):
        blank = jnp.zeros((view.lockstep, features.shape[1], TILE * TILE))
        return _walk(view, group, visit, blank)

    blended = jax.lax.map(blend, _groups(view))
    return _join_tiles(view, blended.reshape(-1, *blended.shape[2:]))


@jax.jit
def accumulate(view: View, maps: jax.Array) -> jax.Array:
    """Sum maps (H, W, D) over the pixels with the weights of each Gaussian, shape (N, D): W^T m."""
    if maps.ndim != 3 or maps.shape[:2] != (view.height, view.width):
        raise ValueError(f"maps must be ({view.height}, {view.width}, D), got {maps.shape}")
    tiled = _split_tiles(view, maps)

    def gather(sums, group):
        values = tiled[group[0]]

        def visit(sums, ids, weights, _):
            weighted = jnp.einsum("tcp,tdp->tcd", weights, values, precision="highest")
            return sums.at[ids].add(weighted)

        return _walk(view, group, visit, sums), None

    sums = jnp.zeros((view.splats.shape[0], maps.shape[2]))
    return jax.lax.scan(gather, sums, _groups(view))[0][:-1]


@jax.jit
def derivatives(
    view: View, features: jax.Array, image: jax.Array, cotangent: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """Differentiate `composite` by the splats and by the features, in one walk front to back.

    With g the cotangent of a pixel and rest_i = g . (what is blended behind splat i),

        alpha_i dL/dalpha_i = w_i (g . c_i) - rest_i alpha_i / (1 - alpha_i),

    which is 0 where alpha is clamped or dropped. The rest is a running difference, since the image
    is known, so nothing is stored for a pixel and a splat.

    Args:
        view: The view that was composited.
        features: Its features, shape (N, D).
        image: Their image W c, shape (H, W, D).
        cotangent: Derivative of a loss by the image, shape (H, W, D).

    Returns:
        Derivatives of the loss by `view.splats`, (N + 1, 6), and by the features, (N, D).
    """
    splats = jnp.asarray(view.splats)
    tiled, along = _split_tiles(view, cotangent), jnp.sum(cotangent * image, axis=2, keepdims=True)
    rests, padded = _split_tiles(view, along)[:, 0], jnp.pad(features, ((0, 1), (0, 0)))
    y, x = np.divmod(np.arange(TILE * TILE, dtype=np.float32), TILE)
    monomials = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])

    def gather(sums, group):
        g, origin = tiled[group[0]], _pixel_centers(group[0], view.grid[1])[:, 0]

        def visit(carry, ids, weights, alphas):
            sums, rest = carry
            values = weights * jnp.sum(padded[ids][..., None] * g[:, None], axis=2)
            behind = rest[:, None] - jnp.cumsum(values, axis=1)
            slopes = values - behind * alphas / (1.0 - alphas)
            slopes = jnp.where((weights > 0) & (alphas < MAX_ALPHA), slopes, 0.0)
            moments = jnp.einsum("tcp,mp->tcm", slopes, monomials, precision="highest")
            moments = _about(moments, splats[ids, :2] - origin[:, None])
            weighted = jnp.einsum("tcp,tdp->tcd", weights, g, precision="highest")
            sums = sums.at[ids].add(jnp.concatenate([moments, weighted], axis=2))
            return sums, behind[:, -1]

        return _walk(view, group, visit, (sums, rests[group[0]]))[0], None

    sums = jnp.zeros((view.splats.shape[0], 6 + features.shape[1]))
    sums = jax.lax.scan(gather, sums, _groups(view))[0]
    return _by_splat(splats, sums[:, :6]), sums[:-1, 6:]


def _about(moments: jax.Array, center: jax.Array) -> jax.Array:
    """Moments 1, x, y, xx, xy, yy (..., 6) about a centre (..., 2) instead of the origin."""
    m, x, y, xx, xy, yy = jnp.moveaxis(moments, -1, 0)
    u, v = jnp.moveaxis(center, -1, 0)
    first, second = x - u * m, y - v * m
    squares = xx - u * (x + first), xy - u * y - v * first, yy - v * (y + second)
    return jnp.stack([m, first, second, *squares], axis=-1)


def _by_splat(splats: jax.Array, moments: jax.Array) -> jax.Array:
    """Derivatives by the rows of the table, from the moments of alpha dL/dalpha, (N + 1, 6).

    sigma = (a dx + b dy)^2 + (c dy)^2, and log alpha = log o - sigma.
    """
    _, _, a, b, c, _ = splats.T
    m, x, y, xx, xy, yy = moments.T
    first, second = a * x + b * y, c * y
    by_a, by_b = a * xx + b * xy, a * xy + b * yy
    rows = a * first, b * first + c * second, -by_a, -by_b, -c * yy, 0.5 * m
    return 2 * jnp.stack(rows, axis=1)


def _forward(view: Any, features: CustomVJPPrimal) -> tuple[jax.Array, tuple]:
    """Keep what the backward pass needs: `accumulate` suffices where only features change."""
    known = jax.tree.map(lambda leaf: leaf.value, (view, features))
    image = composite(*known)
    return image, (*known, image if view.splats.perturbed else None)


def _backward(saved: tuple, cotangent: jax.Array) -> tuple[View | None, jax.Array]:
    view, features, image = saved
    if isinstance(cotangent, SymbolicZero):
        cotangent = jnp.zeros(cotangent.shape, cotangent.dtype)
    if image is None:
        return None, accumulate(view, cotangent)
    by_splats, by_features = derivatives(view, features, image, cotangent)
    nothing = dict.fromkeys(("ids", "tiles", "starts", "counts"))
    return dataclasses.replace(view, splats=by_splats, **nothing), by_features


composite.defvjp(_forward, _backward, symbolic_zeros=True)


def _split_tiles(view: View, image: jax.Array) -> jax.Array:
    """Split an image (H, W, D) into tiles (tiles + 1, D, 64), the last one blank for padding."""
    rows, columns = view.grid
    margin = ((0, rows * TILE - view.height), (0, columns * TILE - view.width), (0, 0))
    cells = jnp.pad(image, margin).reshape(rows, TILE, columns, TILE, -1)
    tiles = cells.transpose(0, 2, 4, 1, 3).reshape(rows * columns, -1, TILE * TILE)
    return jnp.pad(tiles, ((0, 1), (0, 0), (0, 0)))


def _join_tiles(view: View, blended: jax.Array) -> jax.Array:
    """Join tiles (padded tiles, D, 64), in the order of `view.tiles`, into an image (H, W, D)."""
    rows, columns = view.grid
    tiles = jnp.zeros((rows * columns + 1, *blended.shape[1:])).at[view.tiles].set(blended)[:-1]
    cells = tiles.reshape(rows, columns, -1, TILE, TILE).transpose(0, 3, 1, 4, 2)
    return cells.reshape(rows * TILE, columns * TILE, -1)[: view.height, : view.width]


def composite_with_alpha(view: View, features: Array) -> tuple[jax.Array, jax.Array]:
    """Blend features (N, D) and a column of ones: image W c, (H, W, D), and alpha W 1, (H, W)."""
    features = jnp.asarray(features, jnp.float32)
    _require_rows(view, features)
    blended = composite(view, jnp.concatenate([features, jnp.ones_like(features[:, :1])], axis=1))
    return blended[..., :-1], blended[..., -1]


def require_finite(name: str, values: jax.Array) -> jax.Array:
    """Return the values; raise ValueError if one is not finite: 0 * NaN would fill the image."""
    # Traced values, as under `jax.grad`, are not known yet.
    if not isinstance(values, Tracer) and not np.isfinite(values).all():
        raise ValueError(f"{name} must be finite")
    return values


def render_features(
    gaussians: Gaussians, camera: Camera, features: Array, *, near: float = NEAR
) -> tuple[jax.Array, jax.Array]:
    """Render any features of the Gaussians.

    Args:
        gaussians: N Gaussians.
        camera: Pose, intrinsics and image size.
        features: One row per Gaussian, shape (N, D).
        near: Near plane in world units.

    Returns:
        Image (H, W, D), not divided by alpha, and alpha (H, W).

    Raises:
        ValueError: if the number of rows is not N, or a feature is not finite.
    """
    features = require_finite("features", jnp.asarray(features, jnp.float32))
    return composite_with_alpha(make_view(gaussians, camera, near=near), features)


def render(
    gaussians: Gaussians,
    camera: Camera,
    *,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    near: float = NEAR,
) -> tuple[jax.Array, jax.Array]:
    """Render a scene; `jax.grad` and `jax.vjp` differentiate it by the Gaussians and the camera.

    Args:
        gaussians: N Gaussians.
        camera: Pose, intrinsics and image size.
        background: RGB in [0, 1] behind the scene.
        near: Near plane in world units.

    Returns:
        RGB (H, W, 3) in [0, 1] and alpha (H, W) in [0, 1].

    Raises:
        TypeError: under `jax.jit` or `jax.vmap`; see `render_view`.
        ValueError: if the background is no colour in [0, 1].
    """
    if np.shape(background) != (3,) or not all(0 <= channel <= 1 for channel in background):
        raise ValueError(f"background must be three numbers in [0, 1], got {background}")
    view = make_view(gaussians, camera, near=near)
    return render_view(view, gaussians, camera, background=background)


def render_view(
    view: View,
    gaussians: Gaussians,
    camera: Camera,
    *,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[jax.Array, jax.Array]:
    """Render a scene as `render` does, given the view that `make_view` has built for it.

    Under `jax.jit`, derivatives need `reprojected(view, gaussians, camera)` as the view.

    Raises:
        ValueError: if the view is one of another number of Gaussians or of another image size.
    """
    require_view_of(view, gaussians, camera)
    rgb, alpha = composite_with_alpha(view, colors(gaussians.sh, gaussians.means, camera.center))
    behind = (1.0 - alpha)[..., None] * jnp.asarray(background, jnp.float32)[None, None]
    return jnp.minimum(rgb + behind, 1.0), alpha


def accumulate_maps(
    gaussians: Gaussians, camera: Camera, maps: Array, *, near: float = NEAR
) -> jax.Array:
    """Lift maps to the Gaussians: the adjoint of `render_features`.

    Exported as `gsc_jax.accumulate`.

    Args:
        gaussians: N Gaussians.
        camera: Pose, intrinsics and image size.
        maps: One value per pixel and channel, shape (H, W, D).
        near: Near plane in world units.

    Returns:
        Sums over the pixels, weighted by blending weight, shape (N, D); 0 for Gaussians that are
        not visible.

    Raises:
        ValueError: if the maps do not have the size of the image, or a value is not finite.
    """
    maps = require_finite("maps", jnp.asarray(maps, jnp.float32))
    return accumulate(make_view(gaussians, camera, near=near), maps)
