"""3D Gaussians to 2D: the EWA projection, culling, and what the rasteriser needs of each splat.

With T = J W R S (Jacobian of the perspective, world to camera, rotation, scales) the image
covariance is `T T^t + 0.3 I` (Zwicker et al. 2001; Kerbl et al. 2023, eq. 5). Its determinant is
taken as `|t_0 x t_1|^2 + 0.3 tr + 0.09` (Cauchy-Binet), which stays positive in float32 however
thin the needle, and divided by c before it can overflow; and the exponent
`sigma = d^t Sigma^-1 d / 2` is evaluated as a sum of two squares of a whitened offset, so it is
never negative. `tests/test_projection.py` holds it to a float64 reference.
"""

import functools

import jax
import jax.numpy as jnp

from gsc_jax.pytree import pytree
from gsc_jax.scene import Array, Camera, Gaussians

NEAR = 0.2
"""Default near plane in world units, that of the INRIA rasteriser."""
LOW_PASS = 0.3
"""Variance in square pixels added to every splat."""
MIN_ALPHA = 1.0 / 255.0
"""Contributions below this are dropped; also the level set that bounds a splat."""


@pytree
class Splats:
    """N projected Gaussians; those that are not `visible` hold finite placeholders.

    Attributes:
        means: Projected centres in pixels, shape (N, 2).
        covs: Image covariances (xx, xy, yy) in square pixels, shape (N, 3).
        whitening: (a, b, c) such that sigma = (a dx + b dy)^2 + (c dy)^2, shape (N, 3).
        opacities: Activated opacities, shape (N,).
        reach: Twice the exponent at which alpha falls to 1/255, 2 ln(255 o), shape (N,).
        depths: Distance along the optical axis in world units, shape (N,).
        visible: In front of the near plane, finite, opaque enough and touching the image, (N,).
    """

    means: Array
    covs: Array
    whitening: Array
    opacities: Array
    reach: Array
    depths: Array
    visible: Array


def project(gaussians: Gaussians, camera: Camera, *, near: float = NEAR) -> Splats:
    """Project Gaussians into a view.

    Args:
        gaussians: N Gaussians; rows with NaN or infinities are not visible.
        camera: The view.
        near: Near plane in world units; what lies closer is not visible.

    Returns:
        The N splats.
    """
    return _project(gaussians, camera.viewmat, camera.K, near, camera.width, camera.height)


@functools.partial(jax.jit, static_argnames=("width", "height"))
def _project(gaussians, viewmat, K, near, width: int, height: int) -> Splats:
    points = gaussians.means @ viewmat[:3, :3].T + viewmat[None, :3, 3]
    depths = points[:, 2]
    in_front = depths > near
    depth = jnp.where(in_front, depths, 1.0)
    means = points[:, :2] / depth[:, None] * jnp.diag(K)[None, :2] + K[None, :2, 2]

    rows = _image_axes(points / depth[:, None], depth, viewmat, K, width, height)
    axes = rows @ _rotation_matrices(gaussians.rotations) * gaussians.scales[:, None, :]
    a, c = jnp.sum(axes**2, axis=-1).T + LOW_PASS
    b = jnp.sum(axes[:, 0] * axes[:, 1], axis=-1)
    thin = jnp.cross(axes[:, 0], axes[:, 1] / jnp.sqrt(c)[:, None])
    det_over_c = jnp.sum(thin**2, axis=-1) + LOW_PASS * ((a - LOW_PASS) / c + 1.0)

    opacities = gaussians.opacities
    reach = 2.0 * jnp.log(opacities / MIN_ALPHA)
    extents = jnp.sqrt(jnp.maximum(reach, 0.0)[:, None] * jnp.stack([a, c], axis=-1))
    size = jnp.array([[width, height]], means.dtype)
    touches = jnp.all((means + extents > 0) & (means - extents < size), axis=-1)
    finite = jnp.isfinite(jnp.column_stack([means, extents, det_over_c, gaussians.quats])).all(-1)
    finite &= jnp.isfinite(gaussians.sh).all(axis=(1, 2))
    visible = in_front & finite & (reach > 0) & touches

    steep = jnp.sqrt(0.5 / det_over_c)
    whitening = jnp.stack([steep, -steep * b / c, jnp.sqrt(0.5 / c)], axis=-1)
    covs = jnp.stack([a, b, c], axis=-1)
    means, covs, whitening, opacities, reach, depths = (
        jnp.where(visible.reshape(-1, *[1] * (leaf.ndim - 1)), leaf, 0.0)
        for leaf in (means, covs, whitening, opacities, reach, depths)
    )
    return Splats(
        means=means,
        covs=covs,
        whitening=whitening,
        opacities=opacities,
        reach=reach,
        depths=depths,
        visible=visible,
    )


def _image_axes(rays, depth, viewmat, K, width: int, height: int) -> jax.Array:
    """J W for every Gaussian, shape (N, 2, 3), with the ray clamped to 1.3 times the field of view.

    The clamp is measured from the principal point to each border (as gsplat does); with a centred
    principal point that is INRIA's 1.3 tan(fov / 2).
    """
    focal = jnp.diag(K)[:2]
    size = jnp.array([width, height], focal.dtype)
    margin = 0.15 * size / focal
    low, high = -K[:2, 2] / focal - margin, (size - K[:2, 2]) / focal + margin
    slopes = jnp.clip(rays[:, :2], low[None], high[None])
    over_depth = (focal[None] / depth[:, None])[:, :, None]
    return over_depth * (viewmat[None, :2, :3] - slopes[:, :, None] * viewmat[None, 2:3, :3])


def _rotation_matrices(quats: jax.Array) -> jax.Array:
    """Rotation matrices of unit wxyz quaternions, shape (N, 3, 3)."""
    w, x, y, z = quats.T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


@jax.jit
def project_centers(means: Array, viewmat: Array, K: Array) -> tuple[jax.Array, jax.Array]:
    """Project centres only, without culling: what the vote looks at.

    Args:
        means: Centres in the world, shape (N, 3).
        viewmat: World to camera, shape (4, 4).
        K: Intrinsics in pixels, shape (3, 3).

    Returns:
        Pixel coordinates (N, 2), meaningless where the depth is not positive, and depths (N,).
    """
    means, viewmat, K = jnp.asarray(means), jnp.asarray(viewmat), jnp.asarray(K)
    points = means @ viewmat[:3, :3].T + viewmat[None, :3, 3]
    depths = points[:, 2]
    rays = points[:, :2] / jnp.where(depths > 0, depths, 1.0)[:, None]
    return rays * jnp.diag(K)[None, :2] + K[None, :2, 2], depths
