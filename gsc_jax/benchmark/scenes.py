"""A made scene with exact truth: a furnished room with a foreign object, and cameras.

The demo and the tests run on it, since no trained scene can be shipped. The object has the
statistics of another training, like an object cut from another model, and the rows are shuffled, so
that neither order nor position in the file reveals it. Metres, y down, floor at y = 0. Textures are
images of scikit-image, so nothing is downloaded; if they are missing, there is an InputError.
"""

import dataclasses

import numpy as np

from gsc_jax.benchmark.furniture import TABLE, room_parts, vase_parts
from gsc_jax.benchmark.surfaces import UP, TrainingStatistics, sample_parts
from gsc_jax.render.orbit import look_at
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.camera import intrinsics
from gsc_jax.scene.gaussians import concatenate

OBJECT_FOOT = np.array([0.15, -TABLE, 0.05])
FLOATER_SHARE = 0.03
OBJECT_STATISTICS = TrainingStatistics(
    overlap=0.75, thickness=0.03, spread=0.4, opacity=(2.4, 1.8), gloss=0.12, lit=0.15
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class MadeScene:
    """A scene, rows shuffled, with cameras for the estimator and other ones for the metrics.

    `labels` (N,) is True where a Gaussian belongs to the pasted object.
    """

    gaussians: Gaussians
    cameras: list[Camera]
    heldout_cameras: list[Camera]
    labels: np.ndarray


def make_room(*, seed: int = 0, count: int = 50_000) -> Gaussians:
    """Make a furnished, textured room of `count` Gaussians of degree 1."""
    rng = np.random.default_rng(seed)
    floaters = round(count * FLOATER_SHARE)
    statistics = TrainingStatistics()
    surfaces = sample_parts(room_parts(rng), count - floaters, statistics=statistics, rng=rng)
    return concatenate([surfaces, _floaters(surfaces, floaters, rng)])


def make_object(*, seed: int = 0, count: int = 5_000) -> Gaussians:
    """Make a vase, 0.6 m high, that stands on the origin, of `count` Gaussians of degree 1."""
    rng = np.random.default_rng([seed, 1])
    return sample_parts(vase_parts(), count, statistics=OBJECT_STATISTICS, rng=rng)


def room_cameras(
    n: int, *, width: int = 480, height: int = 360, seed: int = 0, prefix: str = "room"
) -> list[Camera]:
    """Make n hand-held cameras around the table, `room_000` etc.; every eighth looks aside."""
    rng = np.random.default_rng([seed, 2])
    turns = 2 * np.pi * (np.arange(n) + rng.random() + rng.uniform(-0.3, 0.3, n)) / max(n, 1)
    K = intrinsics(0.75 * width, width, height)
    cameras = []
    for i, turn in enumerate(turns):
        position = np.array([1.7 * np.cos(turn), -rng.uniform(1.25, 1.75), 1.5 * np.sin(turn)])
        aside = 2.2 * np.array([-np.sin(turn), 0, np.cos(turn)]) if i % 8 == 5 else np.zeros(3)
        target = OBJECT_FOOT + 0.15 * UP + aside + rng.normal(0, [0.2, 0.1, 0.2])
        view, name = look_at(position, target, UP), f"{prefix}_{i:03d}"
        cameras.append(Camera(viewmat=view, K=K, width=width, height=height, name=name))
    return cameras


def tampered_room(
    *,
    seed: int = 0,
    count: int = 50_000,
    views: int = 24,
    heldout: int = 6,
    width: int = 480,
    height: int = 360,
) -> MadeScene:
    """Make the room with the object, a tenth of all `count` Gaussians, on its table."""
    foreign = count // 10
    room = make_room(seed=seed, count=count - foreign)
    pasted = make_object(seed=seed, count=foreign)
    pasted = dataclasses.replace(pasted, means=pasted.means + OBJECT_FOOT.astype(np.float32))
    order = np.random.default_rng([seed, 3]).permutation(count)
    gaussians, labels = concatenate([room, pasted]).take(order), order >= len(room)
    cameras = room_cameras(views, width=width, height=height, seed=seed)
    others = room_cameras(heldout, width=width, height=height, seed=seed + 1, prefix="heldout")
    return MadeScene(gaussians=gaussians, cameras=cameras, heldout_cameras=others, labels=labels)


def _floaters(surfaces: Gaussians, count: int, rng: np.random.Generator) -> Gaussians:
    """Large faint Gaussians near surfaces and in the air, as training leaves them."""
    near = surfaces.take(rng.integers(len(surfaces), size=count))
    shift = rng.normal(0, 0.2, (count, 3)) * rng.random((count, 1))
    size = np.log(rng.lognormal(np.log(0.04), 0.5, (count, 1))) + rng.normal(0, 0.4, (count, 3))
    logits = rng.normal(-2.5, 1.0, count)
    columns = {"means": near.means + shift, "log_scales": size, "logit_opacities": logits}
    return dataclasses.replace(near, **{k: c.astype(np.float32) for k, c in columns.items()})
