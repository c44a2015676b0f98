"""Evidence without a 2D detector: how likely each Gaussian is tampered, by the Gaussians alone.

To what a network suspects (`suspicion`) exact traces are added, which need no learning. Both
together are the prior of the robust estimator, or all there is where no masks are.
"""

import dataclasses
from collections.abc import Sequence

import jax
import numpy as np

from gsc_jax.estimators.protocol import Finding
from gsc_jax.estimators.robust.estimator import RobustConfig
from gsc_jax.estimators.robust.prior_fusion import Prior
from gsc_jax.forensics.classifier import SURE, Model, opinions, shipped_model, worst_part
from gsc_jax.forensics.features import NEIGHBOURS, cues
from gsc_jax.forensics.traces import NEIGHBOURS as ASKED
from gsc_jax.forensics.traces import Trace, combined, traces
from gsc_jax.scene import Gaussians, invalid_rows

LEVEL = 0.3
"""Of the way from the base rate to the worst part: what is labelled where little stands out."""
GAP = 0.05, 0.5
"""Of that way, too: where the gap is looked for between an edit that surely is one and the rest."""
SURELY = 0.65
"""Verdict of the network from which on one is."""
NAMED = 0.1
"""Share of what stands apart that exact traces name where they are taken to name the edit."""
BESIDE = 1.0
"""Log odds asked of the rest where they do; all five were chosen on seeds 10 and 11, by F1."""
MARGIN, FEW = 0.1, 20
"""Of the gap: half of its width, of the way, and a number of Gaussians that does not matter."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Native:
    """What the Gaussians themselves say.

    Attributes:
        known: Rows that could be described, shape (N,) bool.
        learned: What the network says, as log odds, shape (N,) float32.
        learned_verdict: What it says of the scene.
        log_odds: That a Gaussian is tampered, after the exact traces, shape (N,) float32; of the
            base rate where nothing is known of a row.
        base: Log odds before looking: more than these speaks for an edit.
        worst: Mean log odds of the part that is most suspicious, exact traces left aside.
        verdict: Probability that anything was tampered with.
        traces: Exact traces, those that found nothing among them.
    """

    known: np.ndarray
    learned: np.ndarray
    learned_verdict: float
    log_odds: np.ndarray
    base: float
    worst: float
    verdict: float
    traces: tuple[Trace, ...]

    @property
    def prior(self) -> Prior:
        """What this is to the robust estimator."""
        own = _tamper(self)
        return Prior(
            probability=own,
            verdict=self.verdict,
            known=self.known,
            exact=_named_exactly(own > 0.5, self.traces),
        )

    @property
    def without_traces(self) -> "Native":
        """What the network alone says."""
        return dataclasses.replace(
            self, log_odds=self.learned, verdict=self.learned_verdict, traces=()
        )

    @property
    def probability(self) -> np.ndarray:
        """That a Gaussian is tampered, shape (N,) float32."""
        return np.asarray(jax.nn.sigmoid(self.log_odds))


def native_evidence(
    gaussians: Gaussians, *, model: Model | None = None, exact: bool = True
) -> Native:
    """Ask the Gaussians themselves.

    Args:
        gaussians: N Gaussians.
        model: Replaces the one that comes with the package.
        exact: Whether to look for exact traces, too, which a re-export may wash out.

    Returns:
        The evidence. The order of the rows matters only where it is a trace.
    """
    model = model or shipped_model()
    host = jax.tree.map(np.asarray, gaussians)
    known = ~np.any(list(invalid_rows(host).values()), axis=0)
    sound = np.flatnonzero(known)
    learned = np.full(len(host), model.base, np.float32)
    worst, neighbours = model.base, None
    if len(sound) <= NEIGHBOURS:  # too few to have surroundings
        known[sound] = False
    else:
        usable = host.take(sound)
        learned[sound], nearest = _learned(usable, model)
        neighbours = np.tile(np.arange(len(host))[:, None], (1, ASKED))
        neighbours[sound] = sound[nearest]
        worst = worst_part(learned[sound], usable.means)
    found = traces(host, neighbours=neighbours) if exact else ()
    factor, shift = model.scene
    verdict = float(jax.nn.sigmoid(factor * worst + shift))
    certain = max((float(trace.score.max(initial=0)) for trace in found), default=0.0)
    return Native(
        known=known,
        learned=learned,
        learned_verdict=verdict,
        log_odds=with_traces(learned, found),
        base=model.base,
        worst=worst,
        verdict=1 - (1 - verdict) * (1 - certain),
        traces=tuple(found),
    )


def _learned(usable: Gaussians, model: Model) -> tuple[np.ndarray, np.ndarray]:
    """The opinion on each, (N,), and who is near it, (N, `ASKED`); the cues are let go."""
    described = cues(usable)
    return opinions(described, model), described.around.nearest[:, :ASKED].copy()


def find_native(native: Native, *, config: RobustConfig | None = None) -> Finding:
    """What is tampered where there are no masks.

    That the calibrated probabilities are mostly small says how often scenes like this one are
    misjudged. Given that something was edited, it is what stands out here (`level_of`).

    Args:
        native: What the Gaussians say, N of them.
        config: Of the estimator, of which the threshold and the doubt matter here; its defaults
            if not given.

    Returns:
        The finding; its attribute is the log odds, counted from that level.
    """
    config, certain = config or RobustConfig(), native.verdict
    tamper = _tamper(native)
    labels = (tamper > config.threshold) & (certain >= config.doubt)
    return Finding(
        attribute=_apart(native),
        tamper=tamper * (certain >= config.doubt),
        labels=labels,
        group_sizes=np.zeros((0, 3), np.int32),
        verdict=certain,
        warnings=_doubts(native, labels, certain),
    )


def _apart(native: Native) -> np.ndarray:
    """The log odds, counted from the level of what is labelled; 0 where nothing is known, (N,)."""
    return np.where(native.known, native.log_odds - level_of(native), 0).astype(np.float32)


def _tamper(native: Native) -> np.ndarray:
    """How likely each Gaussian is tampered, given that something is, (N,)."""
    return np.where(native.known, jax.nn.sigmoid(_apart(native)), 0).astype(np.float32)


def _named_exactly(labels: np.ndarray, found: Sequence[Trace]) -> bool:
    """Whether most is labelled for a trace that tells which: of copies either may be the edit."""
    telling = [trace for trace in found if trace.found and trace.name != "copied"]
    return bool(telling) and bool(2 * (labels & (combined(telling) > 0.5)).sum() > labels.sum())


def level_of(native: Native) -> float:
    """Log odds above which Gaussians are labelled.

    Where the network by itself is not sure of an edit, a share `LEVEL` of the way from the base
    rate to the most suspicious part; where it is, the `gap` on that way. Exact traces name the
    edit where the network is not sure of one or they name some of what stands apart: then at least
    `BESIDE` is asked of the rest.
    """
    way = max(native.worst - native.base, 0.0)
    level = native.base + LEVEL * way
    sure = native.learned_verdict > SURELY
    apart = gap(native.learned[native.known], native.base, way) if sure else level
    if any(trace.found for trace in native.traces):
        suspicious = native.learned > apart
        named = suspicious & (combined(native.traces) > 0.5)
        if not sure or named.sum() > NAMED * suspicious.sum():
            return max(level, BESIDE)
    return apart


def gap(log_odds: np.ndarray, base: float, way: float) -> float:
    """Level at which the number of Gaussians above depends least on it, in relative terms.

    As in maximally stable extremal regions (Matas et al., 2002), of the whole scene at once.

    Args:
        log_odds: Of N Gaussians, shape (N,).
        base: From where the level is counted.
        way: Length of the range of levels.

    Returns:
        The level, within `GAP` of that range.
    """
    levels, ordered = base + way * np.linspace(*GAP, 46), np.sort(log_odds)

    def above(levels: np.ndarray) -> np.ndarray:
        return np.log(len(ordered) - np.searchsorted(ordered, levels) + FEW)

    lost = above(levels - MARGIN * way) - above(levels + MARGIN * way)
    return float(levels[np.argmin(lost)])


def _doubts(native: Native, labels: np.ndarray, certain: float) -> list[str]:
    """What a user should know before believing the labels."""
    if not native.known.any():
        return ["No Gaussian could be described, so nothing is said of any."]
    if not labels.any():
        return ["Nothing about the Gaussians speaks for an edit."]
    if certain < 0.5:
        return [
            "What is labelled is what stands out most, as something does in untouched scenes, too: "
            "perhaps nothing was tampered with."
        ]
    return []


def with_traces(log_odds: np.ndarray, found: Sequence[Trace]) -> np.ndarray:
    """Log odds of the noisy-or of both: either alone is enough."""
    if not found:
        return log_odds
    score = np.minimum(combined(found), 1 - 1e-6)
    with np.errstate(divide="ignore"):  # a score of 0 leaves the log odds as they are
        return np.minimum(np.logaddexp(log_odds, np.log(score)) - np.log1p(-score), SURE)
