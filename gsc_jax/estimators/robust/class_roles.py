"""Roles of latent classes: authentic, tampered, or a distractor.

Only flag rates are compared, class by class and view by view, as patterns of flagged views.

- Authentic: the heaviest set of classes with one pattern. A view that flags it is inverted.
- Tampered: the class that is flagged in the largest share of the views that see it.
- Distractor: a class flagged in other views, and in a clearly smaller share or in few: an authentic
  region that the detector takes for tampered from some sides. Its rates must be near 0 or 1, or the
  ragged boundary of the tampered region would count as one.

The constants were chosen on seeds 10 and 11 of the development scenes, which no table uses (see
`experiments/editing.py --first-seed 10 --seeds 2`), but `MIN_SECOND_EDIT` on a real one.
"""

import dataclasses

import numpy as np
from scipy.special import expit

FULL_VIEW = 0.2
"""A view has full weight for a class if it sees at least this share of what the best view sees."""
LEAST_VIEW = 0.2
"""Visibility in [0, 1] above which the rate of a class in a view is used as its pattern."""
HARDLY_SEEN = 0.05
"""A view does not show a class if its visibility there, in [0, 1], is at most this, 1 % of its
weight in the best view. Then no Gaussian that the view shows belongs to the class."""
RATE_DIFFERENCE = 0.6
"""A view separates two classes if their rates differ by more."""
SAME_PATTERN_VIEWS = 1.5
"""Classes that fewer views separate count as one object."""
SEPARATED_SHARE = 0.15
"""Two classes are also one object if less than this share of what both show is in views that
separate them: views in which a part of an edit is covered flag that part by chance."""
NEGLIGIBLE_WEIGHT = 1e-4
"""Share of all weight below which a class is ignored."""
NEAR_BEST = 0.9
"""Among classes flagged at least this fraction as often as the first, the heaviest is tampered."""
MIN_SHARPNESS = 0.75
"""Least mean of |2 q - 1| of a distractor or a second edit over the views that see it."""
SECOND_EDIT, MIN_SECOND_EDIT = 0.8, 0.4
"""Flag frequency of a second edit: above this multiple of that of the first, and above this share,
which the authentic region of the shared kitchen, 0.37, does not reach."""
EVEN_RATE, LOG_ODDS_PER_RATE = 0.58, 12.0
"""Logistic regression of "edited" on the flag rate of the tampered class."""
PSEUDO_VIEWS = 2.0
"""Pseudo-views at the even rate, so that few views give a probability near one half."""
MIN_MASKS, MAX_OF_FEW = 3, 0.6
"""Views of a region for a scene probability above `MAX_OF_FEW`: false alarms in fewer agree."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Roles:
    """Patterns of C classes: the authentic one, then the tampered ones, then the distractors.

    `patterns` (C, V) bool say whether a class is flagged in a view, after the masks of the
    `inverted` views (V,) bool are turned; `rates` (C,), in which share of the `seen` (C,) views.
    `unseen` (C, V) says which views do not show a tampered class. `missed` is the share of what
    tampered classes show that is clear in the views that flag them; `parts` the number of parts.
    """

    inverted: np.ndarray
    patterns: np.ndarray
    unseen: np.ndarray
    tampered: np.ndarray
    rates: np.ndarray
    seen: np.ndarray
    missed: float
    parts: int = 1

    @property
    def rate(self) -> float:
        """Share of the views that see the first tampered class in which it is flagged."""
        return float(self.rates[np.argmax(self.tampered)])

    @property
    def scene_probability(self) -> float:
        """Probability that the scene was edited, from the views that flag the first tampered class.

        At most `MAX_OF_FEW` if `few_views` see the class. Masks may agree by chance in any of
        several parts: the odds are divided by the root of their number, as neighbours share views.
        """
        found = scene_probability(self.rate, float(self.seen[np.argmax(self.tampered)]))
        found = found / (found + self.parts**0.5 * (1 - found))
        return min(found, MAX_OF_FEW) if self.few_views else found

    @property
    def few_views(self) -> bool:
        """Whether fewer than `MIN_MASKS` views see the first tampered class."""
        return bool(self.seen[np.argmax(self.tampered)] <= MIN_MASKS - 0.5)


def scene_probability(rate: float, views: float) -> float:
    """Probability in (0, 1) that a scene was edited, from how consistently a class is flagged.

    `rate` is the share of views that flag the tampered class, of the `views` that see it. The
    probability is one half at a rate of 0.58, and close to it for few views: an authentic region
    may be flagged as well, but in fewer of the views that see it.
    """
    rate = (rate * views + EVEN_RATE * PSEUDO_VIEWS) / (views + PSEUDO_VIEWS)
    return float(expit(LOG_ODDS_PER_RATE * (rate - EVEN_RATE)))


def assign_roles(
    rates: np.ndarray,
    weights: np.ndarray,
    part: np.ndarray | int = 0,
    *,
    inversion: bool = True,
    distractors: bool = True,
) -> Roles | None:
    """Assign a role to each class; None if all visible weight belongs to one class.

    `rates` are the flag rates by class and view, `weights` the weight of a class that a view sees,
    both (K, V), and `part` (K,) the number of the part of the scene that a class belongs to;
    something in each part is authentic, unless most views flag it. The options allow inverted
    masks, and distractors and second edits.
    """
    mass = weights.sum(axis=1)
    shown_share = weights / np.maximum(weights.max(axis=1, keepdims=True), 1e-30)
    seen = np.minimum(1.0, shown_share / FULL_VIEW)
    part = np.broadcast_to(part, len(mass))
    table, by_part, inverted = _authentic(rates, weights, seen, part, inversion=inversion)
    others, authentic, seen = mass > NEGLIGIBLE_WEIGHT * mass.sum(), by_part[0], table.seen
    others[by_part] = False
    if not others.any():
        return None
    frequency = np.where(others, table.flag_frequency(), -1.0)
    first = _largest(mass * table.sharpness, frequency >= NEAR_BEST * frequency.max())
    flagged = others & distractors & (table.sharpness >= MIN_SHARPNESS)
    flagged &= table.separating_views(authentic) >= 0.5
    both_shown = np.minimum(shown_share, shown_share[first])
    distinct = (both_shown * table.differs(first)).sum(1) >= SEPARATED_SHARE * both_shown.sum(1)
    distinct &= table.separating_views(first) >= SAME_PATTERN_VIEWS
    often = frequency > max(SECOND_EDIT * frequency[first], MIN_SECOND_EDIT)
    second = np.flatnonzero(flagged & often & (distinct | (part != part[first])))
    distractor = np.flatnonzero(flagged & ~often & distinct)
    patterns = [
        *table.patterns([authentic], fallback=authentic),
        *table.patterns(np.append(first, second), fallback=first),
        *table.patterns(distractor, fallback=authentic),
    ]
    order = np.concatenate([[authentic, first], second, distractor])
    tampered = (np.arange(len(patterns)) > 0) & (np.arange(len(patterns)) < 2 + len(second))
    return Roles(
        inverted=inverted,
        patterns=np.stack(patterns),
        unseen=(seen[order] <= HARDLY_SEEN) & tampered[:, None],
        tampered=tampered,
        rates=table.flag_frequency(1e-30)[order],
        seen=seen.sum(axis=1)[order],
        missed=table.missed(weights, np.append(first, second)),
        parts=len(np.unique(part)),
    )


def _authentic(
    rates: np.ndarray, weights: np.ndarray, seen: np.ndarray, part: np.ndarray, *, inversion: bool
) -> tuple["_RateTable", np.ndarray, np.ndarray]:
    """Find what is authentic in each part of a scene, and turn the rates of inverted masks.

    Returns the turned rates; the authentic classes (P,), the first of which gets the rates of all
    of them; and which views are inverted, (V,) bool.
    """
    mass = weights.sum(axis=1)
    heaviest = _RateTable(rates=rates, seen=seen).heaviest(mass, part)
    authentic = np.array([_largest(mass, classes) for classes in heaviest])

    def pooled(*values: np.ndarray) -> list[np.ndarray]:
        return [x[heaviest.any(axis=0)].sum(axis=0) for x in values]

    shown, flagged = pooled(weights, weights * rates)
    inverted = inversion & (flagged > 0.5 * shown) & (shown >= FULL_VIEW * shown.max())
    rates, seen = np.where(inverted, 1 - rates, rates), seen.copy()
    clear = _RateTable(rates=rates, seen=seen).flag_frequency()[authentic] <= 0.5
    if clear.any():  # a part that most views flag shows little but the edit
        heaviest, authentic = heaviest[clear], authentic[clear]
    if len(authentic) > 1:
        shown, flagged = pooled(weights, weights * rates)
        rates[authentic[0]] = flagged / np.maximum(shown, 1e-30)
        seen[authentic[0]] = np.minimum(1.0, shown / max(shown.max(), 1e-30) / FULL_VIEW)
    return _RateTable(rates=rates, seen=seen), authentic, inverted


def _largest(values: np.ndarray, among: np.ndarray) -> int:
    return int(np.argmax(np.where(among, values, -1.0)))


@dataclasses.dataclass(frozen=True, kw_only=True)
class _RateTable:
    """Flag rates of classes, and how completely each view sees a class in [0, 1], both (K, V)."""

    rates: np.ndarray
    seen: np.ndarray

    def flag_frequency(self, pseudo_views: float = 1.0) -> np.ndarray:
        """Share of the views that flag a class, with pseudo-views that do not, shape (K,)."""
        return (self.seen * (self.rates > 0.5)).sum(axis=1) / (self.seen.sum(axis=1) + pseudo_views)

    @property
    def sharpness(self) -> np.ndarray:
        """Mean of |2 q - 1| over the views that see a class, 0 to 1, shape (K,)."""
        contrast = np.abs(2 * self.rates - 1)
        return (self.seen * contrast).sum(axis=1) / np.maximum(self.seen.sum(axis=1), 1e-30)

    def separating_views(self, other: int) -> np.ndarray:
        """Number of views that separate each class from another one, shape (K,)."""
        return (np.minimum(self.seen, self.seen[other]) * self.differs(other)).sum(axis=1)

    def differs(self, other: int) -> np.ndarray:
        """Which views separate each class from another one, shape (K, V)."""
        return np.abs(self.rates - self.rates[other]) > RATE_DIFFERENCE

    def missed(self, weights: np.ndarray, classes: np.ndarray) -> float:
        """Part of the weight (K, V) of some classes that is clear in the views that flag them."""
        shown = (weights * (self.rates > 0.5))[classes]
        return float((shown * (1 - self.rates[classes])).sum() / max(shown.sum(), 1e-30))

    def heaviest(self, mass: np.ndarray, part: np.ndarray) -> np.ndarray:
        """Masks of the classes of each part that share a pattern and have most weight, (P, K)."""
        flagged = self.rates > 0.5
        differing_views = [
            (np.minimum(self.seen, seen) * (flagged != pattern)).sum(axis=1)
            for seen, pattern in zip(self.seen, flagged, strict=True)
        ]
        same = (np.array(differing_views) < SAME_PATTERN_VIEWS) & (part[:, None] == part[None])
        return same[[_largest(same @ mass, part == one) for one in np.unique(part)]]

    def patterns(self, classes: list[int] | np.ndarray, *, fallback: int) -> np.ndarray:
        """Patterns of some classes; views that hardly see a class use the rate of the fallback."""
        return np.where(self.seen > LEAST_VIEW, self.rates, self.rates[fallback])[classes] > 0.5
