"""Reading and writing files: atomically, only regular files, and within a bound on the memory.

Each reader checks what a file needs before it allocates it.
"""

import contextlib
import hashlib
import math
import os
import uuid
from collections.abc import Iterator
from pathlib import Path

from gsc_jax.scene import InputError


@contextlib.contextmanager
def atomic(path: str | Path) -> Iterator[Path]:
    """Yield a temporary path in the same folder; rename it to `path` when the block succeeds.

    A run that is interrupted leaves the previous file or none, and a file may replace the one that
    it was read from. The temporary name keeps the suffix, by which some writers choose a format.
    Put only the writing into the block: any `OSError` in it is reported as an InputError of `path`.
    """
    path = Path(path)
    # Not longer than the name itself needs to be: file systems limit names to 255 bytes.
    temporary = path.with_name(f".{uuid.uuid4().hex[:12]}{path.suffix}")
    try:
        with writing_to(path):
            path.parent.mkdir(parents=True, exist_ok=True)
            yield temporary
            temporary.replace(path)
    finally:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)


@contextlib.contextmanager
def writing_to(place: Path) -> Iterator[None]:
    """Turn errors of the file system into an InputError that names a file or folder."""
    try:
        yield
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{place}: cannot be written ({reason}); choose another place") from error


def existing_file(path: str | Path, *, expected: str) -> Path:
    """Return the path if it is a file; else raise InputError with the kind of file `expected`.

    Every reader calls this before it opens a file: a pipe or a device could block it for ever.
    """
    path = Path(path)
    if path.is_dir():
        raise InputError(f"{path}: is a folder, expected {expected}; name the file in it")
    if not path.is_file() and path.exists():
        raise InputError(f"{path}: is a pipe or a device, expected {expected}; copy it to a file")
    if not path.is_file():
        raise InputError(f"{path}: no such file, expected {expected}; check the path")
    return path


def content_digest(path: Path) -> str:
    """SHA-256 of a file, or of the names and digests of all files of a folder."""
    if not path.is_dir():
        with path.open("rb") as stream:
            return hashlib.file_digest(stream, "sha256").hexdigest()
    inside = sorted(place for place in path.rglob("*") if place.is_file())
    lines = [f"{place.relative_to(path).as_posix()} {content_digest(place)}" for place in inside]
    return hashlib.sha256("\n".join(lines).encode("utf-8", "surrogateescape")).hexdigest()


def content_bytes(path: Path) -> int:
    """Size of a file, or of all files of a folder."""
    inside = path.rglob("*") if path.is_dir() else [path]
    return sum(place.stat().st_size for place in inside if place.is_file())


GIB = 2**30
UNKNOWN_MEMORY_BYTES = 8 * GIB
"""Assumed memory of a machine that does not tell: that of a small laptop."""
CGROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")


def memory_limit(gib: float | None = None) -> int:
    """Bytes that a run may allocate: `gib` GiB, by default half of the memory of the machine.

    Raises InputError if it is not a positive number.
    """
    if gib is not None and not (math.isfinite(gib * GIB) and gib > 0):
        raise InputError(f"--memory {gib:g}: expected a positive number of GiB")
    if gib is not None:
        return int(gib * GIB)
    try:
        machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # not on Windows
        machine = UNKNOWN_MEMORY_BYTES
    with contextlib.suppress(OSError, ValueError):  # no container, or the limit "max"
        machine = min(machine, int(CGROUP_LIMIT.read_text("ascii")))
    return machine // 2


def check_allocation(path: str | Path, needed: int, limit: int | None) -> None:
    """Raise InputError if reading a file needs more bytes than `limit`, or `memory_limit()`."""
    limit = memory_limit() if limit is None else limit
    if needed > limit:
        raise InputError(
            f"{path}: takes {needed / GIB:.3g} GiB of memory to read, expected at most "
            f"{limit / GIB:.3g} GiB; if the file is not damaged, allow more with --memory"
        )
