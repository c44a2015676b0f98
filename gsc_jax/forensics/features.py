"""What the Gaussians themselves say: attributes against their surroundings and against the scene.

Tampered Gaussians come from another training, or were bent, dyed or copied, and their attributes
are distributed unlike those around them (GS-Checker builds its 3D loss on that). Here each Gaussian
is described by what it is and by means and spreads over its neighbours and over theirs, all of it
counted from the scene's median in units of its MAD, so that a model that was trained on some scenes
can be used on others.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from gsc_jax.forensics.copy_move import RADIUS, appearance
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Gaussians
from gsc_jax.scene.neighbours import Neighbourhoods, neighbourhoods
from gsc_jax.scene.parallel import WORKERS

NEIGHBOURS = 16
FLATTEST = -30.0
"""Log scales below this are all alike."""
SURROUNDINGS = ("own", "mean", "spread", "second", "fourth")
"""Of each number: its own; mean and spread over the neighbours; means over two and four steps."""
AT_A_TIME = 8
"""Columns that are averaged over neighbourhoods at once."""
CLIP = 6.0
"""Units of MAD beyond which it does not matter how far off a value is."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Cues:
    """What describes each of N Gaussians.

    Attributes:
        values: Shape (N, F) float32, finite, within +-`CLIP` but for copies.
        names: Of the F columns, `group.number.surroundings`.
        around: Who is near whom.
    """

    values: np.ndarray
    names: tuple[str, ...]
    around: Neighbourhoods


def cues(gaussians: Gaussians) -> Cues:
    """Describe Gaussians by themselves and by their surroundings.

    Args:
        gaussians: N Gaussians that can all be rendered, N > `NEIGHBOURS`.

    Returns:
        The cues. They depend neither on the order of the rows nor on the place, scale and pose of
        the scene, but for copies, whose attributes are compared as they are stored.
    """
    # A scale of 0 is legal, and minus infinity in log space.
    flat = np.maximum(np.asarray(gaussians.log_scales, np.float32), FLATTEST)
    gaussians = dataclasses.replace(gaussians, log_scales=flat)
    means = np.asarray(gaussians.means, np.float32)
    around = neighbourhoods(means, NEIGHBOURS)
    groups = own_cues(gaussians, around)
    groups["copies"] = copies(gaussians)
    names = [f"{name}.{i}" for name, values in groups.items() for i in range(values.shape[1])]
    return Cues(
        values=pooled(_own(groups), around),
        names=tuple(f"{name}.{label}" for label in SURROUNDINGS for name in names),
        around=around,
    )


def _own(groups: dict[str, np.ndarray]) -> np.ndarray:
    """All groups in one table, shape (N, D); takes them out of their dictionary."""
    columns = []
    for name in list(groups):
        values = groups.pop(name)
        columns.append(values if name == "copies" else standardised(values))
    return np.concatenate(columns, axis=1, dtype=np.float32)


def pooled(own: np.ndarray, around: Neighbourhoods) -> np.ndarray:
    """Numbers (N, D) with what they are in all `SURROUNDINGS`, shape (N, 5 D)."""
    # One table, filled a few columns at a time: of millions of Gaussians it is the largest thing.
    count, width = own.shape
    table = np.empty((count, len(SURROUNDINGS), width), np.float32)
    for start in range(0, width, AT_A_TIME):
        some = slice(start, start + AT_A_TIME)
        mine = own[:, some]
        first = around.mean @ mine
        second = around.mean @ first
        fourth = around.mean @ (around.mean @ second)
        for i, values in enumerate((mine, first, around.spread(mine, first), second, fourth)):
            table[:, i, some] = values
    return table.reshape(count, -1)


def standardised(values: np.ndarray) -> np.ndarray:
    """Counted from the scene's median in units of its MAD, and clipped, shape (N, D)."""
    off = values - np.median(values, axis=0)
    unit = 1.4826 * np.median(np.abs(off), axis=0)
    # Where most are alike the MAD is next to nothing.
    unit = np.maximum(unit, 1e-2 * np.std(values, axis=0) + 1e-6)
    return np.clip(off / unit, -CLIP, CLIP).astype(np.float32)


def own_cues(gaussians: Gaussians, around: Neighbourhoods) -> dict[str, np.ndarray]:
    """Cues by group, each of shape (N, D)."""
    logs = -np.sort(-np.asarray(gaussians.log_scales, np.float32), axis=1)
    distance = around.distances.mean(axis=1)
    spacing = np.log(distance + 1e-12)
    ends = np.log(around.distances[:, [0, -1]] + 1e-12) - spacing[:, None]
    return {
        "size": np.column_stack([logs - spacing[:, None], logs.mean(axis=1), spacing]),
        "anisotropy": -np.diff(logs, axis=1),
        "spacing": np.maximum(ends, -CLIP),
        "opacity": np.clip(np.asarray(gaussians.logit_opacities), -7, 7)[:, None],
        **_colour_cues(np.asarray(gaussians.sh), around),
        **_direction_cues(gaussians, around),
    }


def _colour_cues(sh: np.ndarray, around: Neighbourhoods) -> dict[str, np.ndarray]:
    rgb = 0.5 + Y0 * sh[:, 0]
    light, chroma = _opponent(rgb)
    tone = np.column_stack([light, chroma])
    saturation = np.ptp(rgb, axis=1)
    beyond = np.maximum(rgb - 1, 0).max(axis=1) + np.maximum(-rgb, 0).max(axis=1)
    off = tone - around.mean @ tone
    relative = np.log((saturation + 0.02) / (np.abs(light) + 0.05))
    return {
        "colour": np.column_stack([tone, saturation, relative, beyond]),
        "contrast": np.column_stack([np.abs(off[:, 0]), np.hypot(off[:, 1], off[:, 2])]),
        "shading": _shading(light, chroma, around),
        "harmonics": _harmonics(sh[:, 1:]),
    }


def _opponent(rgb: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Lightness (N,) and chroma (N, 2): red against blue, and green against both."""
    red, green, blue = rgb.T
    return rgb.mean(axis=1), np.column_stack([red - blue, green - (red + blue) / 2])


def _shading(light: np.ndarray, chroma: np.ndarray, around: Neighbourhoods) -> np.ndarray:
    """Chroma that a neighbourhood would have in the dark.

    Shades of one material are multiples of one colour, so chroma vanishes with the light; colours
    that were shifted or turned have it left over.
    """
    values = np.column_stack([light, light * light, chroma, chroma * light[:, None]])
    first, second, c1, c2, c1l, c2l = (around.mean @ (around.mean @ values)).T
    variance = second - first * first + 1e-3
    left = [c - (cl - c * first) / variance * first for c, cl in ((c1, c1l), (c2, c2l))]
    return np.column_stack([*left, np.hypot(*left)])


def _harmonics(rest: np.ndarray) -> np.ndarray:
    """Energy of the higher harmonics, its coloured share and that of the first band, (N, 3)."""
    if not rest.shape[1]:
        return np.zeros((len(rest), 3), np.float32)
    coloured = rest - rest.mean(axis=2, keepdims=True)
    energy, hue, first = (
        np.log(1e-3 + np.sqrt(np.mean(part * part, axis=(1, 2))))
        for part in (rest, coloured, rest[:, :3])
    )
    return np.column_stack([energy, hue - energy, first - energy])


def _direction_cues(gaussians: Gaussians, around: Neighbourhoods) -> dict[str, np.ndarray]:
    """How flat the surroundings are, and how axes and light lie in them."""
    normal, along = _axes(gaussians)
    offsets = np.asarray(gaussians.means, np.float32)[around.nearest]
    offsets -= offsets.mean(axis=1, keepdims=True)
    covariance = np.einsum("nki,nkj->nij", offsets, offsets) / offsets.shape[1]
    trace = np.trace(covariance, axis1=1, axis2=2) + 1e-30
    covariance /= trace[:, None, None]
    squared = np.einsum("nij,nij->n", covariance, covariance)
    volume = np.log(np.maximum(np.linalg.det(covariance), 1e-9))
    return {
        "surface": np.column_stack(
            [squared, volume, _within(normal, covariance), _within(along, covariance)]
        ),
        "agreement": np.column_stack([_agreement(normal, around), _agreement(along, around)]),
        "lighting": _lighting(np.asarray(gaussians.sh), normal, around),
    }


def _axes(gaussians: Gaussians) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors along the shortest and the longest axis, shapes (N, 3)."""
    w, x, y, z = np.asarray(gaussians.rotations).T
    columns = (
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)),
        (2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x)),
        (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)),
    )
    axes = np.stack([np.stack(column, axis=-1) for column in columns], axis=1)
    logs, rows = np.asarray(gaussians.log_scales), np.arange(len(w))
    return axes[rows, logs.argmin(axis=1)], axes[rows, logs.argmax(axis=1)]


def _within(axis: np.ndarray, covariance: np.ndarray) -> np.ndarray:
    """Variance of the surroundings along an axis, shape (N,)."""
    return np.einsum("ni,nij,nj->n", axis, covariance, axis)


def _agreement(axis: np.ndarray, around: Neighbourhoods) -> np.ndarray:
    """Mean squared cosine between an axis and those of the neighbours, shape (N,)."""
    pairs = [(i, j) for i in range(3) for j in range(i, 3)]
    products = np.column_stack([axis[:, i] * axis[:, j] * (1 + (i != j)) ** 0.5 for i, j in pairs])
    return ((around.mean @ products) * products).sum(axis=1)


def _lighting(sh: np.ndarray, normal: np.ndarray, around: Neighbourhoods) -> np.ndarray:
    """Where the first band is brightest: against neighbours, the scene and the normal, (N, 3)."""
    if sh.shape[1] < 4:
        return np.zeros((len(sh), 3), np.float32)
    y, z, x = sh[:, 1:4].mean(axis=2).T
    toward = np.column_stack([-x, -y, z])
    toward /= np.linalg.norm(toward, axis=1, keepdims=True) + 1e-6
    scene = toward.T @ toward / len(toward)
    return np.column_stack(
        [
            np.einsum("ni,ni->n", around.mean @ toward, toward),
            np.einsum("ni,ij,nj->n", toward, scene, toward),
            np.abs(np.einsum("ni,ni->n", toward, normal)),
        ]
    )


def copies(gaussians: Gaussians) -> np.ndarray:
    """Whether another Gaussian of the scene has the same attributes, but for its place.

    Args:
        gaussians: N Gaussians.

    Returns:
        Closeness of the most similar one, 0 to 1, and whether there is one, shape (N, 2).
    """
    from scipy.spatial import KDTree

    described = appearance(gaussians)
    # Trees degenerate where many points are one.
    _, first, which, counts = np.unique(
        hashed(described), return_index=True, return_inverse=True, return_counts=True
    )
    distinct = described[first]
    found = np.zeros(len(distinct))
    if len(distinct) > 1:
        tree = KDTree(distinct, compact_nodes=False, balanced_tree=False)
        query = tree.query(distinct, k=2, distance_upper_bound=RADIUS, workers=WORKERS)
        found = np.where(counts > 1, 0.0, query[0][:, 1])
    close = 1 - np.minimum(found, RADIUS)[which] / RADIUS
    return np.column_stack([close, close > 0]).astype(np.float32)


def hashed(rows: np.ndarray) -> np.ndarray:
    """A number per row, the same for equal rows and another for others, shape (N,) uint64."""
    keys = np.random.default_rng(0).integers(1, 2**63, rows.shape[1], dtype=np.uint64) | np.uint64(
        1
    )
    bits = (rows.astype(np.float32) + 0.0).view(np.uint32)  # -0 and 0 are equal
    return (bits.astype(np.uint64) * keys).sum(axis=1, dtype=np.uint64)


def select(names: Sequence[str], group: str) -> np.ndarray:
    """Which of the columns belong to a group, shape (F,) bool."""
    return np.array([name.split(".")[0] == group for name in names])
