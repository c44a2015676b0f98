"""`gsc-jax`: parse the command line, run the command, print results and warnings.

Exit codes: 0 done; 2 bad input, with one line on stderr, or tyro's message about the options; 1 an
error of this program, with a traceback. `gsc_jax.__main__` adds the codes of signals. Results go to
stdout; progress and, at the end, warnings go to stderr.
"""

import argparse
import contextlib
import errno
import importlib.metadata
import io
import operator
import os
import sys
import warnings
from collections.abc import Iterator, Sequence
from functools import partial, reduce
from pathlib import Path
from typing import Annotated, Any, get_args

import tyro

import gsc_jax
from gsc_jax.cli.cache import cache_folder, enable_compilation_cache
from gsc_jax.cli.check import Check, run_check
from gsc_jax.cli.config_file import read_config_file
from gsc_jax.cli.demo import run_demo
from gsc_jax.cli.evaluate import run_evaluate
from gsc_jax.cli.locate import dry_run, earlier_results, run_locate
from gsc_jax.cli.options import Demo, Evaluate, Locate, Render, SceneOptions, Tamper, View
from gsc_jax.cli.progress import Bars
from gsc_jax.cli.render import run_render
from gsc_jax.cli.report.wording import summary
from gsc_jax.cli.scan import Scan, run_scan
from gsc_jax.cli.tamper import run_tamper
from gsc_jax.cli.verify import Verify, run_verify
from gsc_jax.cli.viewer.server import run_view
from gsc_jax.evidence.monitor import Monitor
from gsc_jax.io.validation import naming, printable, suggestion
from gsc_jax.render.up import AXES
from gsc_jax.scene import InputError
from gsc_jax.scene.parallel import compute_in_calling_thread

Command = Locate | Scan | Render | Tamper | Evaluate | Check | Verify | View | Demo
COMMANDS: dict[str, type] = {kind.__name__.lower(): kind for kind in get_args(Command)}
FAULTS = (errno.ENOENT, errno.ENOTDIR, errno.EISDIR, errno.EEXIST, errno.EBADF, errno.EINVAL)
FAULTS += (errno.ENOTEMPTY, None)
"""Errors that are faults of this program, unless they are of a path that the user gave."""

DESCRIPTION = """\
Find the tampered Gaussians in a 3D Gaussian Splatting model (GS-Checker, in JAX).

start with:
  gsc-jax demo --out demo
  gsc-jax --version

units: those of the scene for lengths, pixels for sizes

exit codes:
  0 done, 2 bad input, 130 interrupted (Ctrl-C: no file is left half
  written), 143 terminated, 1 an error of this program"""


def main(argv: Sequence[str] | None = None) -> int:
    """Run a command, by default that of the arguments of the process; return the exit code.

    Raises:
        SystemExit: with code 0 after --help, with code 2 if the options cannot be parsed.
    """
    argv = list(sys.argv[1:] if argv is None else argv)
    if isinstance(sys.stdout, io.TextIOWrapper):  # a path may hold bytes that are not text
        sys.stdout.reconfigure(errors="backslashreplace")
    if argv == ["--version"]:
        print(f"gsc-jax {importlib.metadata.version('gsc_jax')}")
        return 0
    command = None
    try:
        if any(not word or word[:2] + word[-1] == "--=" for word in argv if word != "--up="):
            raise InputError("an argument is empty; is a variable of the shell not set?")
        command = parse(argv)
        absent = contextlib.suppress(FileNotFoundError, NotADirectoryError, PermissionError)
        for path in _paths(command):  # refuse those that no file can have, before they are used
            with naming(path, errors=(ValueError, OSError), remedy="; give another path"), absent:
                path.stat()
        _run(command)
    except InputError as error:
        return _refuse(f"{error}{_origin(command, argv, str(error))}")
    except BrokenPipeError:  # the reader of stdout, such as `head`, has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        if error.errno in FAULTS and not _is_given(error, command):
            raise
        return _refuse(f"{error.filename or 'a file'}: {error.strerror or error}")
    return 0


def parse(argv: Sequence[str]) -> Command:
    """Parse the arguments; with --config, the file supplies the defaults of `locate` and `scan`."""
    argv = list(argv)
    for index in range(len(argv) - 1, 0, -1):  # argparse takes a value -y for an option
        if argv[index - 1] == "--up" and argv[index] in AXES:
            argv[index - 1 : index + 1] = [f"--up={argv[index]}"]
    finder = argparse.ArgumentParser(prog="gsc-jax locate", add_help=False, allow_abbrev=False)
    finder.add_argument("--config", type=Path)
    path = finder.parse_known_args(argv)[0].config
    if path is None or argv[0] not in ("locate", "scan"):
        return _parse(argv)
    file = read_config_file(path)
    command = _parse(argv, file.options())
    if command.method == file.method:
        return command
    return _parse(argv, file.for_method(command.method).options())


def _parse(argv: Sequence[str], default: Locate | None = None) -> Any:
    """Parse with tyro, which prints help and its own errors."""
    if argv and not argv[0].startswith("-") and argv[0] not in COMMANDS:
        raise InputError(f"{argv[0]}: no such command{suggestion(argv[0], [*COMMANDS])}")
    brief = not any(word in COMMANDS for word in argv)  # the list of commands: a line each
    kinds = []
    for name, kind in COMMANDS.items():
        settings: dict[str, Any] = {}
        if default and issubclass(kind, Locate):
            settings["default"] = kind(**vars(default))
        if brief:
            settings["description"] = (kind.__doc__ or "").partition("\n")[0]
        kinds.append(Annotated[kind, tyro.conf.subcommand(name=name, **settings)])
    with _escaped_stderr(argv):
        return tyro.cli(
            reduce(operator.or_, kinds),
            prog="gsc-jax",
            description=DESCRIPTION,
            args=list(argv),
            # A file may set a switch, which --no- then unsets.
            config=() if default else (tyro.conf.FlagCreatePairsOff,),
        )


@contextlib.contextmanager
def _escaped_stderr(argv: Sequence[str]) -> Iterator[None]:
    """Escape control characters in messages of tyro, which repeat the arguments."""
    if all(printable(word) == word for word in argv):  # keep the colours
        yield
        return
    messages = io.StringIO()
    try:
        with contextlib.redirect_stderr(messages):
            yield
    finally:
        for line in messages.getvalue().splitlines():
            print(printable(line), file=sys.stderr)


def _run(command: Command) -> None:
    """Run a command; print its lines, and last of all the warnings."""
    dry = getattr(command, "dry_run", False)
    if isinstance(command, SceneOptions | Demo) and not (dry or isinstance(command, Scan)):
        compute_in_calling_thread()  # a scan does in its workers
    if not getattr(command, "no_cache", False):
        enable_compilation_cache(cache_folder())
    own: list[str] = []
    raised: list[warnings.WarningMessage] = []
    try:
        with warnings.catch_warnings(record=True) as raised, contextlib.closing(Bars()) as bars:
            lines, own = _answer(command, Monitor(progress=bars))
        print(*map(printable, lines), sep="\n", flush=True)
    finally:
        if found := list(dict.fromkeys([*own, *_sentences(raised)])):
            count = f"{len(found)} warning{'s' if len(found) > 1 else ''}:"
            print(count, *map(printable, found), sep="\n  ", file=sys.stderr)


def _answer(command: Command, monitor: Monitor) -> tuple[list[str], list[str]]:
    """Lines for stdout, and warnings."""
    if type(command) is Locate and not command.dry_run:
        earlier = earlier_results(command.out)
        located = run_locate(command, monitor=monitor)
        replaced = [f"writes   {command.out}: has replaced {earlier}"] if earlier else []
        return [*summary(located.report, command.out), *replaced], located.result.warnings
    short = {Evaluate: run_evaluate, Verify: run_verify, Check: partial(run_check, say=_say)}
    if run := short.get(type(command)):
        return run(command)
    runs = {Demo: run_demo, Render: run_render, Tamper: run_tamper, Scan: run_scan, Locate: dry_run}
    runs |= {View: partial(run_view, say=_say)}
    return runs[type(command)](command, monitor=monitor)


def _sentences(raised: Sequence[warnings.WarningMessage]) -> Iterator[str]:
    """Warnings of Python, each with its origin if that is another package."""
    for warning in raised:
        text, path = " ".join(str(warning.message).split()), Path(warning.filename)
        own = path.is_relative_to(Path(gsc_jax.__file__).parent)
        origin = f" ({warning.category.__name__} in {path.name}, line {warning.lineno})"
        yield text if own and warning.category is UserWarning else text + origin


def _origin(command: Command | None, argv: Sequence[str], error: str) -> str:
    """Note that the path in an error comes from the file of --config, if it was not typed."""
    if not isinstance(command, Locate) or command.config is None:
        return ""
    paths = (str(path) for path in _paths(command) if path != command.config)
    if not any(error.startswith(path) for path in paths if path not in argv):
        return ""
    return f" (given in {command.config}, whose paths are relative to the current folder)"


def _is_given(error: OSError, command: Command | None) -> bool:
    """Whether an error is of a path that the options give, or of one in it."""
    if command is None or not isinstance(error.filename, str | bytes):
        return False
    place = Path(os.fsdecode(error.filename)).absolute()
    given = [path.absolute() for path in _paths(command) if path != getattr(command, "out", None)]
    return any(place.is_relative_to(path) for path in given)


def _paths(command: Command) -> list[Path]:
    given = [value if isinstance(value, tuple) else (value,) for value in vars(command).values()]
    return [value for values in given for value in values if isinstance(value, Path)]


def _say(line: str) -> None:
    print(printable(line), flush=True)


def _refuse(message: str) -> int:
    print(f"gsc-jax: {printable(' '.join(message.split()))}", file=sys.stderr)
    return 2
