"""EWA projection of 3D Gaussians to image splats, with culling.

With T = J W R S (Jacobian of the perspective, world to camera, rotation, scales) the image
covariance is T T^T + 0.3 I (Zwicker et al. 2001; Kerbl et al. 2023, eq. 5). Its determinant is
computed as |t_0 x t_1|^2 + 0.3 tr + 0.09 (Cauchy-Binet), which stays positive in float32 for the
thinnest needle, and divided by c before it can overflow. The exponent sigma = d^T Sigma^-1 d / 2
is a sum of two squares of a whitened offset, hence never negative.
"""

import functools
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from gsc_jax.scene import Array, Camera, Gaussians, pytree
from gsc_jax.scene.camera import check_camera
from gsc_jax.scene.errors import in_range
from gsc_jax.scene.gaussians import IDENTITY_QUATERNION, MAX_LOG_SCALE, check_shapes

NEAR = 0.2
"""Default near plane in world units, that of the INRIA rasteriser."""
LOW_PASS = 0.3
"""Variance in square pixels added to every splat, as in the INRIA rasteriser."""
MIN_ALPHA = 1.0 / 255.0
"""Opacities below this are dropped, as in the INRIA rasteriser; also the outline of a splat."""
TRANSPARENT_LOGIT = -20.0
"""Logit opacity of rows that cannot be rendered: far below `MIN_ALPHA`, derivative finite."""


@pytree
class Splats:
    """N projected Gaussians; those that are not `visible` have finite placeholders.

    Attributes:
        means: Projected centres in pixels, shape (N, 2).
        covs: Image covariances (xx, xy, yy) in square pixels, shape (N, 3).
        whitening: (a, b, c) such that sigma = (a dx + b dy)^2 + (c dy)^2, shape (N, 3).
        opacities: Activated opacities, shape (N,).
        reach: Twice the exponent at which alpha falls to 1/255, 2 ln(255 o), shape (N,).
        depths: Distance along the optical axis in world units, shape (N,).
        visible: Beyond the near plane, finite, opaque enough and touching the image, shape (N,).
    """

    means: Array
    covs: Array
    whitening: Array
    opacities: Array
    reach: Array
    depths: Array
    visible: Array


def project(gaussians: Gaussians, camera: Camera, *, near: float = NEAR) -> Splats:
    """Project N Gaussians into a view.

    Gaussians with parameters that are not finite are not visible, nor are those closer than the
    near plane, in world units. Wrong shapes and a near plane that is not positive raise ValueError.
    """
    check_shapes(gaussians)
    check_camera(camera)
    if not isinstance(near, Tracer) and not in_range(np.asarray(near)[()], 1e-30, 1e30):
        raise ValueError(f"near must be positive, got {near!r}")
    parameters = gaussians.means, gaussians.log_scales, gaussians.quats, gaussians.logit_opacities
    size = float(camera.width), float(camera.height)  # no constants, which JAX would compile
    return _project(parameters, Pinhole(camera.viewmat, camera.K, size), near)


class Pinhole(NamedTuple):
    """A camera whose image size is not static."""

    viewmat: Array
    K: Array
    size: tuple[float, float]


@jax.jit
def _project(parameters: tuple[Array, ...], camera: Pinhole, near: float) -> Splats:
    means, log_scales, quats, logits = parameters
    # As `invalid_rows`. On whole matrices: inside of the map, XLA's program is five times slower.
    finite = jnp.isfinite(means).all(axis=1) & jnp.isfinite(quats).all(axis=1)
    usable = finite & (log_scales <= MAX_LOG_SCALE).all(axis=1) & ~jnp.isnan(logits)
    # Placeholders before any arithmetic: 0 times the derivative of a NaN would be NaN.
    means, log_scales, quats = (
        _columns(jnp.where(usable[:, None], x, 0.0)) for x in (means, log_scales, quats)
    )
    logits = jnp.where(usable, logits, TRANSPARENT_LOGIT)
    each = jax.vmap(_project_one, in_axes=(0, 0, 0, 0, None, None))
    return each(means, log_scales, quats, logits, camera, near)


@jax.custom_vjp
def _columns(rows: Array) -> list[jax.Array]:
    """Columns of a matrix (N, D), with a derivative that is fast on a CPU.

    JAX would transpose an index under vmap to a scatter, and `unstack` to a concatenation, into
    which XLA fuses all that comes before it, once for each column.
    """
    return list(jnp.unstack(rows, axis=1))


def _joined(_: None, columns: list[jax.Array]) -> tuple[jax.Array]:
    units = np.eye(len(columns), dtype=np.float32)
    parts = (column[:, None] * unit[None] for column, unit in zip(columns, units, strict=True))
    return (functools.reduce(jnp.add, parts),)


_columns.defvjp(lambda rows: (_columns(rows), None), _joined)


def _project_one(mean, log_scale, quat, logit, camera: Pinhole, near) -> Splats:
    """Project one Gaussian, in scalars: vmap turns them into long vectors, small matrices not."""
    viewmat, K, (width, height) = camera
    x, y, depth = (_dot(viewmat[i, :3], mean) + viewmat[i, 3] for i in range(3))
    in_front = depth > near
    z = jnp.where(in_front, depth, 1.0)
    u, v = _image_axes(x / z, y / z, z, camera)
    scales = [jnp.exp(log_scale[k]) for k in range(3)]
    axes = _rotation_columns(quat)
    row_x = [_dot(u, axis) * scale for axis, scale in zip(axes, scales, strict=True)]
    row_y = [_dot(v, axis) * scale for axis, scale in zip(axes, scales, strict=True)]

    a, b, c = _dot(row_x, row_x) + LOW_PASS, _dot(row_x, row_y), _dot(row_y, row_y) + LOW_PASS
    p, q = row_x, [entry / jnp.sqrt(c) for entry in row_y]
    thin = [p[i] * q[j] - p[j] * q[i] for i, j in ((1, 2), (2, 0), (0, 1))]  # p x q
    det_over_c = _dot(thin, thin) + LOW_PASS * ((a - LOW_PASS) / c + 1.0)
    steep = jnp.sqrt(0.5 / det_over_c)

    opacity = jax.nn.sigmoid(logit)
    reach = 2.0 * jnp.log(opacity / MIN_ALPHA)
    center_x, center_y = x / z * K[0, 0] + K[0, 2], y / z * K[1, 1] + K[1, 2]
    visible = in_front & (reach > 0) & jnp.isfinite(det_over_c)
    for center, variance, size in ((center_x, a, width), (center_y, c, height)):
        extent = jnp.sqrt(jnp.maximum(reach, 0.0) * variance)
        visible &= jnp.isfinite(extent) & (center + extent > 0) & (center - extent < size)

    def kept(*entries):
        return jnp.stack([jnp.where(visible, entry, 0.0) for entry in entries])

    return Splats(
        means=kept(center_x, center_y),
        covs=kept(a, b, c),
        whitening=kept(steep, -steep * b / c, jnp.sqrt(0.5 / c)),
        opacities=jnp.where(visible, opacity, 0.0),
        reach=jnp.where(visible, reach, 0.0),
        depths=jnp.where(visible, depth, 0.0),
        visible=visible,
    )


def _image_axes(slope_x, slope_y, z, camera: Pinhole):
    """Compute the two rows of J W, with the ray clamped to 1.3 times the field of view.

    The clamp is measured from the principal point to each border, as in gsplat; with a centred
    principal point it is INRIA's 1.3 tan(fov / 2).
    """
    viewmat, K, (width, height) = camera

    def row(axis, slope, size):
        focal, center = K[axis, axis], K[axis, 2]
        margin = 0.15 * size / focal
        clamped = jnp.clip(slope, -center / focal - margin, (size - center) / focal + margin)
        return [focal / z * (viewmat[axis, k] - clamped * viewmat[2, k]) for k in range(3)]

    return row(0, slope_x, width), row(1, slope_y, height)


def _rotation_columns(quat) -> list[list[jax.Array]]:
    """Columns of the rotation matrix of a wxyz quaternion of any length; identity for zero."""
    # Divide by the largest entry first, so that the norm neither overflows nor underflows.
    largest = functools.reduce(jnp.maximum, map(jnp.abs, quat))
    divisor = jnp.where(largest > 0, largest, 1.0)
    entries = zip(quat, IDENTITY_QUATERNION, strict=True)
    w, x, y, z = (jnp.where(largest > 0, entry / divisor, one) for entry, one in entries)
    s = 2.0 / _dot([w, x, y, z], [w, x, y, z])
    return [
        [1 - s * (y * y + z * z), s * (x * y + w * z), s * (x * z - w * y)],
        [s * (x * y - w * z), 1 - s * (x * x + z * z), s * (y * z + w * x)],
        [s * (x * z + w * y), s * (y * z - w * x), 1 - s * (x * x + y * y)],
    ]


def _dot(p, q):
    return functools.reduce(jnp.add, [p[k] * q[k] for k in range(len(q))])


@jax.jit
def project_centers(means: Array, viewmat: Array, K: Array) -> tuple[jax.Array, jax.Array]:
    """Pixels (N, 2) and depths (N,) of centres (N, 3), without culling, for the vote.

    The pixels are meaningless where the depth is not positive.
    """
    means, viewmat, K = jnp.asarray(means), jnp.asarray(viewmat), jnp.asarray(K)
    points = jnp.matmul(means, viewmat[:3, :3].T, precision="highest") + viewmat[None, :3, 3]
    depths = points[:, 2]
    rays = points[:, :2] / jnp.where(depths > 0, depths, 1.0)[:, None]
    return rays * jnp.diag(K)[None, :2] + K[None, :2, 2], depths
