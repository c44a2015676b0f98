"""Exact forensic traces: what an edit leaves in the numbers of a scene, found without learning.

Each trace marks rows that are odd for the scene (a value off its lattice, a quaternion of another
length, a twin elsewhere) and believes the marks only where neighbours in space bear the same ones:
files hold single coincidences by the thousand, but never a region of them. What a region's marks
are worth is then read off the scene itself: how often they occur inside and outside of it.

Two things of authentic files must stay silent. Exports store a large scene in tiles, each with its
own codebook (so a large part with its own lattice is a tile), and sorted files vary along their
rows (so rows speak only in files that are not sorted).
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

from gsc_jax.forensics.copy_move import RADIUS, TIGHT, appearance, invariants, moved_alike
from gsc_jax.forensics.quantisation import off_lattice
from gsc_jax.forensics.row_order import SURE, appended_rows
from gsc_jax.scene import Gaussians
from gsc_jax.scene.neighbours import nearest_neighbours

NEIGHBOURS = 12
"""Neighbours in space that are asked; fewer are ragged, more blur small edits."""
FEWEST = 32
"""Gaussians of the smallest region that is reported; less could be chance."""
LARGEST = 0.5
"""Share of a scene above which odd rows are no longer the exception."""
OUTSIDE = 0.05
"""Rate of marks outside of all regions above which they are a habit of the scene."""
HELD = 0.005
"""Rate of negative w up to which a scene keeps to w >= 0; half-kept conventions have 0.03."""
DOUBT = 1e-3
"""No mark is trusted further than this: the floor of its rates inside and outside."""

UNIT = 1e-4
"""Deviation of the length of a unit quaternion in float32, with room."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Trace:
    """What one kind of trace says about each Gaussian.

    Attributes:
        name: "copied", "lattice", "degree", "rows" or "quaternions".
        score: How strongly this trace alone says "edited", in [0, 1]: 1 is certain and 0 says
            nothing, shape (N,) float32.
        explanation: One sentence for people, with counts; it says so where nothing was found.
    """

    name: str
    score: np.ndarray
    explanation: str

    @property
    def found(self) -> bool:
        """Whether it accuses anything."""
        return bool((self.score > 0.5).any())


def traces(gaussians: Gaussians, *, neighbours: np.ndarray | None = None) -> tuple[Trace, ...]:
    """All traces of a scene.

    Args:
        gaussians: N Gaussians; rows with values that are not finite are left out and get 0.
        neighbours: Nearest others of each row, shape (N, K); found here if not given.

    Returns:
        copied, lattice, degree, rows and quaternions, in this order.
    """
    if neighbours is None:
        neighbours = neighbours_of(gaussians)
    found = [
        trace(gaussians, neighbours=neighbours) for trace in (copied, lattice, degree, quaternions)
    ]
    return (*found[:3], rows(gaussians), found[3])


def combined(traces: Sequence[Trace]) -> np.ndarray:
    """The noisy-or of the scores of at least one trace: 1 - prod(1 - score), shape (N,)."""
    return 1 - np.prod([1 - trace.score for trace in traces], axis=0, dtype=np.float32)


def neighbours_of(gaussians: Gaussians) -> np.ndarray:
    """The nearest others of each Gaussian, nearest first, shape (N, K); its own row if invalid."""
    means = np.asarray(gaussians.means)
    usable = np.flatnonzero(_usable(gaussians))
    count = max(min(NEIGHBOURS, len(usable) - 1), 0)
    result = np.tile(np.arange(len(means))[:, None], (1, count))
    if count:
        result[usable] = usable[nearest_neighbours(means[usable], np.arange(len(usable)), count)]
    return result


def degree(gaussians: Gaussians, *, neighbours: np.ndarray | None = None) -> Trace:
    """Harmonics that end at another band than those of most Gaussians.

    An object of a lower degree is padded with exact zeros; see `traces` for the arguments.
    """
    sh = np.asarray(gaussians.sh)
    last = np.zeros(len(sh), int)
    for band in range(1, round(sh.shape[1] ** 0.5)):
        last[sh[:, band**2 : (band + 1) ** 2].any(axis=(1, 2))] = band
    usual = int(np.argmax(np.bincount(last, minlength=1)))
    score = _regions(gaussians, neighbours, last != usual)
    what = f"have harmonics that do not end at degree {usual} as those of the others do"
    return _trace("degree", score, what, "The harmonics end at the same degree everywhere.")


def quaternions(gaussians: Gaussians, *, neighbours: np.ndarray | None = None) -> Trace:
    """Quaternions of unit length among others or the reverse, or of another sign convention.

    See `traces` for the arguments.
    """
    quats = np.asarray(gaussians.quats, np.float64)
    usable = _usable(gaussians)
    unit = np.abs(np.linalg.norm(np.where(usable[:, None], quats, 0), axis=1) - 1) < UNIT
    negative = quats[:, 0] < 0
    score = np.zeros(len(quats), np.float32)
    if usable.any():
        odd = ~unit if unit[usable].mean() > 0.5 else unit
        score = _regions(gaussians, neighbours, odd)
        # Half of the rows of a part without the convention keep to it by chance.
        signs = _regions(gaussians, neighbours, negative, least=0.3, most=HELD)
        score = np.maximum(score, signs)
    what = "have quaternions of another length or sign convention than the others"
    return _trace("quaternions", score, what, "The quaternions follow one convention.")


def lattice(gaussians: Gaussians, *, neighbours: np.ndarray | None = None) -> Trace:
    """Values that are not on the lattice that the scene was quantised to, or the reverse.

    In each component, a value is off the lattice if it is rare between common ones, or if it is
    one of a block of values that neighbours share with each other but not with the scene. A row is
    odd in a group of components if most of them are. Positions are left out, whose lattices are so
    fine that sparse parts of a scene look free of them; and rotations, which some exporters scale
    to unit length after rounding. See `traces` for the arguments.
    """
    if neighbours is None:
        neighbours = neighbours_of(gaussians)
    usable = _usable(gaussians)
    score = np.zeros(len(usable), np.float32)
    groups = {
        "scales": gaussians.log_scales,
        "colours": gaussians.sh[:, 0],
    }
    off = {
        name: np.array([off_lattice(c, usable, neighbours) for c in np.asarray(columns).T])
        for name, columns in groups.items()
    }
    # A tile of an export has codebooks of its own for all, an edit changes one or takes the other
    # way.
    tile = np.all([off[name][:, 1].mean(axis=0) > 0.5 for name in ("scales", "colours")], axis=0)
    names = []
    for name, marks in off.items():
        odd = (marks[:, 0] | marks[:, 1] & ~tile).mean(axis=0) > 0.5
        one = _regions(gaussians, neighbours, odd)
        score = 1 - (1 - score) * (1 - one)
        names += [name] * bool((one > 0.5).any())
    what = f"have {' and '.join(names)} off the values that the others share"
    return _trace("lattice", score, what, "No part has values of a lattice of its own.")


def copied(gaussians: Gaussians, *, neighbours: np.ndarray | None = None) -> Trace:
    """Regions whose Gaussians occur again elsewhere, moved alike.

    Nearest others are sought in attributes that a copy keeps: all but the position, and then more
    tightly those that a similarity keeps too. Twins count where those of neighbours lie together.
    Nearly all of a filled hole has twins, and only a part of what it was copied from; of an object
    that was copied whole, both are accused. See `traces` for the arguments.
    """
    if neighbours is None:
        neighbours = neighbours_of(gaussians)
    usable = np.flatnonzero(_usable(gaussians))
    odd = np.zeros(len(gaussians), bool)
    if len(usable) > 2 * NEIGHBOURS:
        sound = gaussians.take(usable)
        means = np.asarray(sound.means, np.float64)
        reach = np.linalg.norm(means - np.asarray(gaussians.means)[neighbours[usable, -1]], axis=1)
        for space, radius in ((appearance(sound), RADIUS), (invariants(sound), TIGHT)):
            odd[usable] |= moved_alike(means, reach, space, radius)
    score = _regions(gaussians, neighbours, odd, least=0.6, beside=0.6)
    what = "occur again elsewhere; where two whole parts are alike, either may be the copy"
    return _trace("copied", score, what, "No part of the scene occurs in it again.")


def rows(gaussians: Gaussians) -> Trace:
    """A block of rows unlike the rest of an unsorted file: an object that was appended.

    It looks at the order of the rows alone, so it needs no neighbours.
    """
    usable = np.flatnonzero(_usable(gaussians))
    score = np.zeros(len(gaussians), np.float32)
    score[usable[appended_rows(gaussians.take(usable))]] = SURE
    what = "follow each other in the file and differ from all other rows"
    return _trace("rows", score, what, "No block of rows stands out.")


def _usable(gaussians: Gaussians) -> np.ndarray:
    """Rows without NaN or infinity where one would do harm, shape (N,) bool."""
    host = [gaussians.means, gaussians.log_scales, gaussians.quats, gaussians.sh]
    finite = [np.isfinite(np.asarray(x)) for x in host]
    finite = [x.all(axis=tuple(range(1, x.ndim))) for x in finite]
    return np.all(finite, axis=0) & ~np.isnan(np.asarray(gaussians.logit_opacities))


def _regions(
    gaussians: Gaussians,
    neighbours: np.ndarray | None,
    odd: np.ndarray,
    *,
    least: float = 0.5,
    most: float = OUTSIDE,
    beside: float = DOUBT,
) -> np.ndarray:
    """How surely each row is of a region of odd rows, shape (N,) float32.

    Args:
        gaussians: N Gaussians.
        neighbours: Nearest others of each row, shape (N, K), or None.
        odd: The rows that bear a mark, shape (N,) bool.
        least: Share of marks among neighbours that makes a region.
        most: Rate of marks elsewhere with which they still mean something.
        beside: Rate of marks to be expected right beside a region, at least.

    Returns:
        The posterior of a row by its own mark, with the marks around it as prior.
    """
    if neighbours is None:
        neighbours = neighbours_of(gaussians)
    usable = _usable(gaussians)
    odd = odd & usable
    nothing = np.zeros(len(odd), np.float32)
    if odd.sum() < FEWEST or not neighbours.size:
        return nothing
    around = (odd + odd[neighbours].sum(axis=1)) / (neighbours.shape[1] + 1)
    share = (around + around[neighbours].sum(axis=1)) / (neighbours.shape[1] + 1)
    inside = share >= least
    if not FEWEST <= inside.sum() <= LARGEST * usable.sum():
        return nothing
    near = usable & (inside | inside[neighbours].any(axis=1))
    away = usable & ~near
    yes, no = odd[inside].mean(), odd[away].sum() / max(away.sum(), 1)
    yes, no, often = min(yes, 1 - DOUBT), max(no, beside), no > most
    if often or yes <= no:
        return nothing
    prior = np.clip((share - no) / (yes - no), 0.01, 0.99)
    own = np.where(odd, np.log(yes / no), np.log((1 - yes) / (1 - no)))
    score = 1 / (1 + np.exp(-own) * (1 - prior) / prior)
    return np.where(near, score, 0).astype(np.float32)


def _trace(name: str, score: np.ndarray, what: str, otherwise: str) -> Trace:
    count = int((score > 0.5).sum())
    # A region that nothing is surely of is none.
    score = score if count >= FEWEST else np.zeros_like(score)
    explanation = f"{count:,} of {len(score):,} Gaussians {what}." if count >= FEWEST else otherwise
    return Trace(name=name, score=score.astype(np.float32), explanation=explanation)
