"""Features of Gaussians: attributes relative to the surroundings and to the scene.

Tampered Gaussians come from another training run, or were bent, recoloured or copied, so their
attributes differ from those around them. Each feature is a number of a Gaussian or a statistic of
it over the neighbours, standardised by median and MAD of the scene.
"""

import dataclasses
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from gsc_jax.evidence.storage import ArrayStore
from gsc_jax.forensics.copy_move import APPEARANCE_RADIUS, nearest_duplicates
from gsc_jax.render.spherical_harmonics import Y0
from gsc_jax.scene import Array, Gaussians
from gsc_jax.scene.neighbours import Neighbourhoods, neighbourhoods
from gsc_jax.scene.parallel import in_blocks, workers
from gsc_jax.scene.statistics import median_and_mad

NEIGHBOURS = 16
"""Neighbours of each Gaussian; the classifier was trained with this number."""
MIN_LOG_SCALE = -30.0
"""Floor of log scales: a scale of 0 is legal, and minus infinity in log space."""
MAX_DEVIATION = 6.0
"""Clip standardised features to this many MADs, since only the fact of an outlier matters."""
SURROUNDINGS = ("own", "mean", "spread", "second", "fourth")
"""A number itself, its mean and spread over the neighbours, its means over 2 and 4 steps."""
COLUMNS_PER_PASS = 4
"""Columns averaged at once in a thread, which bounds the memory of intermediate results."""
MAX_BYTES_IN_MEMORY = 2**28
"""Size of the features in memory; about 350,000 Gaussians."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Features:
    """Features of N Gaussians.

    The values are finite and within +-`MAX_DEVIATION`. They take three times the memory of the
    scene, so those of a large one lie in a file.

    Attributes:
        names: Names of the F columns, `group.number.surroundings`.
        neighbourhoods: Neighbours of each Gaussian.
        duplicates: Most similar other Gaussian of each, or -1, shape (N,).
        store: Arrays (N, columns) by surroundings and pass.
    """

    names: tuple[str, ...]
    neighbourhoods: Neighbourhoods
    duplicates: np.ndarray
    store: ArrayStore

    def own(self) -> Iterator[np.ndarray]:
        """Yield the numbers of the Gaussians themselves, `COLUMNS_PER_PASS` at a time, (N, D)."""
        return (self.store.get(SURROUNDINGS[0], str(start)) for start in self._passes)

    def rows(self, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
        """The values of some Gaussians, by default of all, shape (M, F) float32."""
        stored = ((label, str(start)) for label in SURROUNDINGS for start in self._passes)
        return np.concatenate([self.store.get(*key)[rows] for key in stored], axis=1)

    @property
    def _passes(self) -> range:
        return range(0, len(self.names) // len(SURROUNDINGS), COLUMNS_PER_PASS)


def with_finite_scales(gaussians: Gaussians) -> Gaussians:
    """The Gaussians with log scales of at least `MIN_LOG_SCALE`."""
    log_scales = np.maximum(np.asarray(gaussians.log_scales, np.float32), MIN_LOG_SCALE)
    return dataclasses.replace(gaussians, log_scales=log_scales)


def compute_features(gaussians: Gaussians) -> Features:
    """Compute the features of N > `NEIGHBOURS` Gaussians with finite values.

    They are independent of the order of the rows and of position, scale and pose of the scene,
    except those of duplicates, which compare attributes as stored.
    """
    with ThreadPoolExecutor(1) as beside:  # only the other search: its trees are large
        found = beside.submit(nearest_duplicates, gaussians)
        around, reach = neighbourhoods(np.asarray(gaussians.means, np.float32), NEIGHBOURS)
    distances, duplicates = found.result()
    groups = _groups(gaussians, around, reach) | {"copies": duplicate_closeness(distances)}
    numbers = [f"{name}.{i}" for name, values in groups.items() for i in range(values.shape[1])]
    return Features(
        names=tuple(f"{number}.{label}" for label in SURROUNDINGS for number in numbers),
        neighbourhoods=around,
        duplicates=duplicates,
        store=_with_surroundings(_table(groups), around),
    )


def in_group(names: Sequence[str], *groups: str) -> np.ndarray:
    """Mask of the columns of some groups, shape (F,) bool."""
    return np.array([name.split(".")[0] in groups for name in names])


def standardise(values: np.ndarray) -> np.ndarray:
    """Deviations from the median of the scene in units of its MAD, clipped, shape (N, D)."""
    median, mad = median_and_mad(values)
    # Where most values are equal, the MAD is close to 0.
    unit = np.maximum(mad, 1e-2 * np.std(values, axis=0) + 1e-6)
    return np.clip((values - median) / unit, -MAX_DEVIATION, MAX_DEVIATION).astype(np.float32)


def _table(groups: dict[str, np.ndarray]) -> np.ndarray:
    """All groups in one table, shape (N, D); removes them from the dictionary to free memory."""
    copies = groups.pop("copies")
    with ThreadPoolExecutor(workers()) as pool:
        columns = list(pool.map(standardise, [groups.pop(name) for name in list(groups)]))
    return np.concatenate([*columns, copies], axis=1, dtype=np.float32)


def _with_surroundings(own: np.ndarray, around: Neighbourhoods) -> ArrayStore:
    """Numbers (N, D) with their `SURROUNDINGS`, some columns at a time."""
    store = ArrayStore(max_bytes=MAX_BYTES_IN_MEMORY)

    def put(start: int) -> None:
        key, values = str(start), own[:, start : start + COLUMNS_PER_PASS]
        store.put("own", key, values)
        store.put("mean", key, first := around.mean(values))
        store.put("spread", key, around.spread(values, first))
        store.put("second", key, second := around.mean(first))
        store.put("fourth", key, around.mean(around.mean(second)))

    with ThreadPoolExecutor(workers()) as pool:
        list(pool.map(put, range(0, own.shape[1], COLUMNS_PER_PASS)))
    return store


def _groups(gaussians: Gaussians, around: Neighbourhoods, reach: Array) -> dict[str, np.ndarray]:
    """Numbers by group, each of shape (N, D); `reach` are the distances to the neighbours."""
    logs = -np.sort(-np.asarray(gaussians.log_scales, np.float32), axis=1)
    spacing = np.log(reach.mean(axis=1) + 1e-12)
    ends = np.log(reach[:, [0, -1]] + 1e-12) - spacing[:, None]
    return {
        "size": np.column_stack([logs - spacing[:, None], logs.mean(axis=1), spacing]),
        "anisotropy": -np.diff(logs, axis=1),
        "spacing": np.maximum(ends, -MAX_DEVIATION),
        "opacity": np.clip(np.asarray(gaussians.logit_opacities), -7, 7)[:, None],
        **_colour_groups(np.asarray(gaussians.sh), around),
    }


def _colour_groups(sh: np.ndarray, around: Neighbourhoods) -> dict[str, np.ndarray]:
    rgb = 0.5 + Y0 * sh[:, 0]
    red, green, blue = rgb.T
    lightness = rgb.mean(axis=1)
    chroma = np.column_stack([red - blue, green - (red + blue) / 2])
    tone = np.column_stack([lightness, chroma])
    saturation = np.ptp(rgb, axis=1)
    outside = np.maximum(rgb - 1, 0).max(axis=1) + np.maximum(-rgb, 0).max(axis=1)
    relative = np.log((saturation + 0.02) / (np.abs(lightness) + 0.05))
    contrast, *chromatic = (tone - around.mean(tone)).T
    return {
        "colour": np.column_stack([tone, saturation, relative, outside]),
        "contrast": np.column_stack([np.abs(contrast), np.hypot(*chromatic)]),
        "harmonics": in_blocks(_harmonics, sh[:, 1:]),
    }


def _harmonics(rest: np.ndarray) -> np.ndarray:
    """Log energy of the bands above 0, its coloured share and that of the first band, (N, 3)."""
    if not rest.shape[1]:
        return np.zeros((len(rest), 3), np.float32)
    coloured = rest - rest.mean(axis=2, keepdims=True)
    parts = rest, coloured, rest[:, :3]
    energy, hue, first = (np.log(1e-3 + np.sqrt(np.mean(p * p, axis=(1, 2)))) for p in parts)
    return np.column_stack([energy, hue - energy, first - energy])


def duplicate_closeness(distances: np.ndarray) -> np.ndarray:
    """Closeness in [0, 1] at distances (N,) to duplicates, and whether it is above 0, (N, 2)."""
    close = 1 - np.minimum(distances, APPEARANCE_RADIUS) / APPEARANCE_RADIUS
    return np.column_stack([close, close > 0]).astype(np.float32)
