"""Scenes and cameras: immutable pytrees, the activations, and which rows can be rendered.

Parameters are named by their space. What a .ply stores is `log_scales`, `logit_opacities` and
quaternions of any length; what the equations use is `scales`, `opacities` and unit quaternions,
which are properties here. World to camera is `viewmat`, with OpenCV axes (x right, y down, z
forward); `K` is in pixels and the centre of the first pixel is (0.5, 0.5).
"""

import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.scene.pytree import pytree

Array = jax.Array | np.ndarray

MAX_LOG_SCALE = 40.0
"""Log scales above this overflow float32 once squared and projected."""
MAX_MAGNITUDE = 1e9
"""Positions and colours beyond this are damage, and their squares would overflow float32."""


@pytree
class Gaussians:
    """N Gaussians in the parameters that a 3DGS file stores, all float32.

    Attributes:
        means: Centres in world units, shape (N, 3).
        log_scales: Logarithms of the standard deviations along the axes, shape (N, 3).
        quats: Rotations as wxyz quaternions, not necessarily normalised, shape (N, 4).
        logit_opacities: Opacities before the sigmoid, shape (N,).
        sh: Spherical harmonics of the colour, shape (N, K, 3) with K = (degree + 1)^2.
    """

    means: Array
    log_scales: Array
    quats: Array
    logit_opacities: Array
    sh: Array

    def __len__(self) -> int:
        """The number of Gaussians."""
        return self.means.shape[0]

    @property
    def scales(self) -> jax.Array:
        """Standard deviations along the axes in world units, shape (N, 3)."""
        return jnp.exp(self.log_scales)

    @property
    def opacities(self) -> jax.Array:
        """Opacities in [0, 1], shape (N,)."""
        return jax.nn.sigmoid(jnp.asarray(self.logit_opacities))

    @property
    def rotations(self) -> jax.Array:
        """Unit quaternions wxyz, shape (N, 4); the identity where the stored one is zero."""
        quats = jnp.asarray(self.quats)
        # Scaling by the largest entry first keeps the norm from over- or underflowing.
        largest = jnp.max(jnp.abs(quats), axis=-1, keepdims=True)
        usable = (largest > 0) & jnp.isfinite(largest)
        quats = jnp.where(usable, quats / jnp.where(usable, largest, 1.0), IDENTITY[None])
        return quats / jnp.linalg.norm(quats, axis=-1, keepdims=True)

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return round(self.sh.shape[1] ** 0.5) - 1

    def take(self, rows: Array) -> "Gaussians":
        """The Gaussians of these rows (indices or a boolean mask), in that order."""
        return jax.tree.map(lambda leaf: leaf[rows], self)


IDENTITY = np.array([1, 0, 0, 0], np.float32)


def invalid_rows(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Which Gaussians cannot be rendered, by reason.

    Args:
        gaussians: N Gaussians as stored.

    Returns:
        Boolean arrays of shape (N,) by reason; a row may have several. An opacity of plus infinity
        is legal (fully opaque), and one of minus infinity is merely invisible.
    """
    host = jax.tree.map(np.asarray, gaussians)
    finite_sh = np.isfinite(host.sh).all(axis=(1, 2))
    quats = np.isfinite(host.quats).all(axis=1)
    return {
        "position not finite": ~np.isfinite(host.means).all(axis=1),
        "scale not finite": ~(np.isfinite(host.log_scales) | np.isneginf(host.log_scales)).all(1),
        "scale too large (is it in log space?)": (host.log_scales > MAX_LOG_SCALE).any(axis=1),
        "rotation not finite": ~quats,
        "rotation zero": quats & ~host.quats.any(axis=1),
        "opacity not a number": np.isnan(host.logit_opacities),
        "colour not finite": ~finite_sh,
        "position or colour out of all bounds": (np.abs(host.means) > MAX_MAGNITUDE).any(axis=1)
        | (np.abs(host.sh) > MAX_MAGNITUDE).any(axis=(1, 2)),
    }


def usable_rows(gaussians: Gaussians) -> np.ndarray:
    """Mask of the Gaussians that can be rendered, shape (N,) bool; see `invalid_rows`."""
    return ~np.any(list(invalid_rows(gaussians).values()), axis=0)


def rotation_matrices(gaussians: Gaussians) -> np.ndarray:
    """Rotation matrices of N Gaussians, whose columns are their axes, shape (N, 3, 3) float32."""
    w, x, y, z = np.asarray(gaussians.rotations).T
    rows = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        (2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        (2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    )
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=1)
