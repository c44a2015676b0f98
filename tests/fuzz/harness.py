"""Runs damaged inputs through a reader in a child process with bounds on memory and time.

Input i of a format is a function of the format, a seed and i. Each must give a valid object, or an
`InputError` that names the file. Anything else is a finding: another exception, more than
`MAX_SECONDS` or `MAX_BYTES`, or the end of the process; then a new one goes on behind that input.
"""

import dataclasses
import enum
import multiprocessing
import resource
import shutil
import signal
import tempfile
import time
import traceback
import warnings
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection
from pathlib import Path
from random import Random
from typing import Any

from gsc_jax.scene import InputError

MAX_SECONDS, KILL_SECONDS = 5, 60
"""Time of the processor for an input, so that other work on the machine does not count, and time
until a process that does not react is killed."""
MAX_BYTES = 2**30
"""Memory above that of the process after it has read the undamaged inputs."""
READER_BYTES = MAX_BYTES // 2
"""Memory that the readers may allocate."""
MAX_MESSAGE = 2000
"""Characters of a message: several paths of up to 255 characters fit."""
MAX_FINDINGS = 50
"""Findings of a format after which no process is started again."""
START_SECONDS = 120
SHARED_MEMORY = Path("/dev/shm")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Format:
    """A format of input; its functions lie in modules, so that a child process can import them.

    Attributes:
        make: Writes an input into an empty folder and returns its path, undamaged for None.
        read: Reads an input; raises AssertionError if the result is not valid.
    """

    name: str
    make: Callable[[Random | None, Path], Path]
    read: Callable[[Path], Any]


@dataclasses.dataclass
class Tally:
    """What became of the inputs of a format; the unit of `peak` is bytes."""

    format: str
    inputs: int = 0
    accepted: int = 0
    refused: int = 0
    slowest: float = 0
    peak: int = 0
    findings: list[str] = dataclasses.field(default_factory=list)

    def add(self, state: Sequence[float]) -> None:
        """Add the numbers of a child process."""
        self.accepted += int(state[State.ACCEPTED])
        self.refused += int(state[State.REFUSED])
        self.slowest = max(self.slowest, state[State.SLOWEST])
        self.peak = max(self.peak, int(state[State.PEAK]))


class Hang(BaseException):
    """An input took too long; no reader catches it."""


class State(enum.IntEnum):
    """Shared numbers by which a child tells where it is, even if it dies there."""

    FORMAT, INDEX, STARTED, ACCEPTED, REFUSED, SLOWEST, PEAK = range(7)


def fuzz(formats: Sequence[Format], seed: int, inputs: int, findings: Path) -> list[Tally]:
    """Try a share of the inputs for each format; findings are saved in a folder each."""
    share, rest = divmod(inputs, len(formats))
    tallies = [Tally(kind.name, share + (i < rest)) for i, kind in enumerate(formats)]
    position, index = 0, 0
    while position < len(formats):
        # Not in the child, which may end without removing it.
        with tempfile.TemporaryDirectory(
            dir=SHARED_MEMORY if SHARED_MEMORY.is_dir() else None
        ) as d:
            start = position, index
            position, index = _run_child(formats, seed, start, tallies, (findings, Path(d)))
        if position < len(formats) and len(tallies[position].findings) >= MAX_FINDINGS:
            tallies[position].inputs = index
            position, index = position + 1, 0
    return tallies


def _run_child(
    formats: Sequence[Format],
    seed: int,
    start: tuple[int, int],
    tallies: list[Tally],
    folders: tuple[Path, Path],
) -> tuple[int, int]:
    """Try inputs until the end, or until the process ends; return the place of the next one.

    The folders are those of the findings and of temporary files.
    """
    findings, place = folders
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    state = context.Array("d", len(State), lock=False)
    counts = [tally.inputs for tally in tallies]
    process = context.Process(
        target=_child, args=(formats, seed, counts, start, place, sender, state)
    )
    process.start()
    sender.close()
    last, since, reason = [-1.0], time.monotonic(), "the process ended"
    while True:
        if receiver.poll(0.2):
            try:
                position, index, problem = receiver.recv()
            except EOFError:
                break
            if isinstance(problem, str):
                found = _save(formats[position], seed, index, problem, findings)
                tallies[position].findings.append(found)
            else:
                tallies[position].add(problem)
        elif state[: State.ACCEPTED] != last:
            last, since = state[: State.ACCEPTED], time.monotonic()
        elif time.monotonic() - since > (KILL_SECONDS if state[State.STARTED] else START_SECONDS):
            reason = f"no answer within {KILL_SECONDS} s"
            process.kill()
    process.join()
    if process.exitcode == 0:
        return len(formats), 0
    position, index = int(state[State.FORMAT]), int(state[State.INDEX])
    if not state[State.STARTED]:
        raise RuntimeError(f"{formats[position].name}: the undamaged inputs could not be read")
    tallies[position].add(list(state))
    reason = f"{reason} (exit code {process.exitcode})"
    tallies[position].findings.append(_save(formats[position], seed, index, reason, findings))
    return position, index + 1


def _save(kind: Format, seed: int, index: int, reason: str, findings: Path) -> str:
    """Write an input, and what was found when it was read, into a folder of its own."""
    folder = findings / f"{kind.name}-{seed}-{index}"
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    kind.make(input_rng(kind, seed, index), folder)
    (folder / "finding.txt").write_text(reason + "\n", encoding="utf-8", errors="replace")
    return f"{folder}: {reason.strip().splitlines()[-1][:200]}"


def input_rng(kind: Format, seed: int, index: int) -> Random:
    """The random numbers of which an input is a function."""
    return Random(f"{kind.name} {seed} {index}")


def _child(
    formats: Sequence[Format],
    seed: int,
    counts: Sequence[int],
    start: tuple[int, int],
    place: Path,
    sender: Connection,
    state: Any,
) -> None:
    """Send the problem of every finding, and the state at the end of each format."""
    warnings.simplefilter("ignore")
    warnings.simplefilter("error", RuntimeWarning)  # users would see them
    signal.signal(signal.SIGPROF, _raise_hang)
    for position in range(start[0], len(formats)):
        first = start[1] if position == start[0] else 0
        state[:] = [position, first, 0, 0, 0, 0, 0]
        kind = formats[position]
        before = _warm_up(kind, place / "warm")
        state[State.STARTED] = 1
        for index in range(first, counts[position]):
            state[State.INDEX] = index
            if problem := _try(kind, input_rng(kind, seed, index), place / "input", state):
                sender.send((position, index, problem))
        state[State.PEAK] = _peak_bytes() - before
        sender.send((position, 0, list(state)))


def _try(kind: Format, rng: Random, folder: Path, state: Any) -> str:
    """Make and read an input; return what is wrong, empty if nothing is."""
    folder.mkdir()
    path = kind.make(rng, folder)
    began = time.process_time()
    signal.setitimer(signal.ITIMER_PROF, MAX_SECONDS)
    try:
        problem = _problem(kind, path, state)
    finally:
        left, _ = signal.setitimer(signal.ITIMER_PROF, 0)
    seconds = max(time.process_time() - began, MAX_SECONDS - left)  # a busy machine: timer ahead
    state[State.SLOWEST] = max(state[State.SLOWEST], seconds)
    shutil.rmtree(folder)
    return problem


def _warm_up(kind: Format, folder: Path) -> int:
    """Import and compile what the reader needs, and bound the memory; return the present one.

    The undamaged inputs must be accepted.
    """
    _, hard = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (hard, hard))
    for _ in range(2):
        folder.mkdir()
        kind.read(kind.make(None, folder))
        shutil.rmtree(folder)
    pages = int(Path("/proc/self/statm").read_text("ascii").split()[0])
    limit = pages * resource.getpagesize() + MAX_BYTES
    resource.setrlimit(resource.RLIMIT_AS, (limit, hard))
    Path("/proc/self/clear_refs").write_text("5", "ascii")  # resets the peak
    return _peak_bytes()


def _problem(kind: Format, path: Path, state: Any) -> str:
    """What is wrong with reading an input; empty if nothing is."""
    try:
        kind.read(path)
        state[State.ACCEPTED] += 1
    except InputError as error:
        message = str(error)
        if str(path) not in message and str(path.parent) not in message:
            return f"the message does not name the file: {message[:MAX_MESSAGE]}"
        if len(message) > MAX_MESSAGE:
            return f"a message of {len(message)} characters: {message[:MAX_MESSAGE]}"
        state[State.REFUSED] += 1
    except (Exception, Hang):
        return traceback.format_exc()
    return ""


def _raise_hang(*_: object) -> None:
    raise Hang(f"more than {MAX_SECONDS} s")


def _peak_bytes() -> int:
    """Largest resident memory since the last reset."""
    status = Path("/proc/self/status").read_text("ascii")
    return int(status.partition("VmHWM:")[2].split()[0]) * 1024


def table(tallies: list[Tally]) -> str:
    """The tallies as lines of a table, with their sum."""
    counts = ("inputs", "accepted", "refused")
    total = Tally("all")
    for name in counts:
        setattr(total, name, sum(getattr(tally, name) for tally in tallies))
    total.slowest = max(tally.slowest for tally in tallies)
    total.peak = max(tally.peak for tally in tallies)
    total.findings = [finding for tally in tallies for finding in tally.findings]
    header = ("format", "inputs", "accepted", "refused", "findings", "slowest ms", "peak MiB")
    width = max(len(tally.format) for tally in tallies) + 2
    lines = [f"{header[0]:<{width}}" + "".join(f"{title:>12}" for title in header[1:])]
    for tally in (*tallies, total):
        cells = [f"{getattr(tally, name):,}" for name in counts]
        cells += [str(len(tally.findings)), f"{1000 * tally.slowest:.0f}", f"{tally.peak >> 20}"]
        lines.append(f"{tally.format:<{width}}" + "".join(f"{cell:>12}" for cell in cells))
    return "\n".join(lines)
