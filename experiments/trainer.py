"""Captures: scenes trained from posed images, with the loss and the rates of 3DGS.

The loss is 0.8 L1 + 0.2 (1 - SSIM) of a view (Kerbl et al. 2023, eq. 7), minimised by Adam; the
harmonics start at degree 0. Arrays have a row for each Gaussian of the budget, and rows that are
not in use are transparent, so that a step is compiled once.
"""

import dataclasses
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Literal, NamedTuple, cast, get_args

import densification
import jax
import jax.numpy as jnp
import numpy as np
import optax
from similarity import ssim

from gsc_jax.render.reprojection import reprojected
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.render.tiles import View, make_view
from gsc_jax.scene import Array, Camera, Gaussians
from gsc_jax.scene.errors import check_ranges
from gsc_jax.scene.neighbours import nearest_neighbours
from gsc_jax.splat import accumulate, render_view

INTERVAL = 100
"""Steps between two densifications, as in the code of 3DGS."""
DENSIFIED = (0.1, 0.6)
"""Shares of the steps between which Gaussians are added; in the code of 3DGS, 0.02 to 0.5."""
RESETS = (0.25, 0.45)
"""Shares of the steps at which adaptive density control resets opacities."""
REGULARISATION = 0.01
"""Weight of the mean opacity and of the mean scale in the loss of MCMC."""
RANGES: dict[str, tuple[float, float]] = {
    "iterations": (1, 10**9),
    "budget": (8, 10**9),
    "sh_degree": (0, 3),
    "ssim_weight": (0.0, 1.0),
}
"""Smallest and largest valid value of the numbers; integers where the number is one."""

SAMPLED = 8
"""Number of random views on which growth by error measures errors and blending weights."""

Strategy = Literal["adaptive", "mcmc", "error"]


@dataclasses.dataclass(frozen=True, kw_only=True)
class CaptureConfig:
    """How a scene is trained; the rates are those of the code of 3DGS.

    Attributes:
        iterations: Number of steps, one view each.
        budget: Largest number of Gaussians.
        sh_degree: Degree of the harmonics, 0 to 3; one more every `iterations / 10` steps.
        strategy: "adaptive" density control (Kerbl et al. 2023), "mcmc" relocation (Kheradmand et
            al. 2024) or growth by "error" (Rota Bulo et al. 2024).
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


Photograph = tuple[Camera, np.ndarray]
"""A camera and its image, RGB in [0, 1], shape (H, W, 3)."""


class Training(NamedTuple):
    """State of a training: rows of the budget, moments of Adam, and gradients in the image."""

    scene: Gaussians
    moments: Any
    gradient: jax.Array
    seen: jax.Array


def capture(
    cameras: Sequence[Camera],
    images: np.ndarray,
    points: Array,
    *,
    config: CaptureConfig | None = None,
    seed: int = 0,
    progress: Callable[[str, int, int], None] = lambda *_: None,
) -> Gaussians:
    """Train a scene from posed images.

    Args:
        cameras: V cameras with images of one size.
        images: Their images, RGB in [0, 1], shape (V, H, W, 3).
        points: Points on the surfaces, such as those of structure from motion, and their colours
            in [0, 1]: x, y, z, red, green, blue, shape (P, 6).
        config: Training options.
        seed: Seed of the random order of views and of all random draws.
        progress: Called with a stage, the number of steps done, and of all.

    Returns:
        At most `budget` Gaussians, NumPy float32, as a trainer stores them.

    Raises:
        ValueError: if the cameras, images and points do not fit together or are out of range.
    """
    images, points = np.asarray(images, np.float32), np.asarray(points)
    require_images(cameras, images)
    _require_points(points)
    config, rng = config or CaptureConfig(), np.random.default_rng(seed)
    cameras = [dataclasses.replace(camera, name="") for camera in cameras]  # compiled once for all
    extent, order = camera_extent(cameras), passes(len(cameras), rng)
    photographs = list(zip(cameras, images, strict=True))
    weights = config.ssim_weight, REGULARISATION if config.strategy == "mcmc" else 0.0
    training = started(initial_scene(points, config, rng))
    for step, index in zip(range(config.iterations), order, strict=False):
        camera = cameras[index]
        view = make_view(training.scene, camera)
        rates = learning_rates(step / config.iterations, extent, config)
        training = stepped(training, view, camera, images[index], rates, weights)
        if config.strategy == "mcmc":
            scene = training.scene
            moved = scene.means + densification.disturbance(scene, float(rates.means), rng)
            training = training._replace(scene=dataclasses.replace(scene, means=moved))
        done = (step + 1) / config.iterations
        if (step + 1) % INTERVAL == 0 and DENSIFIED[0] <= done <= DENSIFIED[1]:
            training = _densified(training, done, extent, config, rng, photographs)
        progress("capture", step + 1, config.iterations)
    host = jax.tree.map(np.asarray, training.scene)
    return host.take(np.flatnonzero(np.isfinite(host.logit_opacities)))


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


def _require_points(points: np.ndarray) -> None:
    if np.shape(points)[1:] != (6,) or len(points) < 4:
        raise ValueError(
            f"expected at least 4 points with colours, (P, 6), got shape {np.shape(points)}"
        )
    if not (np.isfinite(points).all() and (abs(points[:, 3:] - 0.5) <= 0.5).all()):
        raise ValueError("expected finite points with colours in [0, 1]")


def passes(count: int, rng: np.random.Generator) -> Iterator[int]:
    """Indices of views, without end: each pass has all of them, in an order of its own."""
    while True:
        yield from rng.permutation(count)


def camera_extent(cameras: Sequence[Camera]) -> float:
    """Radius of the cameras around their mean with a margin of 10 %, in world units."""
    centers = np.array([camera.center for camera in cameras])
    return 1.1 * float(np.linalg.norm(centers - centers.mean(axis=0), axis=1).max()) or 1.0


def initial_scene(points: np.ndarray, config: CaptureConfig, rng: np.random.Generator) -> Gaussians:
    """Round Gaussians of opacity 0.1 on at most half of the budget of the points."""
    rows = rng.permutation(len(points))[: config.budget // 2]
    points, colors = np.split(points[rows].astype(np.float32), 2, axis=1)
    near = nearest_neighbours(points, np.arange(len(points)), 3)
    spacing = np.linalg.norm(points[near] - points[:, None], axis=2).mean(axis=1)
    free = config.budget - len(points)
    sh = np.zeros((config.budget, (config.sh_degree + 1) ** 2, 3), np.float32)
    sh[: len(points), 0] = (colors - 0.5) / Y0
    logits = np.full(config.budget, -np.inf, np.float32)
    logits[: len(points)] = np.log(0.1 / 0.9)
    log_scales = np.log(np.maximum(spacing, 1e-7))[:, None].repeat(3, axis=1)
    return Gaussians(
        means=np.pad(points, ((0, free), (0, 0))),
        log_scales=np.pad(log_scales, ((0, free), (0, 0))).astype(np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (config.budget, 1)),
        logit_opacities=logits,
        sh=sh,
    )


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


def _densified(
    training: Training,
    done: float,
    extent: float,
    config: CaptureConfig,
    rng: np.random.Generator,
    photographs: Sequence[Photograph],
) -> Training:
    """The state after a densification."""
    scene, lowered = jax.tree.map(np.array, training.scene), np.zeros(config.budget, bool)
    if config.strategy == "mcmc":
        changed = densification.relocate(scene, rng, _growth(scene, done, config))
    elif config.strategy == "error":
        some = rng.choice(len(photographs), min(SAMPLED, len(photographs)), replace=False)
        error, importance = errors(training.scene, [photographs[k] for k in some])
        added = _growth(scene, done, config)
        changed = densification.grow_by_error(scene, error, extent, rng, added)
        if done + INTERVAL / config.iterations > DENSIFIED[1] + 1e-6:  # the last time
            densification.prune_unimportant(scene, np.where(changed, np.inf, importance))
    else:
        changed = densification.adapt_density(scene, mean_gradient(training), extent, rng)
        since = done - INTERVAL / config.iterations
        if config.reset_opacities and any(since < reset <= done for reset in RESETS):
            lowered = densification.reset_opacities(scene)
    return restarted(training, scene, changed, lowered)


def errors(scene: Gaussians, photographs: Sequence[Photograph]) -> tuple[np.ndarray, np.ndarray]:
    """Sums over the pixels by the weights of each Gaussian, both (N,).

    Of absolute errors, the largest of the views, and of the weights alone, the mean of the views.
    """
    lifted = []
    for camera, image in photographs:
        view = make_view(scene, camera)
        wrong = jnp.abs(render_view(view, scene, camera)[0] - image).mean(axis=2)
        lifted.append(accumulate(view, jnp.stack([wrong, jnp.ones_like(wrong)], axis=2)))
    sums = np.stack(lifted)
    return sums[..., 0].max(axis=0), sums[..., 1].mean(axis=0)


def mean_gradient(training: Training) -> np.ndarray:
    """Mean length of the gradient by the centre over the views that saw a Gaussian, (N,)."""
    return np.asarray(training.gradient / jnp.maximum(training.seen, 1))


def restarted(
    training: Training, scene: Gaussians, changed: np.ndarray, lowered: np.ndarray
) -> Training:
    """The state with a densified scene; the moments of rows that changed start again.

    So do those of the opacities that were lowered; both are masks of shape (N,).
    """
    mu, nu = (
        _forgotten(moment, changed, lowered)
        for moment in (training.moments.mu, training.moments.nu)
    )
    return started(scene)._replace(moments=training.moments._replace(mu=mu, nu=nu))


def _growth(scene: Gaussians, done: float, config: CaptureConfig) -> int:
    """Number of Gaussians to add at a time: 5 %, or more where that would not reach the budget."""
    used = int(np.isfinite(scene.logit_opacities).sum())
    left = int((DENSIFIED[1] - done) * config.iterations / INTERVAL + 1e-6) + 1
    wanted = round(used * (config.budget / used) ** (1 / left))
    return max(int(densification.GROWTH * used), wanted - used)


def _forgotten(moments: Gaussians, changed: np.ndarray, lowered: np.ndarray) -> Gaussians:
    """Moments of Adam, with 0 for the rows `changed` and the opacities `lowered`, (N,) bool."""
    kept = jnp.asarray(~changed, jnp.float32)
    moments = jax.tree.map(lambda leaf: leaf * per_row(kept, leaf), moments)
    logits = moments.logit_opacities * jnp.asarray(~lowered, jnp.float32)
    return dataclasses.replace(moments, logit_opacities=logits)


def per_row(values: jax.Array, leaf: jax.Array) -> jax.Array:
    """Values (N,) in the shape of a parameter (N, ...), for broadcasting."""
    return values.reshape(-1, *[1] * (leaf.ndim - 1))
