"""Evidence that is larger than memory: arrays in an unnamed temporary file."""

import os
import tempfile

import numpy as np

from gsc_jax.evidence.lifting import Evidence
from gsc_jax.scene import InputError

MAX_BYTES_IN_MEMORY = 2**30
"""Evidence up to this size is kept in memory: a small part of the memory of today's machines."""


def blank_evidence(
    views: int, count: int, *, max_bytes_in_memory: int = MAX_BYTES_IN_MEMORY
) -> Evidence:
    """Allocate evidence on the host, to be filled view by view.

    The optimisation reads one view at a time but comes back to it, so all of it has to be stored.
    Larger evidence goes to a memory-mapped file without a name, which disappears with the arrays;
    the operating system keeps as much of it in memory as it can spare.

    Args:
        views: Number of views V.
        count: Number of Gaussians N.
        max_bytes_in_memory: Size above which a file is used.

    Returns:
        NumPy arrays of zeros, shapes (V, N). The file lies in the folder of temporary files (TMPDIR
        selects another one), which should not itself be in memory.

    Raises:
        InputError: if that folder has too little space.
    """
    size = 8 * views * count
    if size <= max_bytes_in_memory:
        total, tampered = np.zeros((2, views, count), np.float32)
        return Evidence(total=total, tampered=tampered)
    with tempfile.TemporaryFile() as file:
        _reserve(file.fileno(), size)
        both = np.memmap(file, np.float32, "r+", shape=(2, views, count))
    return Evidence(total=both[0], tampered=both[1])


def _reserve(file: int, size: int) -> None:
    """Allocate the disk space now: later, a full disk would kill the process by a signal."""
    try:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file, 0, size)
        else:
            os.ftruncate(file, size)
    except OSError as error:
        raise InputError(
            f"{tempfile.gettempdir()}: no space for {size / 2**30:.1f} GiB of evidence "
            f"({error.strerror}); free some, set TMPDIR to another folder, or use fewer views"
        ) from error
