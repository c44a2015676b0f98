"""Views that contradict that a Gaussian belongs to a class, and how much each of them counts."""

import numpy as np

from gsc_jax.estimators.robust.class_roles import Roles


def pattern_errors(roles: Roles, seen: np.ndarray, flagged: np.ndarray) -> np.ndarray:
    """Number of views whose mask contradicts that a Gaussian belongs to a class, shape (2, C, M).

    First those that flag a Gaussian and should not, then those that should and do not, after
    inverted masks are turned; each view counts with the `visibility` (V, M) of the Gaussian. A view
    that shows the Gaussian contradicts a class that is `unseen` in it in any case.
    """
    kinds, expected = np.stack([~roles.patterns, roles.patterns]), roles.patterns ^ roles.inverted
    wrong = ~expected | roles.unseen, expected | roles.unseen
    if_flagged, if_clear = ((kinds & one).astype(np.float32) for one in wrong)
    return (if_flagged - if_clear) @ flagged + if_clear @ seen  # no temporary (V, M)


def authentic_flag_share(
    roles: Roles, seen: np.ndarray, flagged: np.ndarray, represents: np.ndarray
) -> float:
    """Median over the views of the share of authentic Gaussians that a mask flags.

    Inverted masks are turned; a view that shows nothing authentic counts as 0. The mean would rise
    with a large authentic region that only some views flag. `seen` and `flagged` (V, S) are the
    `visibility` of sampled Gaussians, `represents` (S,) how many each of them stands for.
    """
    nearest = pattern_errors(roles, seen, flagged).sum(axis=0).argmin(axis=0)
    authentic = represents * ~roles.tampered[nearest]
    shown, flags = seen @ authentic, flagged @ authentic
    flags = np.where(roles.inverted, shown - flags, flags)
    return float(np.median(flags / np.maximum(shown, 1e-30)))


def error_weight(log_odds: float, rate: float) -> np.float32:
    """Log odds against a class from one view whose mask contradicts it.

    `rate` is the share of the members of the class that masks contradict. The log odds are
    `log_odds` up to a rate of 1 / (1 + exp(log_odds)), and lower above; it counts as 0.5 at most.
    """
    least = -np.logaddexp(0, -log_odds)
    return np.float32(min(log_odds, least - np.log(min(0.5, max(1e-300, rate)))))
