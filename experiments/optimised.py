"""Edits as editors make them: views are edited, and the Gaussians of a region optimised for them.

GaussianEditor (Chen et al. 2024) and DGE (Chen et al. 2024) edit the images of a scene with a 2D
program, and train the Gaussians inside of a 3D mask on them, held near to what they were. Here the
2D program is an image filter. With densification, as both have it, Gaussians of the region are
cloned, split and pruned. Laundering trains the whole scene a little more on its own renders, which
blurs what an edit has left.
"""

import dataclasses
from collections.abc import Callable, Sequence

import densification
import jax
import jax.numpy as jnp
import numpy as np
import trainer
from scipy.spatial.transform import Rotation

from gsc_jax.benchmark import regions
from gsc_jax.benchmark.metrics import rendered_share
from gsc_jax.benchmark.modification import changed_rows, with_rows
from gsc_jax.render.projection import NEAR
from gsc_jax.render.tiles import make_view
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.gaussians import concatenate
from gsc_jax.splat import render

PROGRESS = 0.5
"""Share of the steps of a capture after which it has the learning rates that are used here."""
INTERVAL, DENSIFIED = 50, 0.6
"""Every 50 steps there is a densification, but none in the last 40 % of the steps."""

ImageEdit = Callable[[np.ndarray], np.ndarray]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Refinement:
    """How Gaussians are optimised for images.

    Attributes:
        steps: Number of steps, one view each.
        anchor: Share of the way back to its first value that each parameter takes in a step.
        near: Near plane in world units.
        seed: Seed of the order of the views, and of where split Gaussians go.
        densify: Whether Gaussians are cloned, split and pruned, as in a capture. Rows with an
            opacity of 0 (a logit of minus infinity) are then free for new ones.
    """

    steps: int = 300
    anchor: float = 0.01
    near: float = NEAR
    seed: int = 0
    densify: bool = False


def refine(
    gaussians: Gaussians,
    cameras: Sequence[Camera],
    images: np.ndarray,
    *,
    rows: np.ndarray | None = None,
    options: Refinement | None = None,
) -> Gaussians:
    """Optimise Gaussians for images with the loss of a capture.

    The images of V cameras are RGB in [0, 1], (V, H, W, 3). Only `rows` (N,) bool may change, by
    default all; others, infinite opacities and infinite scales stay as they are, to the bit, except
    for opacities of 0 where Gaussians are densified. Returns NumPy float32; cameras and images that
    do not fit together raise ValueError.
    """
    trainer.require_images(cameras, images)
    options, config = options or Refinement(), trainer.CaptureConfig(sh_degree=gaussians.sh_degree)
    first = jax.tree.map(jnp.asarray, gaussians)
    rows = np.ones(len(first), bool) if rows is None else rows
    mask, extent = jnp.asarray(rows, jnp.float32), trainer.camera_extent(cameras)
    rates = trainer.learning_rates(PROGRESS, extent, config)
    rates = jax.tree.map(lambda rate, leaf: rate * trainer.per_row(mask, leaf), rates, first)
    state, weights = trainer.started(first), (config.ssim_weight, 0.0)
    rng = np.random.default_rng(options.seed)
    order = trainer.passes(len(cameras), rng)
    for step, index in zip(range(options.steps), order, strict=False):
        camera = dataclasses.replace(cameras[index], name="")  # static: one compilation for all
        view = make_view(state.scene, camera, near=options.near)
        state = trainer.stepped(state, view, camera, images[index], rates, weights)
        state = state._replace(scene=_drawn_back(state.scene, first, mask, options.anchor))
        due = (step + 1) % INTERVAL == 0 and step < DENSIFIED * options.steps
        if options.densify and due:
            state, first = _densified(state, first, rows, extent, rng)
    return jax.tree.map(np.asarray, state.scene)


def _densified(
    state: trainer.Training,
    first: Gaussians,
    rows: np.ndarray,
    extent: float,
    rng: np.random.Generator,
) -> tuple[trainer.Training, Gaussians]:
    """The state and the anchor after a densification; what it changed or pruned is its own."""
    scene = jax.tree.map(np.array, state.scene)
    changed = densification.adapt_density(scene, trainer.mean_gradient(state), extent, rng, rows)
    state = trainer.restarted(state, scene, changed, np.zeros_like(changed))
    other = jnp.asarray(changed | (rows & np.isneginf(scene.logit_opacities)))

    def anchor(old: jax.Array, new: np.ndarray) -> jax.Array:
        return jnp.where(trainer.per_row(other, old), jnp.asarray(new), old)

    return state, jax.tree.map(anchor, first, scene)


@jax.jit
def _drawn_back(scene: Gaussians, first: Gaussians, mask: jax.Array, share: float) -> Gaussians:
    def drawn_back(leaf: jax.Array, old: jax.Array) -> jax.Array:
        # Opacities and scales may be infinite, and their differences then are not numbers.
        free = jnp.isfinite(old) & (trainer.per_row(mask, leaf) > 0)
        return jnp.where(free, leaf + share * (old - leaf), old)

    return jax.tree.map(drawn_back, scene, first)


def laundered(
    gaussians: Gaussians, cameras: Sequence[Camera], *, options: Refinement | None = None
) -> Gaussians:
    """Train a whole scene a little more, on its own renders in 8 bits; see `refine`."""
    options = options or Refinement(anchor=0.0)
    images = np.round(255 * renders(gaussians, cameras, options.near)).astype(np.float32) / 255
    return refine(gaussians, cameras, images, options=options)


def optimise_region(
    gaussians: Gaussians,
    visibility: regions.Visibility,
    size: float,
    rng: np.random.Generator,
    *,
    densify: bool = False,
) -> regions.ProposedEdit:
    """Edit the images of a random region, and optimise its Gaussians for them.

    The arguments are those of `modify_region`; the views are those of the visibility. With
    `densify`, the region may have up to twice as many Gaussians afterwards, and loses some.
    """
    region = regions.draw_object(gaussians, visibility, size, rng)
    rows = np.isin(np.arange(len(gaussians)), region.rows)
    name = str(rng.choice(list(IMAGE_EDITS)))
    change, cameras = IMAGE_EDITS[name](rng), visibility.cameras
    shares = [rendered_share(gaussians, camera, rows, near=visibility.near) for camera in cameras]
    inside = np.stack(shares)[..., None]
    images = renders(gaussians, cameras, visibility.near)
    targets = images + inside * (np.stack([change(image) for image in images]) - images)
    seed = int(rng.integers(2**31))
    options = Refinement(near=visibility.near, seed=seed, densify=densify)
    before = _with_free_rows(gaussians, rows) if densify else gaussians
    rows = np.append(rows, np.ones(len(before) - len(gaussians), bool))
    after = refine(before, cameras, targets.astype(np.float32), rows=rows, options=options)
    with np.errstate(invalid="ignore"):  # rows that were free and still are
        labels = rows & changed_rows(before, after, region.radius)
    what = f"a region of {labels.sum():,} Gaussians, optimised for images that were {name}"
    edited = with_rows(before, labels, after.take(labels))
    kept = np.flatnonzero(~(rows & np.isneginf(edited.logit_opacities)) | (not densify))
    return regions.ProposedEdit(edited.take(kept), labels[kept], what, gaussians)


def _with_free_rows(gaussians: Gaussians, rows: np.ndarray) -> Gaussians:
    """The scene, and after its last row a transparent copy of each of the marked rows."""
    copies = gaussians.take(np.flatnonzero(rows))
    logits = np.full(len(copies), -np.inf, np.float32)
    return concatenate([gaussians, dataclasses.replace(copies, logit_opacities=logits)])


def renders(gaussians: Gaussians, cameras: Sequence[Camera], near: float) -> np.ndarray:
    """Images of a scene, shape (V, H, W, 3)."""
    scene = jax.tree.map(jnp.asarray, gaussians)
    return np.stack([np.asarray(render(scene, camera, near=near)[0]) for camera in cameras])


def _recoloured(rng: np.random.Generator) -> ImageEdit:
    turn = Rotation.from_rotvec(rng.uniform(1.5, 4.5) * np.ones(3) / np.sqrt(3)).as_matrix()
    shift = rng.uniform(-0.15, 0.15, 3)
    return lambda image: np.clip(0.5 + (image - 0.5) @ turn.T + shift, 0, 1)


def _textured(rng: np.random.Generator) -> ImageEdit:
    """Stripes in the image, which no surface has: what a 2D program does differs between views."""
    direction, tint = rng.normal(size=2), rng.uniform(0.1, 0.3) * rng.choice([-1, 1], 3)

    def change(image: np.ndarray) -> np.ndarray:
        height, width = image.shape[:2]
        y, x = np.mgrid[:height, :width] / height
        phase = 2 * np.pi * 12 * (direction[0] * x + direction[1] * y)
        return np.clip(image + np.where(np.sin(phase) > 0, 1, -1)[..., None] * tint, 0, 1)

    return change


def _smoothed(rng: np.random.Generator) -> ImageEdit:
    from skimage.filters import gaussian

    sigma, gain = rng.uniform(2, 4), rng.uniform(0.6, 1.4)
    return lambda image: np.clip(gain * gaussian(image, sigma, channel_axis=2), 0, 1)


def _shifted(rng: np.random.Generator) -> ImageEdit:
    """Wave-like displacement of the pixels."""
    from skimage.transform import warp

    size, waves, turn = rng.uniform(0.01, 0.03), rng.uniform(3, 8), rng.uniform(0, 2 * np.pi)

    def change(image: np.ndarray) -> np.ndarray:
        height = image.shape[0]

        def source(places: np.ndarray) -> np.ndarray:
            wave = np.sin(2 * np.pi * waves * places[:, ::-1] / height + turn)
            return places + size * height * wave

        return np.clip(warp(image, source, mode="edge"), 0, 1)

    return change


IMAGE_EDITS: dict[str, Callable[[np.random.Generator], ImageEdit]] = {
    "recoloured": _recoloured,
    "textured": _textured,
    "smoothed": _smoothed,
    "warped": _shifted,
}
"""Programs that edit an image, drawn with random settings."""
