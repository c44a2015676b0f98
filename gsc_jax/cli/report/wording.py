"""The words in which results are told: the same on the command line and in the report."""

import dataclasses
from collections import Counter
from pathlib import Path

from gsc_jax.cli.located import Located
from gsc_jax.estimators.protocol import Reliability
from gsc_jax.forensics.traces import Trace
from gsc_jax.locate import Result

MASKS: dict[Reliability, str] = {
    "finds": "finding it",
    "misses": "missing it",
    "inverted": "inverted",
    "unseen": "of views without it",
}
"""What a mask is worth, in the words of a count."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Worth:
    """What a mask is worth, for people.

    Attributes:
        sign: Tells it from the others without colour.
        short: In two words, of one mask.
        long: What it means, as a sentence.
    """

    sign: str
    short: str
    long: str


WORTH: dict[Reliability, Worth] = {
    "finds": Worth(
        sign="●", short="finds it", long="The mask flags what was found, where the view shows it."
    ),
    "inverted": Worth(
        sign="◇",
        short="inverted",
        long="The mask flags everything else, and was read the other way round.",
    ),
    "misses": Worth(
        sign="▽",
        short="misses it",
        long="The view shows what was found, the mask does not flag it.",
    ),
    "unseen": Worth(sign="✕", short="not in view", long="The view does not show what was found."),
}
"""What masks are worth, the best first."""
PROBABLY = 0.65
"""Below this, an edit is not spoken of without a doubt."""
LIKELY: tuple[tuple[float, str], ...] = (
    (0.99, "Almost certainly, something in this scene was tampered with."),
    (0.9, "Very probably, something in this scene was tampered with."),
    (PROBABLY, "Probably, something in this scene was tampered with."),
    (1 - PROBABLY, "It is unclear whether anything in this scene was tampered with."),
    (0.1, "Probably, nothing in this scene was tampered with."),
    (0.0, "Very probably, nothing in this scene was tampered with."),
)
"""What a probability is called, down to which."""


def percent(probability: float) -> str:
    """A probability for people, which is never quite 0% or 100%."""
    bound = "<" if probability < 0.01 else ">" if probability > 0.99 else ""
    return f"{bound}{min(max(probability, 0.01), 0.99):.0%}"


def share(part: float) -> str:
    """A share for people, which is 0% only where there is nothing and 100% where there is all."""
    if 0 < part < 0.0005 or 0.9995 <= part < 1:
        return "<0.1%" if part < 0.5 else ">99.9%"
    return f"{part:.0%}" if part in (0, 1) else f"{part:.1%}"


def headline(verdict: float | None, found: int) -> str:
    """Whether anything was tampered with, in a sentence.

    Args:
        verdict: Probability that anything was; None of methods that do not say.
        found: Number of tampered Gaussians.
    """
    if verdict is not None:
        return next(said for least, said in LIKELY if verdict >= least)
    if found:
        return "Something was labelled; whether it was tampered with, this method cannot say."
    return "No tampered Gaussian was found."


def found_sentence(
    found: int, total: int, *, verdict: float | None, views: int, covered: float
) -> str:
    """How many Gaussians are tampered and what they cover, with a doubt where the verdict has one.

    Args:
        found: Number of tampered Gaussians.
        total: Number of all.
        verdict: Probability that anything was tampered with, or None.
        views: Number of views.
        covered: Mean share of a view that is tampered.
    """
    shown = f"{views} view{'' if views == 1 else 's'}"
    if not found:
        return f"No tampered Gaussian was found: none of {total:,}, in {shown}."
    return (
        f"{'If something was: ' if doubtful(verdict, found) else ''}"
        f"{found:,} of {total:,} Gaussians are labelled as tampered ({share(found / total)}); they "
        f"cover {share(covered)} of what {shown} show{'s' if views == 1 else ''}."
    )


def doubtful(verdict: float | None, found: int) -> bool:
    """Whether something was found although the verdict is not that anything was edited."""
    return found > 0 and verdict is not None and verdict < PROBABLY


def verdict_sentence(located: Located) -> str:
    """`found_sentence`, after the `headline` where the two do not agree."""
    result = located.result
    found, verdict = int(result.labels.sum()), result.verdict
    said = found_sentence(
        found,
        len(result.labels),
        verdict=verdict,
        views=len(result.masks),
        covered=located.visible_share,
    )
    return f"{headline(verdict, found)} {said}" if doubtful(verdict, found) else said


def masks_sentence(result: Result) -> str | None:
    """What the masks are worth, counted; None where that is not known."""
    counts = Counter(result.reliability.values())
    if not counts:
        return None
    said = ", ".join(f"{text} {counts[key]}" for key, text in MASKS.items() if counts[key])
    return f"{said}, of {counts.total()}"


def effort_sentence(result: Result) -> str | None:
    """How many views were looked at and why no more; None where it was all of them."""
    effort = result.effort
    if effort is None or effort.views == effort.available:
        return None
    return f"at {effort.views} of {effort.available} views: {effort.reason}"


TRACES: dict[str, tuple[str, str]] = {
    "copied": (
        "Copies",
        "Copying a part of a scene, as to fill a hole, leaves the same numbers in two places.",
    ),
    "lattice": (
        "Digits",
        "A file that was saved with few digits has none between them; what was added later has.",
    ),
    "degree": (
        "Colour model",
        "How much colours change with the view is one setting of a training, for all of a scene.",
    ),
    "rows": (
        "Order of the file",
        "Training leaves Gaussians in no order; what is appended lies together at the end.",
    ),
    "quaternions": (
        "Rotations",
        "A program writes rotations in one convention; what another one wrote differs.",
    ),
}
"""What traces of editing are called, and why they tell of it, by name."""


def traces_found(result: Result) -> list[Trace]:
    """What editing left in the numbers of the file."""
    return [trace for trace in (result.native.traces if result.native else ()) if trace.found]


def summary(located: Located, out: Path) -> list[str]:
    """What a person wants to know of a run, in a few lines.

    Args:
        located: The run.
        out: Where its results are.
    """
    result = located.result
    seconds = {name: stage["seconds"] for name, stage in located.stages.items()}
    slowest = sorted(seconds, key=seconds.__getitem__, reverse=True)[:3]
    times = ", ".join(f"{name} {seconds[name]:.1f} s" for name in slowest)
    return [
        verdict_sentence(located),
        *_judgement(result),
        *(f"trace    {trace.explanation}" for trace in traces_found(result)),
        f"method   {result.method}",
        f"time     {located.seconds:.1f} s (most work: {times})",
        f"look at  {out / 'report.html'}",
        f"         {out / 'overview.png'}, {out / 'overlay'}",
        f"scene    {out / 'tamper.ply'}; for any viewer: {out / 'highlight.ply'}",
        f"numbers  {out / 'result.json'}, {out / 'labels.npy'}",
    ]


def _judgement(result: Result) -> list[str]:
    """Whether anything was tampered with at all, and what the masks are worth, if that is known."""
    lines = []
    if result.verdict is not None:
        said = percent(result.verdict)
        lines.append(f"verdict  {said}: probability that anything was tampered with")
    for name, sentence in (
        ("masks", masks_sentence(result)),
        ("looked", effort_sentence(result)),
    ):
        if sentence:
            lines.append(f"{name:8} {sentence}")
    return lines
