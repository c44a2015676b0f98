"""The blending matrix W of a view, applied: `composite` is W c, `accumulate` its adjoint W^t m.

For a pixel p and the splats i that cover it, front to back, W_pi = alpha_i prod_{j<i} (1 - alpha_j)
(Kerbl et al. 2023, eq. 3; GS-Checker's rendered attribute, eq. 9). W depends on the scene and the
camera only. It is never built: tiles of 8 x 8 pixels walk their depth-sorted lists in lockstep, a
chunk of splats at a time, and what happens to a pixel is written once for one pixel and vmapped.
The loop ends early, so JAX cannot reverse through it; `composite` is given `accumulate` as its
backward pass instead, with respect to the features only: the method never moves a Gaussian.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from gsc_jax.render.projection import MIN_ALPHA, NEAR
from gsc_jax.render.spherical_harmonics import colors
from gsc_jax.render.tiles import TILE, View, make_view
from gsc_jax.scene import Array, Camera, Gaussians

MAX_ALPHA = 0.99
MIN_TRANSMITTANCE = 1e-4
"""A pixel stops before its transmittance would fall below this."""
CHUNK = 8
"""Splats per step of the lockstep loop: in longer chunks the cumulative product costs more than its
share, in shorter ones the launch of every operation does."""


def alpha_at(splat: jax.Array, pixel: jax.Array) -> jax.Array:
    """Opacity of one splat at one pixel centre.

    Args:
        splat: Mean x y, whitening a b c and log opacity, shape (6,).
        pixel: x and y in pixels, shape (2,).

    Returns:
        min(0.99, o exp(-sigma)), and 0 where that is below 1/255.
    """
    dx, dy = pixel[0] - splat[0], pixel[1] - splat[1]
    sigma = (splat[2] * dx + splat[3] * dy) ** 2 + (splat[4] * dy) ** 2
    alpha = jnp.exp(splat[5] - sigma)
    return jnp.where(alpha >= MIN_ALPHA, jnp.minimum(MAX_ALPHA, alpha), 0.0)


def blend_pixel(transmittance: jax.Array, alphas: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Blending weights of the next splats of one pixel, front to back: the light each takes away.

    alpha_i prod_{j<i} (1 - alpha_j) is the difference of two neighbouring products, right to a
    rounding of the light: at alpha = 1/255 to 1e-5 of itself. It is exactly 0 where alpha is, for
    the products are formed one factor after the other, and subtracted before the transmittance is
    multiplied in.

    Args:
        transmittance: What is left of the light, scalar; below 1e-4 once the pixel has stopped.
        alphas: Opacities of the next C splats at this pixel, shape (C,).

    Returns:
        Weights W_pi of these splats, shape (C,), and the transmittance behind the last one.
    """
    through = jnp.cumprod(1.0 - alphas)
    before = jnp.concatenate([jnp.ones_like(through[:1]), through[:-1]])
    stays = transmittance * through >= MIN_TRANSMITTANCE
    return jnp.where(stays, transmittance * (before - through), 0.0), transmittance * through[-1]


# With the pixels as the last axis, (tiles, splats, pixels), XLA vectorises over them on a CPU; with
# the natural order (tiles, pixels, splats) it does not.
_alphas = jax.vmap(jax.vmap(jax.vmap(alpha_at, (None, 0)), (0, None)))
_blend = jax.vmap(jax.vmap(blend_pixel, (0, 1), (1, 0)))


def _walk(view: View, group: tuple[Array, ...], visit: Callable, carry: Any) -> Any:
    """Walk the lists of a group of tiles in lockstep until they end or every pixel has stopped.

    `visit(carry, ids, weights)` sees each chunk: ids (tiles, C), weights (tiles, C, pixels).
    """
    tiles, starts, counts = group
    pixels = _pixel_centers(tiles, view.grid[1])
    empty = view.splats.shape[0] - 1

    def advance(state):
        step, transmittance, carry = state
        place = step * CHUNK + jnp.arange(CHUNK)
        listed = view.ids[starts[:, None] + place[None]]
        ids = jnp.where(place[None] < counts[:, None], listed, empty)
        weights, transmittance = _blend(transmittance, _alphas(view.splats[ids], pixels))
        # Without the barrier XLA moves a transposition of the weights into the contraction that
        # follows in `accumulate`, which then is slow on a CPU.
        weights = jax.lax.optimization_barrier(weights)
        return step + 1, transmittance, visit(carry, ids, weights)

    def unfinished(state):
        step, transmittance, _ = state
        # XLA finds the largest of them faster than whether any is large.
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
    """Blend features front to back: W c.

    Differentiable with respect to the features; the gradient is `accumulate`.

    Args:
        view: The scene as a camera sees it.
        features: A row per Gaussian, shape (N, D).

    Returns:
        Image, shape (H, W, D); 0 on pixels that no Gaussian covers.

    Raises:
        ValueError: if there is not one row per Gaussian.
    """
    _require_rows(view, features)
    padded = jnp.pad(features, ((0, 1), (0, 0)))

    def visit(image, ids, weights):
        # XLA fuses a product and a sum; an einsum would be a batch of tiny matrix products.
        return image + jnp.sum(weights[:, :, None, :] * padded[ids][..., None], axis=1)

    def blend(group):
        blank = jnp.zeros((view.lockstep, features.shape[1], TILE * TILE))
        return _walk(view, group, visit, blank)

    blended = jax.lax.map(blend, _groups(view))
    return _image_of(view, blended.reshape(-1, *blended.shape[2:]))


@jax.jit
def accumulate(view: View, maps: jax.Array) -> jax.Array:
    """Sum maps over the pixels of each Gaussian, weighted by what it contributes: W^t m.

    Args:
        view: The scene as a camera sees it.
        maps: A value per pixel, shape (H, W, D).

    Returns:
        A row per Gaussian, shape (N, D); 0 for those that the view does not see.

    Raises:
        ValueError: if the maps do not have the size of the image.
    """
    if maps.ndim != 3 or maps.shape[:2] != (view.height, view.width):
        raise ValueError(f"maps must be ({view.height}, {view.width}, D), got {maps.shape}")
    tiled = _tiles_of(view, maps)

    def gather(sums, group):
        values = tiled[group[0]]

        def visit(sums, ids, weights):
            return sums.at[ids].add(
                jnp.einsum("tcp,tdp->tcd", weights, values, precision="highest")
            )

        return _walk(view, group, visit, sums), None

    sums = jnp.zeros((view.splats.shape[0], maps.shape[2]))
    return jax.lax.scan(gather, sums, _groups(view))[0][:-1]


composite.defvjp(
    lambda view, features: (composite(view, features), view),
    lambda view, cotangent: (None, accumulate(view, cotangent)),
)


def _tiles_of(view: View, image: jax.Array) -> jax.Array:
    """Cut an image (H, W, D) into tiles (tiles + 1, D, 64), the last one blank for the padding."""
    rows, columns = view.grid
    margin = ((0, rows * TILE - view.height), (0, columns * TILE - view.width), (0, 0))
    cells = jnp.pad(image, margin).reshape(rows, TILE, columns, TILE, -1)
    tiles = cells.transpose(0, 2, 4, 1, 3).reshape(rows * columns, -1, TILE * TILE)
    return jnp.pad(tiles, ((0, 1), (0, 0), (0, 0)))


def _image_of(view: View, blended: jax.Array) -> jax.Array:
    """Put tiles (padded tiles, D, 64), in the order of `view.tiles`, together to an image."""
    rows, columns = view.grid
    tiles = jnp.zeros((rows * columns + 1, *blended.shape[1:])).at[view.tiles].set(blended)[:-1]
    cells = tiles.reshape(rows, columns, -1, TILE, TILE).transpose(0, 3, 1, 4, 2)
    return cells.reshape(rows * TILE, columns * TILE, -1)[: view.height, : view.width]


def composite_with_alpha(view: View, features: Array) -> tuple[jax.Array, jax.Array]:
    """Blend features, and with them a column of ones: W c and alpha = W 1.

    Args:
        view: The scene as a camera sees it.
        features: A row per Gaussian, shape (N, D).

    Returns:
        Image (H, W, D) and alpha (H, W).

    Raises:
        ValueError: if there is not one row per Gaussian.
    """
    features = jnp.asarray(features, jnp.float32)
    _require_rows(view, features)
    blended = composite(view, jnp.concatenate([features, jnp.ones_like(features[:, :1])], axis=1))
    return blended[..., :-1], blended[..., -1]


def render_features(
    gaussians: Gaussians, camera: Camera, features: Array, *, near: float = NEAR
) -> tuple[jax.Array, jax.Array]:
    """Render any features of the Gaussians.

    Args:
        gaussians: N Gaussians.
        camera: The view.
        features: A row per Gaussian, shape (N, D).
        near: Near plane in world units.

    Returns:
        Image (H, W, D), not divided by alpha, and alpha (H, W).

    Raises:
        ValueError: if there is not one row per Gaussian.
    """
    return composite_with_alpha(make_view(gaussians, camera, near=near), features)


def render(
    gaussians: Gaussians,
    camera: Camera,
    *,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    near: float = NEAR,
) -> tuple[jax.Array, jax.Array]:
    """Render a scene.

    Args:
        gaussians: N Gaussians.
        camera: The view.
        background: Colour behind the scene, RGB in [0, 1].
        near: Near plane in world units.

    Returns:
        RGB (H, W, 3) in [0, 1] and alpha (H, W) in [0, 1].
    """
    return shade(make_view(gaussians, camera, near=near), gaussians, camera, background=background)


def shade(
    view: View,
    gaussians: Gaussians,
    camera: Camera,
    *,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> tuple[jax.Array, jax.Array]:
    """Render a scene whose view has been made: the second half of `render`."""
    rgb, alpha = composite_with_alpha(view, colors(gaussians.sh, gaussians.means, camera.center))
    behind = (1.0 - alpha)[..., None] * jnp.asarray(background, jnp.float32)[None, None]
    return jnp.minimum(rgb + behind, 1.0), alpha


def accumulate_maps(
    gaussians: Gaussians, camera: Camera, maps: Array, *, near: float = NEAR
) -> jax.Array:
    """Lift maps of a view to the Gaussians, weighted by what each contributes to each pixel.

    The adjoint of `render_features`; exported as `gsc_jax.accumulate`.

    Args:
        gaussians: N Gaussians.
        camera: The view.
        maps: A value per pixel, shape (H, W, D).
        near: Near plane in world units.

    Returns:
        Sums, shape (N, D); 0 for Gaussians that the view does not see.

    Raises:
        ValueError: if the maps do not have the size of the image.
    """
    maps = jnp.asarray(maps, jnp.float32)
    return accumulate(make_view(gaussians, camera, near=near), maps)
