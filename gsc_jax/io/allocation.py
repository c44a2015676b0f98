"""The bound on the memory of readers: each checks what a file needs before it allocates it."""

import math
import os
from pathlib import Path

from gsc_jax.scene import InputError

GIB = 2**30
UNKNOWN_MEMORY_BYTES = 8 * GIB
"""Assumed memory of a machine that does not tell: that of a small laptop."""
CGROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")


def memory_limit(gib: float | None = None) -> int:
    """Bytes that a run may allocate: `gib` GiB, by default half of the memory of the machine.

    Raises InputError if it is not a positive number.
    """
    if gib is not None and not (math.isfinite(gib) and gib > 0):
        raise InputError(f"--memory {gib:g}: expected a positive number of GiB")
    return _machine_bytes() // 2 if gib is None else int(gib * GIB)


def check_allocation(path: str | Path, needed: int, limit: int | None) -> None:
    """Raise InputError if reading a file needs more bytes than `limit`, or `memory_limit()`."""
    limit = memory_limit() if limit is None else limit
    if needed > limit:
        raise InputError(
            f"{path}: takes {needed / GIB:.3g} GiB of memory to read, expected at most "
            f"{limit / GIB:.3g} GiB; if the file is not damaged, allow more with --memory"
        )


def _machine_bytes() -> int:
    """Memory of the machine, or of the container in which the process runs."""
    try:
        machine = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    except (AttributeError, OSError, ValueError):  # not on Windows
        machine = UNKNOWN_MEMORY_BYTES
    try:
        return min(machine, int(CGROUP_LIMIT.read_text("ascii")))
    except (OSError, ValueError):  # no container, or the limit "max"
        return machine
