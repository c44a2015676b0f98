"""A made scene with exact truth: a furnished room, a foreign object on its table, and cameras.

It stands in for a trained scene where none can be shipped: the demo and the tests run on it. The
object has the statistics of another training (`FOREIGN`), as in an edit that pastes an object cut
from another model, and the rows are shuffled, so neither order nor position in the file tells.

Metres, y down, floor at y = 0. The textures are images that ship inside scikit-image, so nothing is
downloaded.
"""

import dataclasses

import jax
import numpy as np

from gsc_jax.benchmark.furniture import TABLE, room_parts, vase_parts
from gsc_jax.benchmark.surfaces import UP, Habits, made_of
from gsc_jax.render.orbit import look_at
from gsc_jax.scene import Camera, Gaussians

OBJECT_FOOT = np.array([0.15, -TABLE, 0.05])
FLOATER_SHARE = 0.03
FOREIGN = Habits(overlap=0.75, thickness=0.03, spread=0.4, opacity=(2.4, 1.8), gloss=0.12, lit=0.15)


@dataclasses.dataclass(frozen=True, kw_only=True)
class MadeScene:
    """A scene with an object pasted in, and the truth.

    Attributes:
        gaussians: N Gaussians, rows shuffled.
        cameras: Views for the method.
        heldout_cameras: Other views, for the metrics.
        labels: True where a Gaussian belongs to the pasted object, shape (N,).
    """

    gaussians: Gaussians
    cameras: list[Camera]
    heldout_cameras: list[Camera]
    labels: np.ndarray


def make_room(*, seed: int = 0, count: int = 50_000) -> Gaussians:
    """A furnished, textured room.

    Args:
        seed: What the sampling and the books on the shelf follow.
        count: Number of Gaussians N, floaters included.

    Returns:
        N Gaussians of degree 1.

    Raises:
        InputError: if the installed scikit-image lacks its images.
    """
    rng = np.random.default_rng(seed)
    floaters = round(count * FLOATER_SHARE)
    surfaces = made_of(room_parts(rng), count - floaters, habits=Habits(), rng=rng)
    return concatenate([surfaces, _floaters(surfaces, floaters, rng)])


def make_object(*, seed: int = 0, count: int = 5_000) -> Gaussians:
    """A vase with two handles and a finial, 0.6 m high, that stands on the origin.

    Args:
        seed: What the sampling follows.
        count: Number of Gaussians N.

    Returns:
        N Gaussians of degree 1 with the statistics of another training than the room's.

    Raises:
        InputError: if the installed scikit-image lacks its images.
    """
    rng = np.random.default_rng([seed, 1])
    return made_of(vase_parts(), count, habits=FOREIGN, rng=rng)


def room_cameras(
    n: int, *, width: int = 480, height: int = 360, seed: int = 0, prefix: str = "room"
) -> list[Camera]:
    """Cameras of somebody walking once around the table, looking mostly at it.

    Args:
        n: Number of cameras.
        width: Image width in pixels.
        height: Image height in pixels.
        seed: Where the walk starts and how the hand shakes.
        prefix: What the names start with: `room_000` and so on.

    Returns:
        n cameras inside the room. Every eighth looks along the wall instead of at the table.
    """
    rng = np.random.default_rng([seed, 2])
    turns = 2 * np.pi * (np.arange(n) + rng.random() + rng.uniform(-0.3, 0.3, n)) / max(n, 1)
    focal = 0.75 * width
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], np.float32)
    views = []
    for i, turn in enumerate(turns):
        position = np.array([1.7 * np.cos(turn), -rng.uniform(1.25, 1.75), 1.5 * np.sin(turn)])
        aside = 2.2 * np.array([-np.sin(turn), 0, np.cos(turn)]) if i % 8 == 5 else np.zeros(3)
        target = OBJECT_FOOT + 0.15 * UP + aside + rng.normal(0, [0.2, 0.1, 0.2])
        views.append(look_at(position, target, UP))
    return [
        Camera(viewmat=view, K=intrinsics, width=width, height=height, name=f"{prefix}_{i:03d}")
        for i, view in enumerate(views)
    ]


def tampered_room(
    *,
    seed: int = 0,
    count: int = 50_000,
    views: int = 24,
    heldout: int = 6,
    width: int = 480,
    height: int = 360,
) -> MadeScene:
    """The room with the object on its table, a tenth of all Gaussians.

    Args:
        seed: What everything follows.
        count: Number of Gaussians N.
        views: Number of cameras for the method.
        heldout: Number of other cameras, for the metrics.
        width: Image width in pixels.
        height: Image height in pixels.

    Returns:
        The scene, its cameras and the truth.

    Raises:
        InputError: if the installed scikit-image lacks its images.
    """
    foreign = count // 10
    room = make_room(seed=seed, count=count - foreign)
    pasted = make_object(seed=seed, count=foreign)
    pasted = dataclasses.replace(pasted, means=pasted.means + OBJECT_FOOT.astype(np.float32))
    order = np.random.default_rng([seed, 3]).permutation(count)
    return MadeScene(
        gaussians=concatenate([room, pasted]).take(order),
        cameras=room_cameras(views, width=width, height=height, seed=seed),
        heldout_cameras=room_cameras(
            heldout, width=width, height=height, seed=seed + 1, prefix="heldout"
        ),
        labels=order >= len(room),
    )


def concatenate(scenes: list[Gaussians]) -> Gaussians:
    """The Gaussians of several scenes of one degree, in order."""
    return jax.tree.map(lambda *leaves: np.concatenate(leaves), *scenes)


def _floaters(surfaces: Gaussians, count: int, rng: np.random.Generator) -> Gaussians:
    """Fuzzy, faint Gaussians near surfaces and in the air, as training leaves them."""
    near = surfaces.take(rng.integers(len(surfaces), size=count))
    shift = rng.normal(0, 0.2, (count, 3)) * rng.random((count, 1))
    size = np.log(rng.lognormal(np.log(0.04), 0.5, (count, 1))) + rng.normal(0, 0.4, (count, 3))
    return dataclasses.replace(
        near,
        means=(near.means + shift).astype(np.float32),
        log_scales=size.astype(np.float32),
        logit_opacities=rng.normal(-2.5, 1.0, count).astype(np.float32),
    )
