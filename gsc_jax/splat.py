"""Splatting as linear algebra: `composite` computes W c, `accumulate` its adjoint W^T m.

W is the matrix of blending weights of a view. For a pixel p and the splats i that cover it, front
to back, W_pi = alpha_i prod_{j<i} (1 - alpha_j) (Kerbl et al. 2023, eq. 3; GS-Checker, eq. 9). It
depends on the scene and the camera only and is never stored: a group of 8 x 8 pixel tiles walks its
depth-sorted lists in lockstep, a chunk of splats at a time. The equations are written for one pixel
and vmapped. JAX cannot reverse the early-ending loop, so `composite` has a custom backward pass:
`accumulate` where only the features change, and else `derivatives`, which walks the same lists.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.custom_derivatives import CustomVJPPrimal, SymbolicZero

from gsc_jax.render.derivatives import derivatives
from gsc_jax.render.projection import NEAR, project
from gsc_jax.render.reprojection import require_view_of
from gsc_jax.render.spherical_harmonics import colors
from gsc_jax.render.tiles import TILE, View, make_view
from gsc_jax.render.walk import groups, image_of, in_parts, lift, split_tiles, walk
from gsc_jax.scene import Array, Camera, Gaussians


def _require_rows(view: View, features: Array) -> None:
    count = view.splats.shape[0] - 1
    if features.ndim != 2 or features.shape[0] != count or not features.shape[1]:
        raise ValueError(f"features must be ({count}, D) with D > 0, got {features.shape}")


@jax.custom_vjp
def composite(view: View, features: jax.Array) -> jax.Array:
    """Blend features (N, D) front to back to an image (H, W, D): W c (GS-Checker, eq. 9).

    The image is 0 on pixels that no Gaussian covers. Differentiable with respect to the features,
    where the gradient is `accumulate`, and to `view.splats`.
    """
    _require_rows(view, features)
    return image_of(in_parts(_blended, view.of_any_size, features), view.width, view.height)


@jax.jit
def _blended(view: View, features: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The numbers (T,) of the tiles of a view, and their part of the image, shape (T, D, 64)."""
    padded = jnp.pad(features, ((0, 1), (0, 0)))

    def visit(image, ids, weights, _):
        # XLA fuses this; an einsum would become a batch of tiny matrix products.
        pairs = zip(weights, padded[ids].swapaxes(0, 1), strict=True)
        return image + sum(w[:, None] * f[..., None] for w, f in pairs)

    def blend(group):
        shape = view.lockstep, features.shape[1], TILE * TILE
        return walk(view, group, visit, jnp.zeros(shape, jnp.float32))

    blended = jax.lax.map(blend, groups(view))
    return jnp.asarray(view.tiles), blended.reshape(-1, *blended.shape[2:])


@jax.custom_vjp
def accumulate(view: View, maps: jax.Array) -> jax.Array:
    """Sum maps (H, W, D) over the pixels with the weights of each Gaussian, shape (N, D): W^T m.

    Differentiable with respect to the maps, where the gradient is `composite`, and `view.splats`.
    """
    if maps.ndim != 3 or maps.shape[:2] != (view.height, view.width):
        raise ValueError(f"maps must be ({view.height}, {view.width}, D), got {maps.shape}")
    parts = in_parts(_lifted, view.of_any_size, split_tiles(maps, len(view.tiles)))
    return sum(parts[1:], parts[0])


@jax.jit
def _lifted(view: View, tiled: jax.Array) -> jax.Array:
    """The sums over tiles (padded tiles + 1, D, 64) of a map, shape (N, D)."""

    def gather(sums, group):
        values = tiled[group[0]]

        def visit(sums, ids, weights, _):
            return sums.at[ids].add(lift(weights, values))

        return walk(view, group, visit, sums), None

    sums = jnp.zeros((view.splats.shape[0], tiled.shape[1]), jnp.float32)
    return jax.lax.scan(gather, sums, groups(view))[0][:-1]


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
    return _only_splats(view, by_splats), by_features


def _only_splats(view: View, by_splats: jax.Array) -> View:
    """Derivatives by a view, of which only the splats have any."""
    nothing = dict.fromkeys(("ids", "tiles", "starts", "counts", "columns"))
    return dataclasses.replace(view, splats=by_splats, **nothing)


def _accumulate_forward(view: Any, maps: CustomVJPPrimal) -> tuple[jax.Array, tuple]:
    known = jax.tree.map(lambda leaf: leaf.value, (view, maps))
    return accumulate(*known), (known[0], known[1] if view.splats.perturbed else None)


def _accumulate_backward(saved: tuple, cotangent: jax.Array) -> tuple[View | None, jax.Array]:
    """The gradient of <s, W^T m> is that of <W s, m>: W s by the maps, as above by the splats."""
    view, maps = saved
    if isinstance(cotangent, SymbolicZero):
        cotangent = jnp.zeros(cotangent.shape, cotangent.dtype)
    image = composite(view, cotangent)
    if maps is None:
        return None, image
    return _only_splats(view, derivatives(view, cotangent, image, maps)[0]), image


composite.defvjp(_forward, _backward, symbolic_zeros=True)
accumulate.defvjp(_accumulate_forward, _accumulate_backward, symbolic_zeros=True)


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


Colour = tuple[float, float, float]
BLACK: Colour = (0.0, 0.0, 0.0)
Cameras = Camera | Sequence[Camera]
"""A camera, or V cameras of one image size, whose images are stacked along a first axis V."""


def _stacked(render_one: Callable[[Camera], Any], cameras: Sequence[Camera]) -> Any:
    """Stack what a function returns for each of several cameras of one image size."""
    cameras = list(cameras)
    sizes = sorted({f"{camera.width} x {camera.height}" for camera in cameras})
    if len(sizes) != 1:
        found = f"images of {' and '.join(sizes[:2])} pixels" if sizes else "none"
        raise ValueError(f"expected a camera, or cameras of one image size to stack, got {found}")
    return jax.tree.map(lambda *images: jnp.stack(images), *map(render_one, cameras))


def render_features(
    gaussians: Gaussians, camera: Cameras, features: Array, *, near: float = NEAR
) -> tuple[jax.Array, jax.Array]:
    """Render any features of the Gaussians.

    Args:
        gaussians: N Gaussians.
        camera: Pose, intrinsics and image size; or V cameras of one size, which add a first axis V.
        features: One row per Gaussian, shape (N, D).
        near: Near plane in world units.

    Returns:
        Image (H, W, D), not divided by alpha, and alpha (H, W).

    Raises:
        ValueError: if the number of rows is not N, a feature is not finite, or image sizes differ.
    """
    if not isinstance(camera, Camera):
        return _stacked(lambda one: render_features(gaussians, one, features, near=near), camera)
    features = require_finite("features", jnp.asarray(features, jnp.float32))
    return composite_with_alpha(make_view(gaussians, camera, near=near), features)


def render_depth(
    gaussians: Gaussians, camera: Cameras, *, near: float = NEAR
) -> tuple[jax.Array, jax.Array]:
    """Render the expected depth, differentiable like `render`.

    Args:
        gaussians: N Gaussians.
        camera: Pose, intrinsics and image size; or V cameras of one size, which add a first axis V.
        near: Near plane in world units.

    Returns:
        Mean depth (H, W) along the optical axis in world units, by blending weight, and alpha.

    Raises:
        TypeError: if `jax.jit` or `jax.vmap` traces the Gaussians or the camera.
        ValueError: if image sizes differ.
    """
    if not isinstance(camera, Camera):
        return _stacked(lambda one: render_depth(gaussians, one, near=near), camera)
    depths = project(gaussians, camera, near=near).depths[:, None]
    blended, alpha = composite_with_alpha(make_view(gaussians, camera, near=near), depths)
    return blended[..., 0] / jnp.where(alpha > 0, alpha, 1.0), alpha


def render(
    gaussians: Gaussians, camera: Cameras, *, background: Colour = BLACK, near: float = NEAR
) -> tuple[jax.Array, jax.Array]:
    """Render a scene; `jax.grad` and `jax.vjp` differentiate it by the Gaussians and the camera.

    Args:
        gaussians: N Gaussians.
        camera: Pose, intrinsics and image size; or V cameras of one size, which add a first axis V.
        background: RGB in [0, 1] behind the scene.
        near: Near plane in world units.

    Returns:
        RGB (H, W, 3) in [0, 1] and alpha (H, W) in [0, 1].

    Raises:
        TypeError: if `jax.jit` or `jax.vmap` traces the Gaussians or the camera; see `render_view`.
        ValueError: if the background is no colour in [0, 1], or image sizes differ.
    """
    if not isinstance(camera, Camera):
        settings = {"background": background, "near": near}
        return _stacked(lambda one: render(gaussians, one, **settings), camera)
    view = make_view(gaussians, camera, near=near)
    return render_view(view, gaussians, camera, background=background)


def render_view(
    view: View, gaussians: Gaussians, camera: Camera, *, background: Colour = BLACK
) -> tuple[jax.Array, jax.Array]:
    """Render a scene as `render` does, given the view that `make_view` has built for it.

    Args:
        view: View of the N Gaussians; for derivatives by all of their attributes, it has to be
            `reprojected(view, gaussians, camera)`.
        gaussians: N Gaussians.
        camera: The camera of the view.
        background: RGB in [0, 1] behind the scene.

    Returns:
        RGB (H, W, 3) in [0, 1] and alpha (H, W) in [0, 1].

    Raises:
        ValueError: if the view is one of another number of Gaussians or of another image size, or
            the background is no colour in [0, 1].
    """
    traced = isinstance(background, Tracer)
    if np.shape(background) != (3,) or not (traced or all(0 <= x <= 1 for x in background)):
        raise ValueError(f"background must be three numbers in [0, 1], got {background}")
    require_view_of(view, gaussians, camera)
    rgb, alpha = composite_with_alpha(view, colors(gaussians.sh, gaussians.means, camera.center))
    behind = (1.0 - alpha)[..., None] * jnp.asarray(background, jnp.float32)[None, None]
    return jnp.minimum(rgb + behind, 1.0), alpha


def accumulate_maps(
    gaussians: Gaussians, camera: Cameras, maps: Array | Sequence[Array], *, near: float = NEAR
) -> jax.Array:
    """Lift maps to the Gaussians, the adjoint of `render_features`; it is `gsc_jax.accumulate`.

    Args:
        gaussians: N Gaussians.
        camera: Pose, intrinsics and image size; or V cameras, over which the sums go, too.
        maps: One value per pixel and channel, shape (H, W, D); V of them for V cameras.
        near: Near plane in world units.

    Returns:
        Sums over the pixels by blending weight, shape (N, D); 0 for Gaussians that are not visible.

    Raises:
        ValueError: if the maps do not have the size of the image, or a value is not finite.
    """
    if not isinstance(camera, Camera):
        if len(maps) != len(cameras := list(camera)) or not cameras:
            raise ValueError(f"expected V cameras and V maps, got {len(cameras)} and {len(maps)}")
        pairs = zip(cameras, maps, strict=True)
        return jnp.stack([accumulate_maps(gaussians, *pair, near=near) for pair in pairs]).sum(0)
    maps = require_finite("maps", jnp.asarray(maps, jnp.float32))
    return accumulate(make_view(gaussians, camera, near=near), maps)
