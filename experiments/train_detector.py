"""Does a small 2D network see edits in renders of a scene that it was never trained on?

    python experiments/train_detector.py [--keep .renders] [--steps 600]

The network looks for what editing does to pixels, not for things: residuals of a high-pass filter
beside a learned one, their energies near and far, and everything compared with the mean and the
deviation of the whole image. It answers at a quarter of the resolution. A network is trained for
every scene that leaves that scene out, on edits with seeds that no table uses, exported so that
host and object have the same digits, and on collages: blobs of untouched views that come from
another scene, change colour or size, or are filled. Their outlines follow nothing in the view, or
the network would learn what stands in the middle of a scene. It is judged on the scene left out:
the mean over views of the pixel AUC and of F1 at 0.5, once on those seeds and once on the seeds of
the tables. Beside it stands what knows nothing of the view: the mean truth of the other scenes,
for edits are rarely at the rim.
"""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax
from cases import DATA, available, edit_scene, load_scene
from jax import lax
from runner import start
from scipy.ndimage import affine_transform, gaussian_filter
from scipy.spatial.transform import Rotation
from tqdm import tqdm

from gsc_jax.benchmark.export import exported
from gsc_jax.benchmark.metrics import auc, f1_score, truth_mask
from gsc_jax.benchmark.tamper import EDITS
from gsc_jax.io.files import atomic
from gsc_jax.splat import render

FIRST_SEED = 10
UNTOUCHED, NONE_SEEDS = "none", 2
VIEWS = 6
"""Of a case, evenly spread, others for every seed."""
CELL = 4
"""Pixels along the side of a cell of the answer."""
WIDTH, WIDE, STATISTICS = 16, 32, 26
LUMA = np.array([0.299, 0.587, 0.114], np.float32)
CROP, BATCH, RATE, DECAY = 176, 6, 2e-3, 0.1
COLLAGES = 0.65
"""Share of a batch."""
DICE = 0.3
LEAST = 5e-4
"""Share of a view that must be tampered for the view to be judged."""

Network = dict[str, Any]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Args:
    """What to train on.

    Attributes:
        seeds: How many seeds per scene and edit, from 10 on.
        steps: Of each network.
        data: The real scenes; without them only made scenes are used.
        keep: Folder for the renders, so that a second run is quick.
    """

    seeds: int = 6
    steps: int = 600
    data: Path = DATA
    keep: Path = Path(".renders")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Renders:
    """Views of one case: images (V, H, W, 3) uint8 and truth (V, H, W) bool."""

    scene: str
    edit: str
    images: np.ndarray
    truth: np.ndarray


def renders(name: str, edit: str, seed: int, data: Path, keep: Path) -> Renders:
    """Render some views of a case, or read those that were rendered before."""
    path = keep / f"{name}-{edit}-{seed}.npz"
    if not path.exists():
        scene = load_scene(name, data)
        gaussians, labels = scene.gaussians, np.zeros(len(scene.gaussians), bool)
        if edit != UNTOUCHED:
            edited = edit_scene(name, edit, seed, data)  # type: ignore[arg-type]
            gaussians, labels = edited.gaussians, edited.labels
        gaussians = jax.tree.map(jnp.asarray, exported(gaussians, seed=seed))
        count = len(scene.cameras)
        cameras = [scene.cameras[(seed + k * count // VIEWS) % count] for k in range(VIEWS)]
        images = np.stack([np.asarray(render(gaussians, camera)[0]) for camera in cameras])
        truth = np.stack([truth_mask(gaussians, camera, labels) for camera in cameras])
        with atomic(path) as temporary, temporary.open("wb") as file:
            np.savez(file, images=np.round(255 * images.clip(0, 1)).astype(np.uint8), truth=truth)
    with np.load(path) as kept:
        return Renders(scene=name, edit=edit, images=kept["images"], truth=kept["truth"])


def high_pass() -> np.ndarray:
    """Five residual filters of steganalysis (Fridrich and Kodovsky, 2012), shape (5, 5, 1, 5)."""
    bank = np.zeros((5, 5, 5), np.float32)
    bank[0, 2, 1:4] = bank[1, 1:4, 2] = -0.5, 1, -0.5
    bank[2, 1:4, 1:4] = np.outer([1, -2, 1], [-1, 2, -1]) / 4
    edge = np.array([-1, 2, -2, 2, -1])
    bank[3] = [edge, [2, -6, 8, -6, 2], [-2, 8, -12, 8, -2], [2, -6, 8, -6, 2], edge]
    bank[3] /= 12
    bank[4] = -1 / 25
    bank[4, 2, 2] += 1
    return 20 * bank.transpose(1, 2, 0)[:, :, None]


def started(key: jax.Array) -> Network:
    """A network with random weights; residual branches begin near zero, as nothing normalises."""
    shapes = {
        "colours": (5, 3, WIDTH // 2, 0.7),
        "residuals": (3, 10, WIDTH // 2, 1.0),
        "near": (3, WIDTH, WIDTH, 1.0),
        "near_out": (3, WIDTH, WIDTH, 0.1),
        "down": (3, WIDTH, WIDE, 1.0),
        "statistics": (1, STATISTICS, WIDE, 1.0),
        "first": (3, WIDE, WIDE, 1.0),
        "first_out": (3, WIDE, WIDE, 0.1),
        "first_context": (1, 2 * WIDE, WIDE, 1.0),
        "second": (3, WIDE, WIDE, 1.0),
        "second_out": (3, WIDE, WIDE, 0.1),
        "second_context": (1, 2 * WIDE, WIDE, 1.0),
        "answer": (1, WIDE, 1, 0.1),
    }
    keys = jax.random.split(key, len(shapes))

    def layer(key: jax.Array, side: int, given: int, wanted: int, gain: float) -> Network:
        deviation = np.float32(gain * np.sqrt(2 / (side * side * given)))
        weights = deviation * jax.random.normal(key, (side, side, given, wanted))
        return {"weights": weights, "bias": jnp.zeros(wanted)}

    return {
        name: layer(key, *shape) for key, (name, shape) in zip(keys, shapes.items(), strict=True)
    }


def convolved(x: jax.Array, weights: jax.Array | np.ndarray, stride: int = 1) -> jax.Array:
    """A convolution of (B, H, W, C) that keeps the size up to its stride."""
    margin = weights.shape[0] // 2
    return lax.conv_general_dilated(
        x,
        jnp.asarray(weights),
        (stride, stride),
        [(margin, margin)] * 2,
        dimension_numbers=("NHWC", "HWIO", "NHWC"),
    )


def suspected(network: Network, images: jax.Array) -> jax.Array:
    """Logits of tampering.

    Args:
        network: As `started` makes it.
        images: RGB in [0, 1], shape (B, H, W, 3).

    Returns:
        Logits of the cells, shape (B, H / 4, W / 4), rounded up.
    """

    def layer(name: str, x: jax.Array, stride: int = 1) -> jax.Array:
        return convolved(x, network[name]["weights"], stride) + network[name]["bias"][None, None]

    def block(name: str, x: jax.Array) -> jax.Array:
        return x + layer(f"{name}_out", jax.nn.relu(layer(name, jax.nn.relu(x))))

    def context(name: str, x: jax.Array) -> jax.Array:
        return layer(f"{name}_context", jnp.concatenate([x, against_image(x)], -1))

    residual = jnp.clip(convolved((images @ LUMA)[..., None], high_pass()), -3, 3)
    both = jnp.concatenate([residual, jnp.abs(residual)], -1)
    x = [layer("colours", against_image(images), 2), layer("residuals", both, 2)]
    x = layer("down", jax.nn.relu(block("near", jnp.concatenate(x, -1))), 2)
    x = context("first", block("first", x + layer("statistics", statistics(images, residual))))
    x = context("second", block("second", x))
    return layer("answer", jax.nn.relu(x))[..., 0]


def against_image(x: jax.Array) -> jax.Array:
    """Features in deviations from their mean over the image."""
    away = x - x.mean((1, 2), keepdims=True)
    return away / jnp.sqrt((away**2).mean((1, 2), keepdims=True) + 1e-3)


def statistics(images: jax.Array, residual: jax.Array) -> jax.Array:
    """Log energies of the residuals and colours of the cells, alone and over 5 x 5 of them."""
    energy, colour = cells(jnp.abs(residual)), cells(images)
    light = (colour @ LUMA)[..., None]
    colour = jnp.concatenate([light, colour - light], -1)
    smooth = over_neighbours(colour)
    spread = jnp.sqrt(over_neighbours((colour - smooth) ** 2) + 1e-5)
    near = [jnp.log(energy + 0.02), colour]
    far = [jnp.log(over_neighbours(energy) + 0.02), smooth, jnp.log(spread)]
    finer = near[0][..., :4] - far[0][..., :4]
    return against_image(jnp.concatenate([*near, *far, finer], -1))


def cells(x: jax.Array) -> jax.Array:
    """Means over 4 x 4 pixels, the last cells completed by the pixels at the border."""
    batch, height, width, channels = x.shape
    x = jnp.pad(x, ((0, 0), (0, -height % CELL), (0, -width % CELL), (0, 0)), mode="edge")
    rows, columns = -(-height // CELL), -(-width // CELL)
    return x.reshape(batch, rows, CELL, columns, CELL, channels).mean((2, 4))


def over_neighbours(x: jax.Array) -> jax.Array:
    """Means over 5 x 5 cells, at the border over those that there are."""

    def total(values: jax.Array) -> jax.Array:
        return lax.reduce_window(values, np.float32(0), lax.add, (1, 5, 5, 1), (1,) * 4, "SAME")

    return total(x) / total(jnp.ones_like(x[:1, ..., :1]))


def loss(network: Network, images: jax.Array, shares: jax.Array) -> jax.Array:
    """Cross-entropy in which tampered and authentic count alike in each image, and a Dice loss."""
    logits, axes = suspected(network, images), (1, 2)
    tampered = shares.mean(axes, keepdims=True)
    some = tampered > 0.002
    balance = shares / jnp.maximum(tampered, 0.01) + (1 - shares) / jnp.maximum(1 - tampered, 0.01)
    entropy = jnp.where(some, balance, 1) / 2 * optax.sigmoid_binary_cross_entropy(logits, shares)
    found = jax.nn.sigmoid(logits)
    dice = 1 - (2 * (found * shares).sum(axes) + 1) / ((found + shares).sum(axes) + 1)
    return entropy.mean() + DICE * jnp.where(some[:, 0, 0], dice, 0).mean()


def trained(cases: Sequence[Renders], steps: int, seed: int = 0) -> Network:
    """A network that tells tampered pixels of these cases from authentic ones."""
    network = started(jax.random.key(seed))
    rate = optax.warmup_cosine_decay_schedule(0, RATE, steps // 20, steps, RATE / 100)
    optimiser = optax.chain(optax.clip_by_global_norm(1), optax.adamw(rate, weight_decay=DECAY))
    state, rng = optimiser.init(network), np.random.default_rng(seed)

    @jax.jit
    def step(network, state, images, shares):
        gradient = jax.grad(loss)(network, images, shares)
        updates, state = optimiser.update(gradient, state, network)
        return optax.apply_updates(network, updates), state

    kinds: dict[tuple[str, str], list[Renders]] = {}
    for case in cases:
        kinds.setdefault((case.scene, case.edit), []).append(case)
    groups = [group for (_, edit), group in kinds.items() for _ in range(1 + 2 * (edit in EDITS))]
    for _ in range(steps):
        network, state = step(network, state, *_batch(groups, rng))
    return network


def _batch(
    groups: Sequence[Sequence[Renders]], rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Crops (B, C, C, 3), turned, mirrored and with other colours, and shares of their cells."""
    images, truths = [], []

    def chance(count: int) -> int:
        return int(rng.integers(count))

    for _ in range(BATCH):
        group = groups[chance(len(groups))]
        image, truth = _crop(group, rng)
        if rng.random() < COLLAGES:
            scene = group[0].scene
            host = next(g for g in groups if g[0].edit == UNTOUCHED and g[0].scene == scene)
            others = [g for g in groups if g[0].scene != scene] or groups
            other, _ = _crop(others[chance(len(others))], rng)
            image, truth = collage(_crop(host, rng)[0], other, rng)
        turns, mirrored = chance(4), 1 - 2 * chance(2)
        image = np.rot90(image, turns)[:, ::mirrored]
        image = image[..., rng.permutation(3)] * np.exp(rng.normal(0, 0.15, 3))
        images.append(np.clip(image, 1e-4, 1) ** np.exp(rng.normal(0, 0.2)))
        truths.append(np.rot90(truth, turns)[:, ::mirrored])
    return np.stack(images).astype(np.float32), shares_of(np.stack(truths))


def _crop(group: Sequence[Renders], rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    case = group[int(rng.integers(len(group)))]
    view = int(rng.integers(len(case.images)))
    top, left = (int(rng.integers(side - CROP + 1)) for side in case.truth.shape[1:])
    crop = np.s_[view, top : top + CROP, left : left + CROP]
    return case.images[crop] / np.float32(255), case.truth[crop]


def collage(
    image: np.ndarray, other: np.ndarray, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Change a blob of an image (C, C, 3) in some way; returns it and where it was changed."""

    def larger(x: np.ndarray, factor: float) -> np.ndarray:
        shift = [*rng.uniform(0, side * (1 - 1 / factor), 2), 0]
        return affine_transform(x, [1 / factor, 1 / factor, 1], shift, order=1)  # type: ignore[arg-type]

    side, mask = len(image), _blob(len(image), rng)
    kind = rng.choice(["splice", "splice", "hue", "pattern", "larger", "filled"])
    if kind == "splice":
        inside = larger(np.rot90(other, int(rng.integers(4))), rng.uniform(1, 1.6))
    elif kind == "hue":
        turn = Rotation.from_rotvec(np.radians(rng.uniform(80, 280)) * np.ones(3) / np.sqrt(3))
        inside = (image - 0.5) @ turn.as_matrix().T + 0.5 + rng.normal(0, 0.1)
    elif kind == "pattern":
        angle, wave = rng.uniform(0, 2 * np.pi), rng.uniform(5, 16)
        rows, columns = np.mgrid[:side, :side] * 2 * np.pi / wave
        stripes = np.sign(np.sin(np.cos(angle) * columns + np.sin(angle) * rows))
        inside = image + gaussian_filter(stripes, 0.8)[..., None] * rng.normal(0, 0.15, 3)
    elif kind == "larger":
        inside = larger(image, rng.uniform(1.3, 1.7))
    else:
        copied = np.roll(image, tuple(rng.integers(-side // 2, side // 2, 2)), (0, 1))
        blur = rng.uniform(2, 8) if rng.random() < 0.5 else rng.uniform(0.3, 1.2)
        inside = gaussian_filter(copied, (blur, blur, 0))
    soft = gaussian_filter(mask.astype(np.float32), 0.6)[..., None]
    return np.clip(image + soft * (inside - image), 0, 1), mask


def _blob(side: int, rng: np.random.Generator) -> np.ndarray:
    """An ellipse with a wavy outline, shape (C, C)."""
    rows, columns = np.mgrid[:side, :side] - rng.uniform(0.15, 0.85, (2, 1, 1)) * side
    angle, stretch = rng.uniform(0, 2 * np.pi), np.exp(rng.normal(0, 0.3))
    along = (np.cos(angle) * columns + np.sin(angle) * rows) * stretch
    across = (np.cos(angle) * rows - np.sin(angle) * columns) / stretch
    turn = np.arctan2(across, along)
    waves = [rng.normal(0, 0.22 / k) * np.cos(k * turn + rng.uniform(0, 6.3)) for k in range(2, 8)]
    return np.hypot(along, across) < rng.uniform(0.09, 0.24) * side * (1 + np.sum(waves, axis=0))


def shares_of(truth: np.ndarray) -> np.ndarray:
    """How much of each cell is tampered, shape (B, h, w)."""
    return np.asarray(cells(jnp.asarray(truth[..., None], jnp.float32))[..., 0])


def judged(answer: Callable[[np.ndarray], np.ndarray], cases: Sequence[Renders]) -> dict[str, str]:
    """Mean pixel AUC and F1 over the views in which something is tampered, by edit."""
    found: dict[str, list[tuple[float, float]]] = {edit: [] for edit in EDITS}
    for case in cases:
        logits, truth = answer(case.images / np.float32(255)), shares_of(case.truth) > 0.5
        found[case.edit] += [
            (auc(guess, cell), f1_score(guess > 0, cell))
            for guess, cell, whole in zip(logits, truth, case.truth, strict=True)
            if whole.mean() > LEAST and cell.any()
        ]
    means = {edit: np.mean(scores, axis=0) for edit, scores in found.items() if scores}
    return {edit: f"{area:.3f} ({f1:.3f})" for edit, (area, f1) in means.items()}


def where_edits_are(cases: Sequence[Renders]) -> np.ndarray:
    """The mean truth of cases, log odds of the cells, shape (h, w): what looks at nothing knows."""
    mean = np.mean([shares_of(case.truth).mean(axis=0) for case in cases], axis=0)
    return np.log(mean + 1e-4) - np.log(1 - mean + 1e-4)


def main(args: Args) -> None:
    """Train without each scene in turn, and print pixel AUC (F1) by edit."""
    args.keep.mkdir(parents=True, exist_ok=True)

    def all_of(edits: Sequence[str], seeds: Sequence[int]) -> list[Renders]:
        keys = [(s, e, k) for s in available(args.data) for e in edits for k in seeds]
        return [renders(*key, args.data, args.keep) for key in tqdm(keys, desc="renders")]

    last = FIRST_SEED + args.seeds
    edited = all_of(EDITS, range(FIRST_SEED, last))
    untouched = all_of([UNTOUCHED], range(FIRST_SEED, min(last, FIRST_SEED + NONE_SEEDS)))
    sets: Mapping[str, list[Renders]] = {"training": edited, "tables": all_of(EDITS, range(3))}
    answer = jax.jit(suspected)
    for scene in available(args.data):
        others = [case for case in edited if case.scene != scene]
        network = trained([*others, *(c for c in untouched if c.scene != scene)], args.steps)
        prior = where_edits_are(others)
        for name, cases in sets.items():
            mine = [case for case in cases if case.scene == scene]
            said = judged(lambda images, n=network: np.asarray(answer(n, images)), mine)
            print(f"{scene}, seeds of the {name}: {said}, without looking: ", end="")
            print(judged(lambda images, p=prior: np.broadcast_to(p, (len(images), *p.shape)), mine))


if __name__ == "__main__":
    start(main, __doc__)
