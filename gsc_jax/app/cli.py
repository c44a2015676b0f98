"""`gsc-jax`: parses the command line, runs the command, and tells people how it went.

Exit codes: 0 done; 2 bad input, said in one line on stderr; 130 interrupted; anything that is our
fault ends in a traceback and 1. Results go to stdout, warnings and progress to stderr.
"""

import contextlib
import importlib.metadata
import io
import os
import re
import sys
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import tyro

from gsc_jax.app.cache import default_cache, use_cache
from gsc_jax.app.demo import run_demo
from gsc_jax.app.options import Demo, Locate, Render, Tamper
from gsc_jax.app.outputs import Located
from gsc_jax.app.progress import Bars
from gsc_jax.app.run import run_locate, run_render
from gsc_jax.app.tampering import run_tamper
from gsc_jax.errors import InputError
from gsc_jax.finding import Reliability
from gsc_jax.locate import Result

Command = Locate | Render | Tamper | Demo

MASKS: dict[Reliability, str] = {
    "finds": "finding it",
    "misses": "missing it",
    "inverted": "inverted",
    "unseen": "of views without it",
}
"""What a mask is worth, in the words of the summary."""
DESCRIPTION = """\
Finds the tampered Gaussians in a 3D Gaussian Splatting model, from what a 2D detector says about
its views (GS-Checker, in JAX, on the CPU). Start with: gsc-jax demo --out demo

Lengths are in the units of the scene, sizes in pixels. Exit codes: 0 done, 2 bad input, 1 our
fault."""


def main(argv: Sequence[str] | None = None) -> int:
    """Runs a command.

    Args:
        argv: Arguments, by default those of the process.

    Returns:
        The exit code.
    """
    argv = sys.argv[1:] if argv is None else argv
    if list(argv) == ["--version"]:
        print(f"gsc-jax {importlib.metadata.version('gsc_jax')}")
        return 0
    try:
        command = _parse(argv)
        if not command.no_cache:
            use_cache(default_cache())
        _run(command)
    except InputError as error:
        return _complain(str(error), 2)
    except BrokenPipeError:  # whoever read our stdout, such as `head`, has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        return _complain(f"{error.filename or 'a file'}: {error.strerror or error}", 2)
    except KeyboardInterrupt:
        return _complain("interrupted; no file is left half written", 130)
    return 0


def _parse(argv: Sequence[str]) -> Command:
    """The command; tyro's framed complaints become one line, its help is printed as it is."""
    complaint = io.StringIO()
    try:
        with contextlib.redirect_stderr(complaint):
            return tyro.cli(
                Command,
                prog="gsc-jax",
                description=DESCRIPTION,
                args=list(argv),
                config=(tyro.conf.FlagCreatePairsOff,),
            )
    except SystemExit as stop:
        if not stop.code:
            raise
        title, _, text = complaint.getvalue().strip().partition("\n")
        frame = re.compile(r"[╭╮╰╯│─•]+")
        parts = [" ".join(frame.sub(" ", part).split()) for part in (title, text)]
        raise InputError(": ".join(parts)) from None


def _run(command: Command) -> None:
    with Bars() as bars:
        if isinstance(command, Demo):
            lines, warnings = run_demo(command, progress=bars), []
        elif isinstance(command, Render):
            count, warnings = run_render(command, progress=bars)
            lines = [f"{count} {'image' if count == 1 else 'images'} in {command.out}"]
        elif isinstance(command, Tamper):
            lines, warnings = run_tamper(command, progress=bars)
        else:
            located = run_locate(command, progress=bars)
            lines, warnings = summary(located, command.out), located.warnings
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)
    print(*lines, sep="\n")


def summary(located: Located, out: Path) -> list[str]:
    """What a person wants to know of a run, in a few lines.

    Args:
        located: The run.
        out: Where its results are.
    """
    labels, views = located.result.labels, len(located.result.masks)
    found = int(labels.sum())
    seconds = {name: stage["seconds"] for name, stage in located.stages.items()}
    slowest = sorted(seconds, key=seconds.__getitem__, reverse=True)[:3]
    times = ", ".join(f"{name} {seconds[name]:.1f} s" for name in slowest)
    verdict = (
        f"{found:,} of {len(labels):,} Gaussians are tampered ({found / len(labels):.1%}); they "
        f"cover {located.visible_share:.1%} of what {views} views show."
        if found
        else f"No tampered Gaussian was found: none of {len(labels):,}, in {views} views."
    )
    if found and located.result.verdict is not None and located.result.verdict < 0.5:
        verdict = f"Probably nothing was tampered with. If something was: {verdict}"
    return [
        verdict,
        *_judgement(located.result),
        *_traces(located.result),
        f"method   {located.result.method}",
        f"time     {located.seconds:.1f} s (most work: {times})",
        f"look at  {out / 'overview.png'}, {out / 'overlay'}",
        f"scene    {out / 'tamper.ply'}; for any viewer: {out / 'highlight.ply'}",
        f"numbers  {out / 'result.json'}, {out / 'labels.npy'}",
    ]


def _judgement(result: Result) -> list[str]:
    """Whether anything was tampered with at all, and what the masks are worth, if that is known."""
    lines = []
    if result.verdict is not None:
        percent = f"{min(max(result.verdict, 0.01), 0.99):.0%}"
        bound = "<" if result.verdict < 0.01 else ">" if result.verdict > 0.99 else ""
        lines.append(f"verdict  {bound}{percent}: probability that anything was tampered with")
    counts = Counter(result.reliability.values())
    if counts:
        said = ", ".join(f"{text} {counts[key]}" for key, text in MASKS.items() if counts[key])
        lines.append(f"masks    {said}, of {counts.total()}")
    if result.effort and result.effort.views < result.effort.available:
        effort = result.effort
        lines.append(f"looked   at {effort.views} of {effort.available} views: {effort.reason}")
    return lines


def _traces(result: Result) -> list[str]:
    """What editing left in the numbers of the file, where anything."""
    found = result.native.traces if result.native else ()
    return [f"trace    {trace.explanation}" for trace in found if trace.found]


def _complain(message: str, code: int) -> int:
    print(f"gsc-jax: {' '.join(message.split())}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
