"""Gaussians on textured surfaces: quads, boxes and solids of revolution.

`sample_parts` distributes Gaussians, with the distributions of `TrainingStatistics`, over a golden
lattice on each `Part`, which stays even for any aspect ratio. Metres, y down.
"""

import dataclasses
import functools
import importlib.resources
from collections.abc import Callable, Iterable, Sequence
from typing import NamedTuple

import jax
import numpy as np
import scipy  # whose submodules load when they are first used
import skimage  # likewise
from PIL import Image
from scipy.spatial.transform import Rotation

from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Gaussians, InputError

Vector = Sequence[float] | np.ndarray

GOLDEN = (np.sqrt(5) - 1) / 2
LAMP = np.array([0.4, -2.3, -0.3])
UP, RIGHT, FRONT = np.array([0, -1.0, 0]), np.array([1.0, 0, 0]), np.array([0, 0, -1.0])


class Surface(NamedTuple):
    """Area, and an area-preserving map of coordinates (M, 2) in [0, 1] to points and normals."""

    area: float
    at: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]


class Texture(NamedTuple):
    """An image file of scikit-image, its number of repetitions, and a factor of its colour."""

    image: str
    tint: tuple[float, float, float] = (1.0, 1.0, 1.0)
    repeat: tuple[float, float] = (1.0, 1.0)
    contrast: float = 1.0


class Part(NamedTuple):
    """A surface with its texture; `detail` is its relative number of Gaussians per area."""

    surface: Surface
    texture: Texture
    detail: float = 1.0


@dataclasses.dataclass(frozen=True, kw_only=True)
class TrainingStatistics:
    """Distributions of the parameters of the Gaussians that a training leaves on a surface.

    Attributes:
        overlap: Median standard deviation in the surface, in units of the spacing.
        thickness: Median standard deviation across the surface, in the same unit.
        spread: Standard deviation of the log scales.
        opacity: Mean and standard deviation of the logit opacities; a tail is added below.
        gloss: Difference in brightness between frontal and grazing views.
        lit: Share of the colour that follows the lamp of the room.
    """

    overlap: float = 0.62
    thickness: float = 0.08
    spread: float = 0.22
    opacity: tuple[float, float] = (3.2, 1.3)
    gloss: float = 0.04
    lit: float = 0.55


def quad(center: Vector, u: np.ndarray, v: np.ndarray) -> Surface:
    """Parallelogram; seen from its front, u points right and v down."""
    corner = np.asarray(center) - u / 2 - v / 2
    cross = np.cross(v, u)
    area = float(np.linalg.norm(cross))

    def at(uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return corner + uv @ np.stack([u, v]), np.tile(cross / area, (len(uv), 1))

    return Surface(area, at)


def panel(center: Vector, normal: np.ndarray, width: float, height: float) -> Surface:
    """Upright rectangle that faces along a horizontal normal."""
    return quad(center, width * np.cross(UP, normal), -height * UP)


def flat(center: Vector, width: float, depth: float) -> Surface:
    """Level rectangle that faces up."""
    return quad(center, width * RIGHT, depth * FRONT)


def box(foot: Vector, width: float, height: float, depth: float) -> list[Surface]:
    """Faces of a box that stands on the centre of its lower face, which is omitted."""
    foot = np.asarray(foot)
    faces = [
        panel(foot + UP * height / 2 + normal * across / 2, normal, along, height)
        for axis, across, along in ((RIGHT, width, depth), (FRONT, depth, width))
        for normal in (axis, -axis)
    ]
    return [*faces, flat(foot + UP * height, width, depth)]


def revolve(profile: np.ndarray, foot: Vector, *, axis: int = 1) -> Surface:
    """Surface of revolution about a coordinate axis through `foot`, the point at height 0.

    The profile (P, 2) holds radius and height, minus the coordinate; upwards for an outside.
    """
    pieces = np.diff(profile, axis=0)
    middle = (profile[1:, 0] + profile[:-1, 0]) / 2
    area = np.append(0, np.cumsum(2 * np.pi * middle * np.linalg.norm(pieces, axis=1)))
    slope = np.gradient(profile, axis=0)
    slope /= np.linalg.norm(slope, axis=1, keepdims=True)
    columns = np.hstack([profile, slope]).T

    def around(angle: np.ndarray, radius: np.ndarray, height: np.ndarray) -> np.ndarray:
        upright = np.stack([radius * np.cos(angle), -height, radius * np.sin(angle)], axis=-1)
        return np.roll(upright, axis - 1, axis=-1)

    def at(uv: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        angle, along = 2 * np.pi * uv[:, 0], uv[:, 1] * area[-1]
        radius, height, dr, dh = (np.interp(along, area, column) for column in columns)
        return np.asarray(foot) + around(angle, radius, height), around(angle, dh, -dr)

    return Surface(float(area[-1]), at)


def ellipsoid(center: Vector, radius: float, height: float) -> Surface:
    """Ellipsoid with a vertical axis, `height` from pole to pole."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 65)
    return revolve(np.stack([radius * np.cos(angle), height / 2 * np.sin(angle)], axis=-1), center)


def cylinder(foot: Vector, bottom: float, top: float, height: float) -> Surface:
    """Cylinder or cone of two radii, closed at the top."""
    side = np.stack([np.linspace(bottom, top, 33), np.linspace(0, height, 33)], axis=-1)
    lid = np.stack([np.linspace(top, 0, 9)[1:], np.full(8, height)], axis=-1)
    return revolve(np.concatenate([side, lid]), foot)


@functools.cache
def _image(name: str, block: int = 1) -> np.ndarray:
    """RGB in [0, 1] of an image file of scikit-image, averaged over blocks of texels."""
    if block > 1:
        return skimage.transform.downscale_local_mean(_image(name), (block, block, 1))
    path = importlib.resources.files("skimage") / "data" / name
    if not path.is_file():
        raise InputError(f"{path}: texture not found; reinstall scikit-image from its wheel")
    with path.open("rb") as file:
        return np.asarray(Image.open(file).convert("RGB"), np.float32) / 255


def textured(texture: Texture, uv: np.ndarray) -> np.ndarray:
    """Colours (M, 3) of a texture at coordinates (M, 2) in [0, 1], column then row.

    The texture is averaged over blocks, so that it does not alias at evenly spread coordinates.
    """
    rows, columns = _image(texture.image).shape[:2]
    texels = np.sqrt(np.prod(texture.repeat) * rows * columns / len(uv))
    image = _image(texture.image, int(np.clip(round(texels), 1, min(rows, columns) // 8)))
    column, row = (uv * texture.repeat * image.shape[1::-1] - 0.5).T
    at = functools.partial(scipy.ndimage.map_coordinates, order=1, mode="grid-wrap")
    rgb = np.stack([at(channel, [row, column]) for channel in np.moveaxis(image, -1, 0)], axis=-1)
    mean = rgb.mean(axis=0)
    return np.clip((mean + texture.contrast * (rgb - mean)) * texture.tint, 0, 1)


def sample_parts(
    parts: Sequence[Part], count: int, *, statistics: TrainingStatistics, rng: np.random.Generator
) -> Gaussians:
    """Cover parts with `count` Gaussians of degree 1, in the order of the parts."""
    if count < 1:
        raise ValueError(f"count of Gaussians must be at least 1, got {count}")
    shares = np.cumsum([part.surface.area * part.detail for part in parts])
    counts = np.diff(np.rint(shares / shares[-1] * count).astype(int), prepend=0)
    covered = [_cover(p, n, statistics, rng) for p, n in zip(parts, counts, strict=True) if n]
    return _surfels(map(np.concatenate, zip(*covered, strict=True)), statistics, rng)


def _cover(
    part: Part, count: int, statistics: TrainingStatistics, rng: np.random.Generator
) -> tuple[np.ndarray, ...]:
    """Points, normals, colours and spacings on a part."""
    index = np.arange(count)
    uv = np.stack([(index * GOLDEN + rng.random()) % 1, (index + 0.5) / count], axis=-1)
    points, normals = part.surface.at(uv)
    towards = LAMP - points
    towards /= np.linalg.norm(towards, axis=1, keepdims=True)
    lambert = np.clip((normals * towards).sum(axis=1, keepdims=True), 0, 1)
    colors = textured(part.texture, uv) * (1 - statistics.lit + statistics.lit * (0.2 + lambert))
    return points, normals, colors, np.full(count, np.sqrt(part.surface.area / count))


def _surfels(
    columns: Iterable[np.ndarray], statistics: TrainingStatistics, rng: np.random.Generator
) -> Gaussians:
    """Flat Gaussians of degree 1 at N points of a surface, from the columns of `_cover`."""
    points, normals, colors, spacing = columns
    count = len(points)
    normals = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    tangents = np.cross(normals, rng.normal(size=(count, 3)))
    tangents /= np.linalg.norm(tangents, axis=1, keepdims=True)
    frames = np.stack([tangents, np.cross(normals, tangents), normals], axis=-1)
    # As an optimiser leaves them, quaternions have either sign and any length.
    length = rng.choice([-1, 1], (count, 1)) * rng.lognormal(0, 0.3, (count, 1))
    widths = statistics.overlap, statistics.overlap, statistics.thickness
    size = np.log(spacing)[:, None] + np.log(widths)
    faint = rng.random(count) < 0.08
    logits = np.where(faint, rng.normal(-0.5, 1.2, count), rng.normal(*statistics.opacity, count))
    sheen = statistics.gloss / (np.sqrt(3) * Y0) * normals[:, [1, 2, 0]] * [1, -1, 1]
    sh = np.concatenate([(colors[:, None] - 0.5) / Y0, np.repeat(sheen[..., None], 3, -1)], axis=1)
    sh[:, 1:] += rng.normal(0, 0.03, (count, 3, 3))
    jitter = (frames[..., :2] @ rng.normal(size=(count, 2, 1)))[..., 0]
    means = points + 0.12 * spacing[:, None] * jitter
    size = size + rng.normal(0, statistics.spread, (count, 3))
    quats = length * Rotation.from_matrix(frames).as_quat(scalar_first=True)
    gaussians = Gaussians(means=means, log_scales=size, quats=quats, logit_opacities=logits, sh=sh)
    return jax.tree.map(lambda leaf: leaf.astype(np.float32), gaussians)
