"""An edited scene saved again, host and object by one quantisation, so that no format tells.

Released scenes were often stored in 8 bits, while edits are computed and saved in float32: then the
digits give an object away, and a detector that learns from such scenes learns the file format. Here
every row, whoever it belongs to, gets noise of up to one step of the lattice that it is then
rounded to, so that a lattice it was on before, of about the same step, does not shine through.
"""

import dataclasses
from typing import Literal

import numpy as np

from gsc_jax.scene import Gaussians

Export = Literal["8 bits", "float"]

SCALE_STEP = 1 / 16
"""Of log scales, as in spz."""
COLOUR_STEP = 0.03
"""Of all harmonics; spz has 1 / (0.15 * 255) for the plain colour and more for the others."""
TURN_STEP = 1 / 128
"""Of the entries of unit quaternions: 8 bits, signed."""
OPACITY_STEP = 1 / 255
PLACE_BITS = 14
"""Steps of the positions along the longest side of the scene, without its farthest percent."""


def exported(gaussians: Gaussians, *, as_: Export = "8 bits", seed: int = 0) -> Gaussians:
    """Quantise a scene again, all rows alike.

    Args:
        gaussians: N Gaussians; values that are not finite stay as they are.
        as_: "8 bits" adds noise and rounds; "float" adds the noise only.
        seed: Of the noise.

    Returns:
        The Gaussians, float32, quaternions of unit length with w >= 0.
    """
    rng = np.random.default_rng(seed)

    def shaken(values: np.ndarray, step: float) -> np.ndarray:
        # Triangular: uniform noise of a step would leave what is on the lattice where it is.
        noise = rng.random(values.shape, np.float32) - rng.random(values.shape, np.float32)
        noisy = values + step * noise
        return (np.round(noisy / step) * step if as_ == "8 bits" else noisy).astype(np.float32)

    means = np.asarray(gaussians.means)
    extent = np.ptp(np.nanpercentile(means, [1, 99], axis=0), axis=0).max()
    opacities = np.clip(
        shaken(np.asarray(gaussians.opacities), OPACITY_STEP),
        OPACITY_STEP / 2,
        1 - OPACITY_STEP / 2,
    )
    quats = np.asarray(gaussians.rotations)
    quats = shaken(quats * np.where(quats[:, :1] < 0, -1, 1), TURN_STEP)
    quats /= np.maximum(np.linalg.norm(quats, axis=1, keepdims=True), 1e-6)
    return dataclasses.replace(
        gaussians,
        means=shaken(means, max(extent, 1e-6) / 2**PLACE_BITS),
        log_scales=shaken(np.asarray(gaussians.log_scales), SCALE_STEP),
        quats=quats,
        logit_opacities=np.log(opacities / (1 - opacities)).astype(np.float32),
        sh=shaken(np.asarray(gaussians.sh), COLOUR_STEP),
    )
