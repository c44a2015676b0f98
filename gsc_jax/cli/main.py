"""`gsc-jax`: parses the command line, runs the command, and tells people how it went.

Exit codes: 0 done; 2 bad input, said in one line on stderr; 130 interrupted; anything that is our
fault ends in a traceback and 1. Results go to stdout, warnings and progress to stderr, the warnings
last, where they are seen.
"""

import contextlib
import dataclasses
import functools
import importlib.metadata
import io
import operator
import os
import shutil
import sys
import textwrap
import typing
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import tyro

from gsc_jax.cli.cache import default_cache, use_cache
from gsc_jax.cli.config_file import read_settings
from gsc_jax.cli.demo import run_demo
from gsc_jax.cli.dry_run import dry_run
from gsc_jax.cli.evaluate import run_evaluate
from gsc_jax.cli.locate import run_locate, run_render
from gsc_jax.cli.options import Demo, Evaluate, Locate, Render, Tamper, View
from gsc_jax.cli.progress import Bars
from gsc_jax.cli.python_warnings import caught
from gsc_jax.cli.report.wording import summary
from gsc_jax.cli.tamper import run_tamper
from gsc_jax.scene import InputError

Command = Locate | Render | Tamper | Evaluate | View | Demo
NAMES: dict[str, type] = {kind.__name__.lower(): kind for kind in typing.get_args(Command)}
Told = tuple[list[str], list[str]]
"""What a person is told: lines, and warnings."""

DESCRIPTION = """\
Finds the tampered Gaussians in a 3D Gaussian Splatting model: from the Gaussians themselves, and
from what a 2D detector says about its views (GS-Checker, in JAX, on the CPU). Start with:
gsc-jax demo --out demo

Lengths are in the units of the scene, sizes in pixels. Exit codes: 0 done, 2 bad input, 130
interrupted (Ctrl-C: no file is left half written), 1 our fault."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class _File:
    """The one option that has to be known before the others."""

    config: Path | None = None


def main(argv: Sequence[str] | None = None) -> int:
    """Runs a command.

    Args:
        argv: Arguments, by default those of the process.

    Returns:
        The exit code.
    """
    argv = list(sys.argv[1:] if argv is None else argv)
    if isinstance(sys.stdout, io.TextIOWrapper):  # a path may hold bytes that are no text
        sys.stdout.reconfigure(errors="backslashreplace")
    if argv == ["--version"]:
        print(f"gsc-jax {importlib.metadata.version('gsc_jax')}")
        return 0
    command = None
    try:
        command = parse(argv)
        _run(command)
    except InputError as error:
        return _complain(f"{error}{_from_a_file(command, argv, str(error))}", 2)
    except BrokenPipeError:  # whoever read our stdout, such as `head`, has had enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        return _complain(f"{error.filename or 'a file'}: {error.strerror or error}", 2)
    except KeyboardInterrupt as stop:
        kept = getattr(stop, "__notes__", None) or ["no file is left half written"]
        return _complain("; ".join(["interrupted", *kept]), 130)
    return 0


def _from_a_file(command: Command | None, argv: Sequence[str], error: str) -> str:
    """Where a path comes from that is complained of, if nobody typed it."""
    if not isinstance(command, Locate) or command.config is None:
        return ""
    paths = [command.scene, command.cameras, command.masks, command.spec, *command.detector]
    told = {str(path) for path in paths if path} - set(argv)
    if not any(error.startswith(path) for path in told):
        return ""
    return f" (said by {command.config}, whose paths are relative to where you are)"


def parse(argv: Sequence[str]) -> Command:
    """The command that somebody typed, with what its --config says of the rest.

    Args:
        argv: The arguments.

    Raises:
        InputError: if they make no command; prints and exits where they ask for help.
    """
    path = _typed(_File, argv, return_unknown_args=True, add_help=False)[0].config
    if path is None or argv[0] != "locate":
        commands = _commands(brief=not any(word in NAMES for word in argv))
        return _typed(commands, argv, config=(tyro.conf.FlagCreatePairsOff,))
    settings = read_settings(path)
    command = _typed(_commands(settings.default()), argv)
    if command.method != settings.method:  # what the file says is of another one
        command = _typed(_commands(settings.about(command.method).default()), argv)
    return command


def _commands(default: Locate | None = None, *, brief: bool = False) -> Any:
    """The commands for tyro, `locate` with other defaults than its own, or in a line each."""
    kinds = []
    for name, kind in NAMES.items():
        told: dict[str, Any] = {"default": default} if default and kind is Locate else {}
        if brief:
            told["description"] = (kind.__doc__ or "").partition("\n")[0]
        kinds.append(Annotated[kind, tyro.conf.subcommand(name=name, **told)])
    return functools.reduce(operator.or_, kinds)


def _typed(form: Any, argv: Sequence[str], **options: Any) -> Any:
    """What tyro makes of the arguments; its framed complaints become one line, its help is told."""
    complaint, helptext = io.StringIO(), _Page()
    try:
        with contextlib.redirect_stderr(complaint), contextlib.redirect_stdout(helptext):
            return tyro.cli(
                form, prog="gsc-jax", description=DESCRIPTION, args=list(argv), **options
            )
    except SystemExit as stop:
        if not stop.code:
            print(_wrapped(helptext.getvalue()), end="")
            raise
        raise InputError(_complained(complaint.getvalue(), argv)) from None


def _complained(text: str, argv: Sequence[str]) -> str:
    """What tyro complains of in a frame, in a line: without the help of what it names."""
    inside = [line.strip("│").rstrip() for line in text.splitlines()[1:-1]]
    sections = "\n".join(inside).split("─" * 20)
    said = []
    for section in sections:
        first = section.strip("─\n ").partition("\n\n")[0]
        lines = [line.strip() for line in first.splitlines() if not line.startswith(HELP_INDENT)]
        if lines and not lines[0].startswith(("For full helptext", "Argument helptext")):
            said.append(" ".join(lines).rstrip("."))
    command = f" {argv[0]}" if argv and argv[0] in NAMES else ""
    return f"{'; '.join(filter(None, said))}; see gsc-jax{command} --help"


HELP_INDENT = " " * 8
"""How tyro indents what an option is for, below its name."""


class _Page(io.StringIO):
    """Text with the frames and colours that stdout would get."""

    @property
    def encoding(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return getattr(sys.__stdout__, "encoding", "ascii")

    def isatty(self) -> bool:
        return bool(sys.__stdout__ and sys.__stdout__.isatty())


def _wrapped(text: str) -> str:
    """Help with its paragraphs broken between words; tyro does so inside of its frames only."""
    width = shutil.get_terminal_size().columns
    fill = functools.partial(textwrap.fill, width=width, break_on_hyphens=False)
    lines = [
        fill(line) if len(line) > width and line[:1].isalpha() else line
        for line in text.split("\n")
    ]
    return "\n".join(lines)


def _run(command: Command) -> None:
    """Runs a command; what it is about comes last on stdout, what to mind last of all."""
    warnings: list[str] = []
    if not getattr(command, "no_cache", False):
        use_cache(default_cache())
    raised: list[str] = []
    try:
        with caught() as raised, Bars() as bars:
            lines, warnings = _answer(command, bars)
        print(*lines, sep="\n", flush=True)
    finally:
        _warn([*warnings, *(said for said in raised if said not in warnings)])


def _answer(command: Command, bars: Bars) -> Told:
    if isinstance(command, Demo):
        return run_demo(command, progress=bars), []
    if isinstance(command, Render):
        count, warnings = run_render(command, progress=bars)
        return [f"{count} {'image' if count == 1 else 'images'} in {command.out}"], warnings
    if isinstance(command, Tamper):
        return run_tamper(command, progress=bars)
    if isinstance(command, Evaluate):
        return run_evaluate(command)
    if isinstance(command, View):
        from gsc_jax.cli.viewer.server import run_view

        return run_view(command, progress=bars, say=functools.partial(print, flush=True))
    if command.dry_run:
        return dry_run(command, progress=bars)
    located = run_locate(command, progress=bars)
    return summary(located, command.out), located.warnings


def _warn(warnings: Sequence[str]) -> None:
    if warnings:
        counted = "1 warning" if len(warnings) == 1 else f"{len(warnings)} warnings"
        print(f"{counted}:", *(f"  {said}" for said in warnings), sep="\n", file=sys.stderr)


def _complain(message: str, code: int) -> int:
    print(f"gsc-jax: {' '.join(message.split())}", file=sys.stderr)
    return code


if __name__ == "__main__":
    sys.exit(main())
