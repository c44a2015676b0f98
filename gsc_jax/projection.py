"""3D Gaussians to 2D: the EWA projection, culling, and what the rasteriser needs of each splat.

With T = J W R S (Jacobian of the perspective, world to camera, rotation, scales) the image
covariance is `T T^t + 0.3 I` (Zwicker et al. 2001; Kerbl et al. 2023, eq. 5). Its determinant is
taken as `|t_0 x t_1|^2 + 0.3 tr + 0.09` (Cauchy-Binet), which stays positive in float32 however
thin the needle; and the exponent `sigma = d^t Sigma^-1 d / 2` is evaluated as a sum of two squares
of a whitened offset, so it is never negative. `tests/test_projection.py` holds it to a float64
reference.
"""

import functools

import chex
import jax
import jax.numpy as jnp

from gsc_jax.scene import Array, Camera, Gaussians

NEAR = 0.2
"""Default near plane in world units, that of the INRIA rasteriser."""
LOW_PASS = 0.3
"""Variance in square pixels added to every splat."""
MIN_ALPHA = 1.0 / 255.0
"""Contributions below this are dropped; also the level set that bounds a splat."""


@chex.dataclass(frozen=True, kw_only=True, mappable_dataclass=False)
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
    a, c = jnp.sum(axes**2, axis=-1).T
    b = jnp.sum(axes[:, 0] * axes[:, 1], axis=-1)
    area = jnp.sum(jnp.cross(axes[:, 0], axes[:, 1]) ** 2, axis=-1)
    det = area + LOW_PASS * (a + c) + LOW_PASS**2
    a, c = a + LOW_PASS, c + LOW_PASS

    opacities = gaussians.opacities
    reach = 2.0 * jnp.log(opacities / MIN_ALPHA)
    extents = jnp.sqrt(jnp.maximum(reach, 0.0)[:, None] * jnp.stack([a, c], axis=-1))
    size = jnp.array([[width, height]], means.dtype)
    touches = jnp.all((means + extents > 0) & (means - extents < size), axis=-1)
    finite = jnp.isfinite(means).all(axis=-1) & jnp.isfinite(det) & jnp.isfinite(extents).all(-1)
    visible = in_front & finite & (reach > 0) & touches

    steep = jnp.sqrt(0.5 * c / det)
    whitening = jnp.stack([steep, -steep * b / c, jnp.sqrt(0.5 / c)], axis=-1)
    covs = jnp.stack([a, b, c], axis=-1)
    means, covs, whitening, opacities, reach = (
        jnp.where(visible.reshape(-1, *[1] * (leaf.ndim - 1)), leaf, 0.0)
        for leaf in (means, covs, whitening, opacities, reach)
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
