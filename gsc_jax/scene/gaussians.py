"""Gaussians as an immutable pytree, their activated parameters, and the rows that are unusable.

Parameters are named by their space: a .ply file stores `log_scales`, `logit_opacities` and
quaternions of any length; the equations use the properties `scales`, `opacities` and `rotations`.
"""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from gsc_jax.scene.pytree import pytree

Array = jax.Array | np.ndarray

MAX_LOG_SCALE = 40.0
"""Log scales above this overflow float32 once squared and projected."""
MAX_MAGNITUDE = 1e9
"""Positions and colours beyond this are damaged, far outside any scene; their squares are still
below the largest float32, 3e38."""
MAX_FILLED = 2**20
"""Largest scene that `filled_up` copies: beyond it, a copy costs more than a compilation."""
IDENTITY_QUATERNION = np.array([1, 0, 0, 0], np.float32)


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
        """Number of Gaussians."""
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
        # Divide by the largest entry first, so that the norm neither overflows nor underflows.
        largest = jnp.max(jnp.abs(quats), axis=-1, keepdims=True)
        usable = (largest > 0) & jnp.isfinite(largest)
        scaled = quats / jnp.where(usable, largest, 1.0)
        quats = jnp.where(usable, scaled, IDENTITY_QUATERNION[None])
        return quats / jnp.linalg.norm(quats, axis=-1, keepdims=True)

    @property
    def sh_degree(self) -> int:
        """Degree of the spherical harmonics, 0 to 3."""
        return round(self.sh.shape[1] ** 0.5) - 1

    def take(self, rows: Array | slice) -> "Gaussians":
        """Select rows by indices, a slice or a boolean mask."""
        return jax.tree.map(lambda leaf: leaf[rows], self)


def with_degree(gaussians: Gaussians, degree: int) -> Gaussians:
    """Truncate or zero-pad spherical harmonics to a degree."""
    bands, sh = (degree + 1) ** 2, np.asarray(gaussians.sh)[:, : (degree + 1) ** 2]
    return dataclasses.replace(gaussians, sh=np.pad(sh, ((0, 0), (0, bands - sh.shape[1]), (0, 0))))


def concatenate(scenes: Sequence[Gaussians]) -> Gaussians:
    """Concatenate scenes, of the highest degree of them."""
    degree = max(scene.sh_degree for scene in scenes)
    parts = [with_degree(scene, degree) for scene in scenes]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *parts)


def bucket(count: int) -> int:
    """The next of four sizes an octave: JAX compiles for each size of an array."""
    return count + -count % (1 << max(count.bit_length() - 3, 0))


def transparent_rows(count: int) -> int:
    """Rows that fill up a scene to a `bucket`."""
    return bucket(count) - count if count <= MAX_FILLED else 0


def filled_up(gaussians: Gaussians) -> Gaussians:
    """The scene with `transparent_rows` at its end, which no view shows."""
    count, more = len(gaussians), transparent_rows(len(gaussians))
    if not more:
        return gaussians
    # In NumPy, since JAX would compile for each number of rows.
    filled = jax.tree.map(lambda x: np.pad(x, ((0, more), *[(0, 0)] * (x.ndim - 1))), gaussians)
    filled.logit_opacities[count:] = -np.inf
    return jax.device_put(filled)


def check_shapes(gaussians: Gaussians) -> None:
    """Raise ValueError if shapes do not match, TypeError for another type."""
    if not isinstance(gaussians, Gaussians):
        raise TypeError(f"expected Gaussians, as of load_ply, got {type(gaussians).__name__}")
    count = (*getattr(gaussians.means, "shape", ()), 0)[0]
    harmonics = [((degree + 1) ** 2, 3) for degree in range(4)]
    columns = {"means": [(3,)], "log_scales": [(3,)], "quats": [(4,)], "logit_opacities": [()]}
    for name, widths in {**columns, "sh": harmonics}.items():
        shapes, values = [(count, *width) for width in widths], getattr(gaussians, name)
        if (found := getattr(values, "shape", type(values).__name__)) not in shapes:
            known = " or ".join(map(str, shapes))
            raise ValueError(f"{name} of {count} Gaussians must be {known}, got {found}")
        if not values.dtype.isnative:  # JAX would take the bytes as they are
            raise ValueError(f"{name} must be in the byte order of the machine, got {values.dtype}")


def invalid_rows(gaussians: Gaussians) -> dict[str, np.ndarray]:
    """Find the Gaussians that cannot be rendered: boolean arrays (N,) by reason.

    An opacity of plus infinity is valid (fully opaque), and one of minus infinity is merely
    invisible. Shapes that do not belong together raise ValueError.
    """
    check_shapes(gaussians)
    host = jax.tree.map(np.asarray, gaussians)
    bounded = host.means, host.quats, host.sh
    beyond = ((part > MAX_MAGNITUDE) | (part < -MAX_MAGNITUDE) for part in bounded)
    outside = [part.any(axis=tuple(range(1, part.ndim))) for part in beyond]
    return {
        "position not finite": ~np.isfinite(host.means).all(axis=1),
        "scale not finite": ~(np.isfinite(host.log_scales) | np.isneginf(host.log_scales)).all(1),
        "scale too large (is it in log space?)": (host.log_scales > MAX_LOG_SCALE).any(axis=1),
        "rotation not finite": ~np.isfinite(host.quats).all(axis=1),
        "rotation zero": (host.quats == 0).all(axis=1),
        "opacity not a number": np.isnan(host.logit_opacities),
        "colour not finite": ~np.isfinite(host.sh).all(axis=(1, 2)),
        "number out of all bounds": np.any(outside, axis=0),
    }


def usable_rows(gaussians: Gaussians) -> np.ndarray:
    """Mask of the Gaussians with no reason in `invalid_rows`, shape (N,) bool."""
    return ~np.any(list(invalid_rows(gaussians).values()), axis=0)


def rotation_matrices(gaussians: Gaussians) -> np.ndarray:
    """Rotation matrices, whose columns are the axes of the Gaussians, shape (N, 3, 3) float32."""
    quats = np.asarray(gaussians.quats, np.float64)
    usable = (np.isfinite(quats) & quats.any(axis=1, keepdims=True)).all(axis=1, keepdims=True)
    quats = np.where(usable, quats, IDENTITY_QUATERNION)
    return Rotation.from_quat(quats, scalar_first=True).as_matrix().astype(np.float32)
