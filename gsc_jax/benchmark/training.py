"""Training of Gaussians on posed images: the loss, the learning rates and a step of 3DGS.

The loss is 0.8 L1 + 0.2 (1 - SSIM) of a view (Kerbl et al. 2023, eq. 7), minimised by Adam.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from typing import Any, Literal, NamedTuple, cast, get_args

import jax
import jax.numpy as jnp
import numpy as np
import optax

from gsc_jax.benchmark.similarity import ssim
from gsc_jax.render.reprojection import reprojected
from gsc_jax.render.tiles import View
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.errors import check_ranges
from gsc_jax.splat import render_view

RANGES: dict[str, tuple[float, float]] = {
    "iterations": (1, 10**9),
    "budget": (8, 10**9),
    "sh_degree": (0, 3),
    "ssim_weight": (0.0, 1.0),
}
"""Smallest and largest valid value of the numbers; integers where the number is one."""

Strategy = Literal["adaptive", "mcmc"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class CaptureConfig:
    """How a scene is trained; the rates are those of the code of 3DGS.

    Attributes:
        iterations: Number of steps, one view each.
        budget: Largest number of Gaussians.
        sh_degree: Degree of the harmonics, 0 to 3; one more every `iterations / 10` steps.
        strategy: "adaptive" density control (Kerbl et al. 2023) or "mcmc" relocation (Kheradmand et
            al. 2024).
        reset_opacities: Whether adaptive density control resets opacities twice.
        ssim_weight: Weight of 1 - SSIM in the loss.

    Raises:
        ValueError: if an option is not one of the choices or out of its range.
    """

    iterations: int = 3000
    budget: int = 40_000
    sh_degree: int = 3
    strategy: Strategy = "adaptive"
    reset_opacities: bool = True
    ssim_weight: float = 0.2

    def __post_init__(self) -> None:
        """Check the options."""
        if self.strategy not in get_args(Strategy):
            raise ValueError(f"strategy must be {get_args(Strategy)}, got {self.strategy!r}")
        check_ranges(self, RANGES)
        if not isinstance(self.reset_opacities, bool):
            raise ValueError(f"reset_opacities must be a bool, got {self.reset_opacities!r}")


ADAM = optax.scale_by_adam(eps=1e-15)


class Training(NamedTuple):
    """State of a training: rows of the budget, moments of Adam, and gradients in the image."""

    scene: Gaussians
    moments: Any
    gradient: jax.Array
    seen: jax.Array


def require_images(cameras: Sequence[Camera], images: np.ndarray) -> None:
    """Raise ValueError if there is not an image in [0, 1] of its size for each camera."""
    if not len(cameras) == len(images) > 0:
        raise ValueError(
            f"expected an image per camera, got {len(cameras)} cameras, {len(images)} images"
        )
    for camera in cameras:
        if np.shape(images)[1:] != (camera.height, camera.width, 3):
            raise ValueError(
                f"expected images of the size of their cameras, {camera.width} x {camera.height}, "
                f"in RGB, got images of shape {np.shape(images)[1:]}"
            )
    if not (np.min(images) >= 0 and np.max(images) <= 1):
        raise ValueError("expected images in [0, 1] without NaN")


def passes(count: int, rng: np.random.Generator) -> Iterator[int]:
    """Indices of views, without end: each pass has all of them, in an order of its own."""
    while True:
        yield from rng.permutation(count)


def camera_extent(cameras: Sequence[Camera]) -> float:
    """Radius of the cameras around their mean with a margin of 10 %, in world units."""
    centers = np.array([camera.center for camera in cameras])
    return 1.1 * float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).max()) or 1.0


def learning_rates(done: float, extent: float, config: CaptureConfig) -> Gaussians:
    """Learning rate of each parameter once a share `done` of the steps has been made."""
    bands = np.repeat(np.arange(config.sh_degree + 1), 2 * np.arange(config.sh_degree + 1) + 1)
    sh = np.where(bands <= 10 * done, 2.5e-3 / np.where(bands, 20, 1), 0)
    return Gaussians(
        means=np.asarray(1.6e-4 * extent * 0.01**done, np.float32),
        log_scales=np.asarray(5e-3, np.float32),
        quats=np.asarray(1e-3, np.float32),
        logit_opacities=np.asarray(0.025, np.float32),
        sh=sh[None, :, None].astype(np.float32),
    )


def started(scene: Gaussians) -> Training:
    """The state before the first step."""
    scene = jax.tree.map(jnp.asarray, scene)
    moments = ADAM.init(cast(Any, scene))
    return Training(scene, moments, jnp.zeros(len(scene)), jnp.zeros(len(scene)))


@jax.jit
def stepped(
    training: Training,
    view: View,
    camera: Camera,
    image: jax.Array,
    rates: Gaussians,
    weights: tuple[float, float],
) -> Training:
    """One step of Adam on one view; sums the gradients by the means in the image, as 3DGS does."""
    used = jnp.isfinite(training.scene.logit_opacities)

    def loss(scene: Gaussians, shift: jax.Array) -> jax.Array:
        moved = reprojected(view, scene, camera)
        splats = jnp.asarray(moved.splats).at[:-1, :2].add(shift)
        moved = dataclasses.replace(moved, splats=splats)
        rendered, _ = render_view(moved, scene, camera)
        difference = jnp.mean(jnp.abs(rendered - image))
        sizes = scene.opacities + jnp.mean(scene.scales, axis=1)
        regular = jnp.sum(jnp.where(used, sizes, 0)) / jnp.sum(used, dtype=jnp.float32)
        dissimilar = 1 - jnp.mean(ssim(rendered, image))
        return (1 - weights[0]) * difference + weights[0] * dissimilar + weights[1] * regular

    scene = training.scene
    by_scene, by_shift = jax.grad(loss, (0, 1))(scene, jnp.zeros((len(scene), 2)))
    with jax.numpy_dtype_promotion("standard"):  # optax mixes integers and floats
        updates, moments = ADAM.update(by_scene, training.moments)
    scene = jax.tree.map(lambda leaf, update, rate: leaf - rate * update, scene, updates, rates)
    # In normalised device coordinates, in which the threshold of 3DGS is given.
    half = jnp.array([[view.width / 2, view.height / 2]])
    length = jnp.linalg.norm(by_shift * half, axis=1)
    seen = training.seen + jnp.isfinite(view.splats[:-1, 5]).astype(jnp.float32)
    return Training(scene, moments, training.gradient + length, seen)


def per_row(values: jax.Array, leaf: jax.Array) -> jax.Array:
    """Values (N,) in the shape of a parameter (N, ...), for broadcasting."""
    return values.reshape(-1, *[1] * (leaf.ndim - 1))
