"""A second made scene, outdoors: a walled garden around a fountain, and cameras that walk in it.

Unlike the room it has an uneven floor, foliage, a far background of few wide Gaussians and a sun,
so that experiments do not depend on one room. Lawn, path, lawn, wall, hills and sky are rings
around the fountain. Metres, y down, the ground about y = 0; an object can be put on `PLINTH`.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from gsc_jax.benchmark import surfaces
from gsc_jax.benchmark.furniture import BRICK, OAK, WALNUT
from gsc_jax.benchmark.surfaces import (
    UP,
    Part,
    Surface,
    Texture,
    TrainingStatistics,
    Vector,
    revolve,
    sample_parts,
)
from gsc_jax.render.orbit import look_at
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Camera, Gaussians
from gsc_jax.scene.camera import intrinsics
from gsc_jax.scene.gaussians import concatenate

LAWN, PATH, WALL, HORIZON = 2.4, 3.5, 5.8, 16.0
"""Outer radii of the inner lawn, the path, the outer lawn and the hills, in metres."""
SUN = np.array([0.55, -0.75, -0.37])
MATT = TrainingStatistics(lit=0.0, gloss=0.02)

GRASS = Texture("grass.png", (0.95, 1.15, 0.6), (12, 3), contrast=0.8)
GRAVEL = Texture("gravel.png", (1.45, 1.3, 1.05), (10, 1), contrast=0.7)
STONE = Texture("gravel.png", (1.5, 1.45, 1.35), (2, 1), contrast=0.4)
BRONZE = Texture("gravel.png", (0.55, 0.95, 0.75), contrast=0.5)
WATER = Texture("moon.png", (0.6, 0.95, 1.15), contrast=0.6)
SKY = Texture("moon.png", (1.35, 1.6, 1.9), (2, 1), contrast=0.4)
LEAVES = Texture("grass.png", (0.7, 1.0, 0.4), (2, 2), contrast=1.2)
FLOWERS = Texture("coffee.png", (1.5, 0.9, 1.2), (2, 2), contrast=1.3)


def ground(x: float | np.ndarray, z: float | np.ndarray) -> np.ndarray:
    """Height of the uneven ground in metres."""
    swell = 0.1 * np.sin(1.1 * x + 0.7 * z) + 0.07 * np.sin(1.9 * z - 0.8 * x + 1.0)
    return swell * np.clip(np.hypot(x, z) - 0.9, 0, 1)


def _foot(x: float, z: float) -> np.ndarray:
    # Below the ground by 0.05, since the ground slopes under a wide foot.
    return np.array([x, 0.05 - ground(x, z), z])


PLINTH = _foot(1.0, -0.95) + 0.75 * UP
"""Centre of the top of an empty plinth."""


def make_garden(*, seed: int = 0, count: int = 50_000) -> Gaussians:
    """Make a garden of `count` Gaussians of degree 1; a thirtieth is sky, a thirtieth floaters.

    Raises:
        ValueError: if the count is below 3.
        InputError: if the installed scikit-image lacks its images.
    """
    rng = np.random.default_rng([seed, 4])
    parts = [*_rings(), *_furniture(), *_plants(rng)]
    sky = Part(_turned([(HORIZON, -1.0), (15.0, 4.0), (10.0, 8.0), (0.0, 10.0)]), SKY)
    few = max(1, count // 30)
    things = _sunlit(sample_parts(parts, count - 2 * few, statistics=MATT, rng=rng))
    near = things.take(rng.integers(len(things), size=few))
    adrift = near.means + rng.normal(0, 0.25, (few, 3)).astype(np.float32)
    faint = dataclasses.replace(near, means=adrift, logit_opacities=near.logit_opacities - 5)
    return concatenate([things, sample_parts([sky], few, statistics=MATT, rng=rng), faint])


def garden_cameras(
    n: int, *, width: int = 480, height: int = 360, seed: int = 0, prefix: str = "garden"
) -> list[Camera]:
    """Make n hand-held cameras on a walk along the path; every eighth looks over the wall.

    The arguments are those of `scenes.room_cameras`.
    """
    rng = np.random.default_rng([seed, 5])
    K = intrinsics(0.75 * width, width, height)
    cameras = []
    for i, (x, z) in enumerate(_places(n, LAWN + 0.4, PATH, rng)):
        aside = np.array([1.7 * x - 0.8 * z, 0, 1.7 * z + 0.8 * x]) if i % 8 == 5 else np.zeros(3)
        target = aside + 0.6 * UP + rng.normal(0, [0.4, 0.15, 0.4])
        view = look_at(np.array([x, -rng.uniform(0.9, 2.3), z]), target, UP)
        name = f"{prefix}_{i:03d}"
        cameras.append(Camera(viewmat=view, K=K, width=width, height=height, name=name))
    return cameras


def _places(n: int, near: float, far: float, rng: np.random.Generator) -> np.ndarray:
    """Places (x, z) around the fountain at about even angles, shape (n, 2)."""
    turns = 2 * np.pi * (np.arange(n) + rng.random() + rng.uniform(-0.3, 0.3, n)) / max(n, 1)
    radius = rng.uniform(near, far, n)
    return np.stack([radius * np.cos(turns), radius * np.sin(turns)], axis=-1)


def _ring(inner: float, outer: float) -> Surface:
    """Ring of the uneven ground."""
    level = revolve(np.stack([np.linspace(outer, inner, 65), np.zeros(65)], axis=-1), (0, 0, 0))

    def at(uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        x, _, z = level.at(uv)[0].T
        height = ground(x, z)
        dx, dz = (ground(x + 1e-3, z) - height) / 1e-3, (ground(x, z + 1e-3) - height) / 1e-3
        return np.stack([x, -height, z], axis=-1), np.stack([-dx, -np.ones(len(x)), -dz], axis=-1)

    return Surface(level.area, at)


def _turned(curve: Sequence[tuple[float, float]], foot: Vector = (0, 0, 0)) -> Surface:
    """Surface of revolution through points (radius, height), upwards for an outside."""
    fine = np.linspace(0, len(curve) - 1, 97)
    columns = [np.interp(fine, np.arange(len(curve)), column) for column in np.transpose(curve)]
    return revolve(np.stack(columns, axis=-1), foot)


def _leafy(
    middle: np.ndarray, radius: float, height: float, texture: Texture, rng: np.random.Generator
) -> Part:
    """Foliage in an ellipsoid: points moved inwards, random normals, a random tint."""
    skin = surfaces.ellipsoid(middle, radius, height)
    red, green, blue = texture.tint * rng.uniform(0.8, 1.2, 3)

    def at(uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        points, normals = skin.at(uv)
        inwards = 0.35 * rng.random((len(uv), 1)) ** 2 * (middle - points)
        return points + inwards, normals + rng.normal(0, 0.45, points.shape)

    return Part(Surface(skin.area, at), texture._replace(tint=(red, green, blue)), 2.5)


def _rings() -> list[Part]:
    """Rings: the grounds, the wall, the hills and the fountain."""
    rim = WALL + 0.25
    hills = [(HORIZON, 1.1), (13.0, 0.6), (11.0, 0.1), (9.0, -0.3), (rim + 0.8, -0.5)]
    wall = [(rim, -0.5), (rim, 0.6), (WALL, 0.6), (WALL, -0.3)]
    basin = [(0.95, -0.1), (0.85, 0.1), (0.9, 0.42), (0.98, 0.5), (0.8, 0.5), (0.76, 0.3)]
    shaft = [(0.2, 0.3), (0.12, 0.45), (0.09, 0.95), (0.14, 1.05), (0.45, 1.22), (0.0, 1.25)]
    return [
        Part(_ring(0.7, LAWN), GRASS, 1.6),
        Part(_ring(LAWN, PATH), GRAVEL, 1.6),
        Part(_ring(PATH, WALL), GRASS),
        Part(_turned(wall), BRICK._replace(repeat=(14, 0.6)), 1.2),
        Part(_turned(hills), GRASS, 0.06),
        Part(_turned(basin), STONE._replace(repeat=(6, 1)), 6.0),
        Part(_turned([(0.79, 0.36), (0.15, 0.36)]), WATER, 4.0),
        Part(_turned(shaft), STONE, 8.0),
        Part(surfaces.ellipsoid(1.42 * UP, 0.13, 0.5), BRONZE, 8.0),
    ]


def _furniture() -> list[Part]:
    urn, ball, (x, y, z) = _foot(-1.5, -0.9), _foot(-0.6, 1.75), _foot(1.2, 1.1)
    curve = [(0.09, 0.6), (0.07, 0.66), (0.17, 0.8), (0.19, 0.92), (0.12, 1.02), (0.17, 1.08)]
    feet = ((PLINTH - 0.75 * UP, 0.75), (urn, 0.6), (ball, 0.5))
    plinths = [(foot, 0.42, tall, 0.42) for foot, tall in feet]
    bench = [((x, y - 0.42, z + i), 1.2, 0.05, 0.12) for i in (-0.14, 0, 0.14)]
    bench += [((x, y - i, z + 0.24), 1.2, 0.12, 0.04) for i in (0.55, 0.75)]
    bench += [((x + i, y, z + 0.05), 0.08, 0.42, 0.36) for i in (-0.5, 0.5)]
    return [
        *(Part(face, STONE, 5.0) for box in plinths for face in surfaces.box(*box)),
        *(Part(face, OAK, 6.0) for box in bench for face in surfaces.box(*box)),
        Part(_turned(curve, urn), Texture("ihc.png", (1.0, 0.7, 0.6), (3, 1)), 10.0),
        Part(surfaces.ellipsoid(ball + 0.74 * UP, 0.24, 0.5), BRONZE, 8.0),
    ]


def _plants(rng: np.random.Generator) -> list[Part]:
    parts = []
    for x, z in _places(5, 4.8, 5.0, rng):
        foot, tall = _foot(x, z), rng.uniform(1.9, 2.5)
        parts.append(Part(surfaces.cylinder(foot, 0.13, 0.08, tall), WALNUT, 3.0))
        crowns = foot + tall * UP + rng.normal(0, 0.3, (3, 3))
        parts += [_leafy(middle, 0.65, 1.1, LEAVES, rng) for middle in crowns]
    for x, z in _places(14, 4.7, 5.3, rng):
        size = rng.uniform(0.3, 0.6)
        parts.append(_leafy(_foot(x, z) + 0.25 * UP, size, 1.7 * size, LEAVES, rng))
    for x, z in ((-1.6, 0.9), (-1.9, 0.4), (0.3, -1.9), (0.7, 1.9)):
        parts.append(_leafy(_foot(x, z), 0.3, 0.6, FLOWERS, rng)._replace(detail=8.0))
    for x, z in _places(12, 8.0, 11.0, rng):
        parts.append(_leafy(np.array([x, -0.8, z]), 0.7, 4.0, LEAVES, rng)._replace(detail=0.3))
    return parts


def _sunlit(gaussians: Gaussians) -> Gaussians:
    """Multiply colours by the light of the sun and of the sky."""
    from scipy.spatial.transform import Rotation

    normals = Rotation.from_quat(gaussians.quats, scalar_first=True).as_matrix()[..., 2]
    light = 0.6 + 0.6 * np.clip(normals @ SUN, 0, 1) - 0.1 * normals[:, 1]
    sh = np.array(gaussians.sh)
    sh[:, 0] = (np.clip((0.5 + Y0 * sh[:, 0]) * light[:, None], 0, 1) - 0.5) / Y0
    return dataclasses.replace(gaussians, sh=sh)
