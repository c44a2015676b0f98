"""What latent classes are: the authentic one, the tampered ones, and rivals that look like them.

Only rates are compared here, class by class and view by view, as patterns of what is flagged
where. The classes of most weight, of those alike, are authentic, and a view that flags them is
inverted. The tampered class is the one that is flagged in most of the views that see it. What is
flagged in clearly fewer, and in other views, is a rival: something authentic that the detector
takes for tampered from some sides. A rival has to be sharp, flagged or not, or the ragged edge of
what is tampered would be one.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np

SEEN = 0.2
"""Share of the weight in its best view from which on a class counts as wholly seen."""
GLIMPSE = 0.2
"""How wholly a class has to be seen for its own rate to count as its pattern."""
DIFFERENT = 0.6
"""Difference of two rates from which on a view tells two classes apart."""
ALIKE = 1.5
"""Classes that fewer views tell apart are parts of one thing."""
NEGLIGIBLE = 1e-4
"""Share of all weight below which a class is nothing."""
NEAR_BEST = 0.9
"""Of the classes flagged almost as often as the first, that of most weight is the tampered one."""
SHARP = 0.75
"""Least sharpness of a rival: mean of |2 q - 1| over what is seen."""
SECOND = 0.8
"""What is flagged this many times as often as the tampered class is a second edit, not a rival."""
EVEN, STEEP = 0.55, 12.0
"""The rate that speaks for an edit as much as against one, and log odds per unit of rate: a
logistic regression on edited and untouched scenes of seeds that no table uses."""
UNDECIDED = 2.0
"""Views of that rate that are imagined beside those looked at: few views decide nothing."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Roles:
    """The classes that matter: the authentic one first, then the tampered, then the rivals.

    Attributes:
        inverted: Views whose mask is to be read the other way round, shape (V,) bool.
        patterns: Whether a class is flagged in a view, inverted views turned, shape (C, V) bool.
        tampered: Which of the C classes are tampered, shape (C,) bool.
        sees: Views that show the first tampered class, shape (V,) bool.
        rate: Share of the views that see the first tampered class in which it is flagged.
        views: How many views see it.
    """

    inverted: np.ndarray
    patterns: np.ndarray
    tampered: np.ndarray
    sees: np.ndarray
    rate: float
    views: float

    @property
    def finds(self) -> np.ndarray:
        """Views that flag the first tampered class, inverted views turned, shape (V,) bool."""
        return self.patterns[np.argmax(self.tampered)]


def verdict(rate: float, views: float) -> float:
    """Probability that a scene was tampered with at all.

    Something authentic may be flagged, too, but from fewer sides.

    Args:
        rate: Share of the views that flag what is called tampered, of those that see it.
        views: How many see it.

    Returns:
        In (0, 1); one half at a rate of 0.55, and near it where few views speak.
    """
    rate = (rate * views + EVEN * UNDECIDED) / (views + UNDECIDED)
    return float(1 / (1 + np.exp(-STEEP * (rate - EVEN))))


def assign_roles(
    rates: np.ndarray, weights: np.ndarray, *, inversion: bool = True, rivals: bool = True
) -> Roles | None:
    """Tell what each class is.

    Args:
        rates: Probability of being flagged, by class and view, shape (K, V).
        weights: How much a view sees of a class, shape (K, V).
        inversion: Whether masks may be inverted.
        rivals: Whether there may be rivals, and second edits.

    Returns:
        The roles, or None where all that is seen is of one class.
    """
    mass = weights.sum(axis=1)
    seen = np.minimum(1.0, weights / np.maximum(SEEN * weights.max(axis=1, keepdims=True), 1e-30))
    alike = _Table(rates=rates, seen=seen).heaviest(mass)
    authentic = _most(mass, alike)
    shown, flagged = (x[alike].sum(axis=0) for x in (weights, weights * rates))
    inverted = inversion & (flagged > 0.5 * shown) & (shown >= SEEN * shown.max())
    table = _Table(rates=np.where(inverted, 1 - rates, rates), seen=seen)
    others = mass > NEGLIGIBLE * mass.sum()
    others[authentic] = False
    if not others.any():
        return None
    often = np.where(others, table.often, -1.0)
    first = _most(mass * table.sharpness, often >= NEAR_BEST * often.max())
    distinct = others & rivals & (table.sharpness >= SHARP)
    distinct &= (table.apart(first) >= ALIKE) & (table.apart(authentic) >= 0.5)
    second = np.flatnonzero(distinct & (often > SECOND * often[first]))
    rival = np.flatnonzero(distinct & (often <= SECOND * often[first]))
    patterns = [
        *table.patterns([authentic], otherwise=authentic),
        *table.patterns(np.array([first, *second]), otherwise=first),
        *table.patterns(rival, otherwise=authentic),
    ]
    return Roles(
        inverted=inverted,
        patterns=np.stack(patterns),
        tampered=(np.arange(len(patterns)) > 0) & (np.arange(len(patterns)) < 2 + len(second)),
        sees=seen[first] > 0.5,
        rate=float(np.average(table.rates[first] > 0.5, weights=seen[first])),
        views=float(seen[first].sum()),
    )


def _most(value: np.ndarray, among: np.ndarray) -> int:
    return int(np.argmax(np.where(among, value, -1.0)))


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Table:
    """Classes by views: the rate at which a class is flagged, and how well it is seen, (K, V)."""

    rates: np.ndarray
    seen: np.ndarray

    @property
    def often(self) -> np.ndarray:
        """Share of the views that flag a class, as if one more had not, shape (K,)."""
        return (self.seen * (self.rates > 0.5)).sum(axis=1) / (self.seen.sum(axis=1) + 1.0)

    @property
    def sharpness(self) -> np.ndarray:
        """How far the rates are from one half where a class is seen, 0 to 1, shape (K,)."""
        far = np.abs(2 * self.rates - 1)
        return (self.seen * far).sum(axis=1) / np.maximum(self.seen.sum(axis=1), 1e-30)

    def apart(self, other: int) -> np.ndarray:
        """Number of views that tell each class from another one, shape (K,)."""
        differ = np.abs(self.rates - self.rates[other]) > DIFFERENT
        return (np.minimum(self.seen, self.seen[other]) * differ).sum(axis=1)

    def heaviest(self, mass: np.ndarray) -> np.ndarray:
        """The classes that are flagged alike and together have most weight, shape (K,) bool."""
        flagged = self.rates > 0.5
        unlike = [
            (np.minimum(self.seen, seen) * (flagged != pattern)).sum(axis=1)
            for seen, pattern in zip(self.seen, flagged, strict=True)
        ]
        alike = np.array(unlike) < ALIKE
        return alike[np.argmax(alike @ mass)]

    def patterns(self, classes: Sequence[int] | np.ndarray, *, otherwise: int) -> np.ndarray:
        """Where classes are flagged; what does not see them says what it says of another one."""
        return np.where(self.seen > GLIMPSE, self.rates, self.rates[otherwise])[list(classes)] > 0.5
