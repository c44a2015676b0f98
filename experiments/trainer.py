"""Captures: scenes trained from posed images, with the loss and the rates of 3DGS.

The harmonics start at degree 0. Arrays have a row for each Gaussian of the budget, and rows that
are not in use are transparent, so that a step is compiled once.
"""

import dataclasses
from collections.abc import Callable, Sequence

import densification
import jax
import jax.numpy as jnp
import numpy as np

from gsc_jax.benchmark.training import (
    CaptureConfig,
    Training,
    camera_extent,
    learning_rates,
    passes,
    per_row,
    require_images,
    started,
    stepped,
)
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.render.tiles import make_view
from gsc_jax.scene import Array, Camera, Gaussians
from gsc_jax.scene.neighbours import nearest_neighbours

INTERVAL = 100
"""Steps between two densifications, as in the code of 3DGS."""
DENSIFIED = (0.1, 0.6)
"""Shares of the steps between which Gaussians are added; in the code of 3DGS, 0.02 to 0.5."""
RESETS = (0.25, 0.45)
"""Shares of the steps at which adaptive density control resets opacities."""
REGULARISATION = 0.01
"""Weight of the mean opacity and of the mean scale in the loss of MCMC."""


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
    extent, order = camera_extent(cameras), passes(len(cameras), rng)
    weights = config.ssim_weight, REGULARISATION if config.strategy == "mcmc" else 0.0
    training = started(initial_scene(points, config, rng))
    for step, index in zip(range(config.iterations), order, strict=False):
        camera = dataclasses.replace(cameras[index], name="")  # static: one compilation for all
        view = make_view(training.scene, camera)
        rates = learning_rates(step / config.iterations, extent, config)
        training = stepped(training, view, camera, images[index], rates, weights)
        if config.strategy == "mcmc":
            scene = training.scene
            moved = scene.means + densification.disturbance(scene, float(rates.means), rng)
            training = training._replace(scene=dataclasses.replace(scene, means=moved))
        done = (step + 1) / config.iterations
        if (step + 1) % INTERVAL == 0 and DENSIFIED[0] <= done <= DENSIFIED[1]:
            training = _densified(training, done, extent, config, rng)
        progress("capture", step + 1, config.iterations)
    host = jax.tree.map(np.asarray, training.scene)
    return host.take(np.flatnonzero(np.isfinite(host.logit_opacities)))


def _require_points(points: np.ndarray) -> None:
    if np.shape(points)[1:] != (6,) or len(points) < 4:
        raise ValueError(
            f"expected at least 4 points with colours, (P, 6), got shape {np.shape(points)}"
        )
    if not (np.isfinite(points).all() and (abs(points[:, 3:] - 0.5) <= 0.5).all()):
        raise ValueError("expected finite points with colours in [0, 1]")


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


def _densified(
    training: Training,
    done: float,
    extent: float,
    config: CaptureConfig,
    rng: np.random.Generator,
) -> Training:
    """The state after a densification; the moments of changed rows start again."""
    scene, lowered = jax.tree.map(np.array, training.scene), np.zeros(config.budget, bool)
    if config.strategy == "mcmc":
        changed = densification.relocate(scene, rng, _growth(scene, done, config))
    else:
        gradient = np.asarray(training.gradient / jnp.maximum(training.seen, 1))
        changed = densification.adapt_density(scene, gradient, extent, rng)
        since = done - INTERVAL / config.iterations
        if config.reset_opacities and any(since < reset <= done for reset in RESETS):
            lowered = densification.reset_opacities(scene)
    mu, nu = (
        _forgotten(moment, changed, lowered)
        for moment in (training.moments.mu, training.moments.nu)
    )
    return started(scene)._replace(moments=training.moments._replace(mu=mu, nu=nu))


def _growth(scene: Gaussians, done: float, config: CaptureConfig) -> int:
    """Number of Gaussians that MCMC adds: 5 %, or more where that would not reach the budget."""
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
