"""A finished run of `locate`, and sentences about results for terminal, report and viewer."""

import dataclasses
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gsc_jax.estimators.protocol import Outcome, Reliability, outcome
from gsc_jax.forensics.traces import Trace
from gsc_jax.io.ply import PlyScene
from gsc_jax.locate import Result
from gsc_jax.scene import Camera


@dataclasses.dataclass(frozen=True)
class Located:
    """A finished run of `locate`; the masks of the result are files in the folder by now.

    Times and warnings of the result include those of reading and writing. `visible_share` is the
    mean tampered share of the views; `inputs` has size and SHA-256 of each input, by path.
    """

    scene: PlyScene
    cameras: list[Camera]
    result: Result
    visible_share: float
    inputs: dict[str, dict[str, Any]] = dataclasses.field(default_factory=dict)
    contrasts: dict[str, float] = dataclasses.field(default_factory=dict)


RELIABILITY: dict[Reliability, tuple[str, str, str]] = {
    "reliable": ("●", "reliable", "The mask flags most of what is labelled in the view."),
    "inverted": ("◇", "inverted", "The mask flags everything except the edit; it is inverted."),
    "uninformative": ("▽", "uninformative", "The mask does not flag most of what is labelled."),
    "unseen": ("✕", "too little in view", "The view shows too little of the edit to judge a mask."),
}
"""Sign, name and explanation of each reliability of a mask, the most useful first."""
TRACES = {
    "copy-move": "A copy of a part of a scene, for example in a hole, has the same stored values.",
    "quantisation": "Two files may have been joined; a large marked part may be the original.",
    "sh-degree": "Gaussians of another degree of spherical harmonics come from another model.",
    "row-order": "Training stores no spatial order; an appended object occupies consecutive rows.",
    "quaternion-convention": "Rotations in another convention were written by another program.",
}
"""Why each trace is evidence of an edit."""
CONTRASTS = {
    "size": ("larger", "smaller"),
    "flatness": ("flatter", "rounder"),
    "opacity": ("more opaque", "more transparent"),
    "brightness": ("brighter", "darker"),
    "saturation": ("more colourful", "greyer"),
    "view dependence": ("more view-dependent", "less view-dependent"),
}
"""Words for Gaussians that have more of a property, and for those that have less."""
MIN_CONTRAST = 0.7
"""Share of pairs above which a difference is stated: chance seldom reaches it, see `MIN_COUNT`."""
HEADLINES: dict[Outcome, str] = {
    "evidence": "Evidence of editing.",
    "inconclusive": "Inconclusive: it is unclear whether this scene was edited.",
    "none": "No evidence of editing.",
}
COUNTS: dict[str, dict[Outcome, tuple[int, int]]] = {
    "masks and attributes": {"evidence": (0, 89), "inconclusive": (10, 7), "none": (14, 0)},
    "masks": {"evidence": (3, 92), "inconclusive": (8, 12), "none": (19, 1)},
    "attributes": {"evidence": (0, 85), "inconclusive": (9, 52), "none": (85, 143)},
}
"""By kind of evidence and by outcome, how many authentic and how many edited test scenes had it;
counted in docs/beside_masks.csv, docs/calibration.csv and docs/heldout.csv, in this order."""
MIN_RATIO = 3
"""Ratio of the shares of edited and authentic scenes below which an outcome says little."""
ROUNDED_SHARE = 0.0005
"""Shares closer to 0 or 1 are shown as a bound: one decimal of a percentage would hide them."""


def percent(probability: float) -> str:
    """Format a probability as a percentage, never as 0% or 100%."""
    bound = "<" if probability < 0.01 else ">" if probability > 0.99 else ""
    return f"{bound}{min(max(probability, 0.01), 0.99):.0%}"


def share(part: float) -> str:
    """Format a share as a percentage; 0% and 100% mean exactly none and exactly all."""
    if 0 < part < ROUNDED_SHARE or 1 - ROUNDED_SHARE <= part < 1:
        return "<0.1%" if part < 0.5 else ">99.9%"
    return f"{part:.0%}" if part in (0, 1) else f"{part:.1%}"


def headline(verdict: float | None, tampered: int) -> str:
    """State in one sentence what was found, by scene probability and label count."""
    if (found := outcome(verdict)) is not None:
        return HEADLINES[found]
    if tampered:
        return "Gaussians are labelled, but this method gives no scene probability."
    return "No Gaussian is labelled as tampered."


def basis(verdict: float | None, masks: object, alone: float | None) -> str:
    """What evidence a scene probability uses; `alone` is the probability by the attributes only."""
    # Masks that are no evidence leave that of the attributes as it is.
    if masks and alone is not None and verdict != alone:
        return "masks and attributes"
    return "masks" if alone is None else "attributes"


def meaning(verdict: float, *, basis: str, traced: object = False) -> str:
    """State how often authentic and edited test scenes had this outcome with this evidence.

    No test counts traces, on which a scene probability rests where any is found.
    """
    if traced and "attributes" in basis:
        return (
            f"It rests on {'the masks and on ' if 'masks' in basis else ''}a trace in the stored "
            "values. Editing a part of a file leaves one, but so may any program that rewrites "
            "only a part; and of two parts, the one that is not labelled may be the edit."
        )
    found = outcome(verdict)
    assert found is not None
    counts, totals = COUNTS[basis][found], list(map(sum, zip(*COUNTS[basis].values(), strict=True)))
    authentic, edited = (count / total for count, total in zip(counts, totals, strict=True))
    weak = max(authentic, edited) < MIN_RATIO * min(authentic, edited)
    kind = "simulated masks alone" if basis == "masks" else f"{basis} in re-exported files"
    return (
        f"In tests of {kind} of {'two' if ' and ' in basis else 'five'} scenes, {counts[0]} of "
        f"{totals[0]} authentic and {counts[1]} of {totals[1]} edited cases had this outcome"
        f"{': on its own, it says little about whether a scene was edited' if weak else ''}."
    )


def conflict(result: Result) -> str | None:
    """A warning if the masks label Gaussians whose attributes are ordinary; None otherwise."""
    rank, prior = result.rank, result.prior.verdict if result.prior else None
    by_masks = outcome(result.verdict) == "evidence" and outcome(prior) != "evidence"
    if rank is None or rank < 0.5 or not by_masks:
        return None
    return (
        "The masks show an edit, the attributes of these Gaussians do not: of the other parts of "
        f"the scene, {percent(rank)} stand out more."
    )


def differences(shares: Mapping[str, float]) -> str | None:
    """State the three largest `contrasts` of labelled Gaussians; None if none is large."""
    shares = {name: share for name, share in shares.items() if name in CONTRASTS}
    found = {CONTRASTS[name][s < 0.5]: max(s, 1 - s) for name, s in shares.items()}
    largest = sorted(found, key=found.__getitem__, reverse=True)[:3]
    stated = [f"{word} in {percent(found[word])}" for word in largest if found[word] > MIN_CONTRAST]
    if not stated:
        return None
    return (
        "Compared pair by pair with those around them, these Gaussians are "
        f"{', '.join(stated)} of the pairs; parts that nobody edited may differ, too."
    )


def labels_sentence(
    tampered: int, total: int, *, verdict: float | None, views: int, covered: float
) -> str:
    """State how many of all Gaussians are labelled as tampered, and which share they cover.

    Without evidence of editing they are candidates. `covered` is the mean share of tampered pixels.
    """
    count = f"{views} view{'' if views == 1 else 's'}"
    if not tampered:
        return f"None of {total:,} Gaussians is labelled as tampered; {count} were rendered."
    what = "labelled as tampered"
    if are_candidates(verdict):
        what = "candidates: they stand out most, but an edit may also lie elsewhere"
    return (
        f"{tampered:,} of {total:,} Gaussians ({share(tampered / total)}) are {what}; they cover "
        f"{share(covered)} of the pixels of {count}."
    )


def are_candidates(verdict: float | None) -> bool:
    """Whether labels are candidates only: the scene probability is no evidence of editing."""
    return outcome(verdict) in ("inconclusive", "none")


def found_traces(result: Result) -> list[Trace]:
    """Traces of editing that were found in the stored values."""
    return [trace for trace in getattr(result.prior, "traces", ()) if trace.found]


def views_sentence(result: Result) -> str | None:
    """How many views were used and why no more; None if all available views were used."""
    if (stop := result.early_stopping) is None or stop.views == stop.available:
        return None
    return f"{stop.views} of {stop.available} used. {stop.reason}"


def summary(located: Located, out: Path) -> list[str]:
    """Summarise a run, whose results are in the folder `out`, in a few lines for the terminal."""
    result, verdict, findings = located.result, located.result.verdict, [lead(located)]
    if verdict is not None:
        contradiction = conflict(result)
        masks, prior = result.probabilities, result.prior
        alone = f"; {percent(prior.verdict)} by the attributes alone" if masks and prior else ""
        rests_on = basis(verdict, masks, prior.verdict if prior else None)
        known = {"basis": rests_on, "traced": found_traces(result)}
        findings = [
            *([contradiction] if contradiction else []),
            f"{headline(verdict, int(result.labels.sum()))} {findings[0]}",
            f"edited   {percent(verdict)} (scene probability{alone}). {meaning(verdict, **known)}",
        ]
    seconds = {name: stage["seconds"] for name, stage in result.stages.items()}
    slowest = sorted(seconds, key=seconds.__getitem__, reverse=True)[:3]
    times = ", ".join(f"{name} {seconds[name]:.1f} s" for name in slowest)
    beside = differences(located.contrasts)
    counts = Counter(result.reliability.values())
    kinds = [f"{counts[key]} {name}" for key, (_, name, _) in RELIABILITY.items() if counts[key]]
    views = views_sentence(result)
    return [
        *findings,
        *([f"masks    {', '.join(kinds)}"] if kinds else []),
        *([f"views    {views}"] if views else []),
        *([f"contrast {beside}"] if beside else []),
        *(f"trace    {trace.explanation}" for trace in found_traces(result)),
        f"method   {result.method}",
        f"time     {result.seconds:.1f} s (most work, over all threads: {times})",
        f"report   {out / 'report.html'}",
        f"images   {out / 'overview.png'}, {out / 'overlay'}",
        f"scene    {out / 'tamper.ply'}; for any viewer: {out / 'highlight.ply'}",
        f"numbers  {out / 'result.json'}, {out / 'labels.npy'}",
    ]


def lead(located: Located) -> str:
    """What `labels_sentence` states about a run."""
    result = located.result
    return labels_sentence(
        int(result.labels.sum()),
        len(result.labels),
        verdict=result.verdict,
        views=len(result.masks),
        covered=located.visible_share,
    )
