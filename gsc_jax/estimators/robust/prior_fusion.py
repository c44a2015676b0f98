"""Fusion of two estimates for every Gaussian: from the masks, and from a prior.

Both come with a probability that they show an edit at all: the masks by how many views agree, the
prior by its own verdict on the scene. A prior can be sure and wrong, and must not cost what the
masks alone find. So it decides only what no view sees, and everything if hardly any views agree;
only an exact prior can overrule masks. Where what the masks label does not stand out in the prior,
the scene probability falls. Where the masks are no evidence of an edit and label several regions,
the prior decides between them, which costs an edit if it is wrong.
"""

import math

import numpy as np
from scipy.special import logit

from gsc_jax.estimators.protocol import EVIDENCE_FROM, Prior
from gsc_jax.scene import Array
from gsc_jax.scene.neighbours import parts

PROBABILITY_FLOOR = 1e-9
"""Clip probabilities to this distance from 0 and 1, which bounds log odds by 21."""
MIN_MASK_VERDICT = 0.15
"""Scene probability of the masks below which a prior may replace them: less than 44 % of many views
flag the region. Where 40 % of the views missed an edit, 15 scenes of one part had 0.44 or more."""
MIN_PARTS = 64
"""Least number of parts into which `rank_in_scene` divides the rest of a scene."""
EXPONENT = 1 / 3
"""Exponent k of the factor k p^(k - 1), at most 1, by which the odds of an edit fall with a rank p.
Unbounded, it calibrates a p-value (Vovk and Wang, 2021). The bound is there because detailed
regions of authentic scenes have small ranks, too: a small rank is no evidence of an edit."""
SURE, STANDS_OUT, ORDINARY = EVIDENCE_FROM, 0.03, 0.3
"""Below a scene probability of `SURE` from the masks, labelled regions of a rank above `ORDINARY`
lose their labels if another labelled region has a rank of at most `STANDS_OUT`."""


def fuse(
    probability: np.ndarray,
    verdict: float,
    seen: np.ndarray,
    prior: Prior,
    weight: float = 1.0,
    rank: float | None = None,
) -> tuple[np.ndarray, float]:
    """Fuse probabilities from masks with a prior, as docs/method.md derives it.

    Where the masks do not count, the prior counts with the probability that it is correct, its
    verdict: for Gaussians that no view sees, and anywhere if the verdict of the masks is below
    `MIN_MASK_VERDICT`. An exact prior and the masks are each correct or not, independently. The
    fused verdict includes only a verdict of the prior *for* an edit, which need not show in it.
    Where the masks count, the odds fall to a third with the `rank` in the prior of what they label.

    `probability` (N,) and `verdict`, that of the scene, are from the masks; `seen` (N,) is True for
    Gaussians visible in at least one view; the prior has a weight in [0, 1]. Returns probabilities,
    (N,) float32, and the scene probability.
    """
    masks_wrong = 1 - verdict if verdict < MIN_MASK_VERDICT else 0.0
    if prior.exact:
        masks_wrong = 1 - verdict / 2  # and half of the cases in which both are correct
    share = weight * prior.verdict * np.where(seen, masks_wrong, 1.0) * prior.known
    discount = 1.0 if rank is None or masks_wrong else min(EXPONENT * rank ** (EXPONENT - 1), 1.0)
    log_odds = weight * (max(float(log_odds_of(prior.verdict)), 0.0) + math.log(discount))
    fused_verdict = verdict / (verdict + (1 - verdict) * math.exp(-log_odds))
    from_prior = np.where(prior.known, prior.probability, 0.0)
    return linear_pool(probability, from_prior, share), float(fused_verdict)


def rank_in_scene(prior: Prior, region: np.ndarray, means: Array) -> float | None:
    """Share of the other parts of a scene that a prior finds more suspect than a region (N,) bool.

    The rest of the scene, with these means (N, 3 or more), is divided into compact parts that are
    no larger than the region; one is more suspect if its mean log odds of the prior are higher. The
    region counts as one, and equal parts count half. None if the prior does not distinguish any.
    """
    known = prior.known & np.isfinite(np.asarray(means)[:, :3]).all(axis=1)
    inside, rest = known & region, np.flatnonzero(known & ~region)
    if not inside.any() or not len(rest):
        return None
    log_odds, size = log_odds_of(prior.probability), min(inside.sum(), len(rest) // MIN_PARTS)
    order, starts = parts(np.asarray(means)[rest, :3], max(int(size), 1))
    sums = np.add.reduceat(log_odds[rest[order]], starts)
    above = sums / np.diff(starts, append=len(rest)) - log_odds[inside].mean()
    higher, equal = above > 1e-6, abs(above) <= 1e-6
    return None if equal.all() else float((1 + np.sum(higher + equal / 2)) / (1 + len(above)))


def refuted(tampered: np.ndarray, region: np.ndarray, prior: Prior, means: Array) -> np.ndarray:
    """Which tampered classes are ordinary in the prior, where another one stands out, (C,) bool.

    Masks cannot tell an edit that they miss in 40 % of the views from an authentic region that they
    flag in 60 %. `tampered` (C,) are the classes in question, `region` (N,) that of each Gaussian.
    """
    classes = [one and rank_in_scene(prior, region == k, means) for k, one in enumerate(tampered)]
    ranks = np.array([rank or ORDINARY for rank in classes])
    return tampered & (ranks > ORDINARY) & (ranks[tampered].min(initial=1) <= STANDS_OUT)


def linear_pool(first: np.ndarray, second: np.ndarray, share: np.ndarray) -> np.ndarray:
    """Pool two probabilities (N,) linearly (Stone, 1961), with a share (N,) of the second.

    The mean of two estimates may label nothing although one of them does. In this case that one
    alone is returned, or of two the one with the larger share, shape (N,) float32.
    """
    pooled = ((1 - share) * first + share * second).astype(np.float32)
    labels_any = [bool((estimate > 0.5).any()) for estimate in (first, second)]
    if (pooled > 0.5).any() or not any(labels_any):
        return pooled
    take_second = np.mean(share) > 0.5 if all(labels_any) else labels_any[1]
    return np.asarray(second if take_second else first, np.float32)


def log_odds_of(probability: Array | float) -> np.ndarray:
    """Log odds of probabilities of any shape, finite at 0 and 1."""
    values = np.asarray(probability, np.float64)
    return logit(np.clip(values, PROBABILITY_FLOOR, 1 - PROBABILITY_FLOOR))
