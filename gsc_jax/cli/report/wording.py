"""Sentences about results of `locate` for terminal, report and viewer.

A `report` is the content of a result.json.
"""

from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from gsc_jax.estimators.protocol import Outcome, Reliability, outcome

RELIABILITY: dict[Reliability, tuple[str, str, str]] = {  # sign, name, explanation, best first
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
    "masks and attributes": {"evidence": (1, 88), "inconclusive": (10, 7), "none": (13, 1)},
    "masks": {"evidence": (0, 92), "inconclusive": (11, 13), "none": (19, 0)},
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


def explained(report: Mapping[str, Any]) -> str:
    """What the scene probability of a report means, by the evidence it rests on."""
    attributes, verdict, basis = report.get("attributes") or {}, report["verdict"], "attributes"
    if (alone := attributes.get("verdict")) is None:
        basis = "masks"
    elif report.get("judged_views") and verdict != alone:  # else the masks are no evidence
        basis = "masks and attributes"
    return meaning(verdict, basis=basis, traced=attributes.get("traces"))


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


def conflict(report: Mapping[str, Any]) -> str | None:
    """A warning if the masks label Gaussians whose attributes are ordinary; None otherwise."""
    attributes = report["attributes"] or {}
    by_masks = outcome(report["verdict"]) == "evidence" != outcome(attributes.get("verdict"))
    if (rank := attributes.get("rank")) is None or rank < 0.5 or not by_masks:
        return None
    return (
        "The masks show an edit, the attributes of these Gaussians do not: of the other parts of "
        f"the scene, {percent(rank)} stand out more."
    )


def differences(shares: Mapping[str, float]) -> str | None:
    """State the three largest `contrasts` of labelled Gaussians; None if none is large."""
    found = {CONTRASTS[k][s < 0.5]: max(s, 1 - s) for k, s in shares.items() if k in CONTRASTS}
    largest = sorted(found, key=found.__getitem__, reverse=True)[:3]
    stated = [f"{word} in {percent(found[word])}" for word in largest if found[word] > MIN_CONTRAST]
    if not stated:
        return None
    return (
        "Compared pair by pair with those around them, these Gaussians are "
        f"{', '.join(stated)} of the pairs; parts that nobody edited may differ, too."
    )


def lead(report: Mapping[str, Any]) -> str:
    """State how many of all Gaussians are labelled as tampered, and which share they cover.

    Without evidence of editing they are candidates.
    """
    tampered, total = report["counts"]["tampered"], report["counts"]["gaussians"]
    views, covered = len(report["per_view"]), report["tampered_share_of_views"]
    count = f"{views} view{'' if views == 1 else 's'}"
    if not tampered:
        return f"None of {total:,} Gaussians is labelled as tampered; {count} were rendered."
    what = "labelled as tampered"
    if are_candidates(report.get("verdict")):
        what = "candidates: they stand out most, but an edit may also lie elsewhere"
    return (
        f"{tampered:,} of {total:,} Gaussians ({share(tampered / total)}) are {what}; they cover "
        f"{share(covered)} of the pixels of {count}."
    )


def are_candidates(verdict: float | None) -> bool:
    """Whether labels are candidates only: the scene probability is no evidence of editing."""
    return outcome(verdict) in ("inconclusive", "none")


def views_sentence(report: Mapping[str, Any]) -> str | None:
    """How many views were used and why no more; None if all available views were used."""
    if (stop := report["early_stopping"]) is None or stop["views"] == stop["available"]:
        return None
    return f"{stop['views']} of {stop['available']} used. {stop['reason']}"


def summary(report: Mapping[str, Any], out: Path) -> list[str]:
    """Summarise a run, whose results are in the folder `out`, in a few lines for the terminal."""
    verdict, attributes, findings = report["verdict"], report["attributes"], [lead(report)]
    if verdict is not None:
        prior = attributes["verdict"] if report["judged_views"] and attributes else None
        alone = "" if prior is None else f"; {percent(prior)} by the attributes alone"
        findings = [
            *filter(None, [conflict(report)]),
            f"{headline(verdict, report['counts']['tampered'])} {findings[0]}",
            f"edited   {percent(verdict)} (scene probability{alone}). {explained(report)}",
        ]
    seconds = Counter({name: stage["seconds"] for name, stage in report["stages"].items()})
    times = ", ".join(f"{name} {most:.1f} s" for name, most in seconds.most_common(3))
    beside, views = differences(report["contrasts"]), views_sentence(report)
    counts = Counter(view["reliability"] for view in report["per_view"])
    kinds = [f"{counts[key]} {name}" for key, (_, name, _) in RELIABILITY.items() if counts[key]]
    return [
        *findings,
        *([f"masks    {', '.join(kinds)}"] if kinds else []),
        *([f"views    {views}"] if views else []),
        *([f"contrast {beside}"] if beside else []),
        *(f"trace    {text}" for text in (attributes or {"traces": {}})["traces"].values()),
        f"method   {report['method']}",
        f"time     {report['seconds']:.1f} s (most work, over all threads: {times})",
        f"report   {out / 'report.html'}",
        f"images   {out / 'overview.png'}, {out / 'overlay'}",
        f"scene    {out / 'tamper.ply'}; for any viewer: {out / 'highlight.ply'}",
        f"numbers  {out / 'result.json'}, {out / 'labels.npy'}",
    ]
