"""Derivatives of a composited image by the splats, in the walk of the forward pass.

`composite` of gsc_jax.splat uses them as its backward pass; docs/gradients.md tells how to use it.
"""

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.render.tiles import TILE, View
from gsc_jax.render.walk import MAX_ALPHA, groups, in_parts, lift, pixel_centers, split_tiles, walk
from gsc_jax.scene import Array


def derivatives(
    view: View, features: jax.Array, image: Array, cotangent: Array
) -> tuple[jax.Array, jax.Array]:
    """Differentiate `composite` by the splats and by the features, in one walk front to back.

    With g the cotangent of a pixel and rest_i = g . (what is blended behind splat i),

        alpha_i dL/dalpha_i = w_i (g . c_i) - rest_i alpha_i / (1 - alpha_i),

    which is 0 where alpha is clamped or dropped. The rest is a running difference, since the image
    is known, so nothing is stored for a pixel and a splat.

    The features have shape (N, D), their image W c and its cotangent (H, W, D). Returns the
    derivatives by `view.splats`, (N + 1, 6), and by the features, (N, D).
    """
    tiled = [split_tiles(maps, len(view.tiles)) for maps in (image, cotangent)]
    parts = in_parts(_moments, view.of_any_size, (features, *tiled))
    sums = sum(parts[1:], parts[0])
    return _by_splat(jnp.asarray(view.splats), sums[:, :6]), sums[:-1, 6:]


@jax.jit
def _moments(view: View, values: tuple[jax.Array, jax.Array, jax.Array]) -> jax.Array:
    """Moments of alpha dL/dalpha about each splat, and dL/dfeatures, shape (N + 1, 6 + D).

    The values are the features, and the image and its cotangent in tiles, (tiles + 1, D, 64).
    """
    features, blended, tiled = values
    splats, padded = jnp.asarray(view.splats), jnp.pad(features, ((0, 1), (0, 0)))
    rests = jnp.sum(tiled * blended, axis=1)
    y, x = np.divmod(np.arange(TILE * TILE, dtype=np.float32), TILE)
    monomials = np.stack([np.ones_like(x), x, y, x * x, x * y, y * y])

    def gather(sums, group):
        g, origin = tiled[group[0]], pixel_centers(group[0], view.columns)[:, 0]

        def visit(carry, ids, weights, alphas):
            (sums, rest), slopes = carry, []
            for w, alpha, c in zip(weights, alphas, jnp.moveaxis(padded[ids], 1, 0), strict=True):
                value = w * sum(c[:, d, None] * g[:, d] for d in range(g.shape[1]))
                rest -= value
                slope = value - rest * alpha / (1.0 - alpha)
                slopes.append(jnp.where((w > 0) & (alpha < MAX_ALPHA), slope, 0.0))
            slopes = jnp.stack(slopes, axis=1)
            moments = jnp.einsum("tcp,mp->tcm", slopes, monomials, precision="highest")
            moments = _about(moments, splats[ids, :2] - origin[:, None])
            return sums.at[ids].add(jnp.concatenate([moments, lift(weights, g)], axis=2)), rest

        return walk(view, group, visit, (sums, rests[group[0]]))[0], None

    sums = jnp.zeros((view.splats.shape[0], 6 + features.shape[1]), jnp.float32)
    return jax.lax.scan(gather, sums, groups(view))[0]


def _about(moments: jax.Array, center: jax.Array) -> jax.Array:
    """Moments 1, x, y, xx, xy, yy (..., 6) about a centre (..., 2) instead of the origin."""
    m, x, y, xx, xy, yy = jnp.moveaxis(moments, -1, 0)
    u, v = jnp.moveaxis(center, -1, 0)
    first, second = x - u * m, y - v * m
    squares = xx - u * (x + first), xy - u * y - v * first, yy - v * (y + second)
    return jnp.stack([m, first, second, *squares], axis=-1)


def _by_splat(splats: jax.Array, moments: jax.Array) -> jax.Array:
    """Derivatives of the loss by `View.splats`, given the moments of alpha dL/dalpha, (N + 1, 6).

    sigma = (a dx + b dy)^2 + (c dy)^2, and log alpha = log o - sigma.
    """
    _, _, a, b, c, _ = splats.T
    m, x, y, xx, xy, yy = moments.T
    first, second = a * x + b * y, c * y
    by_a, by_b = a * xx + b * xy, a * xy + b * yy
    rows = a * first, b * first + c * second, -by_a, -by_b, -c * yy, 0.5 * m
    return 2 * jnp.stack(rows, axis=1)
