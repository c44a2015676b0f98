"""Evidence larger than memory: arrays in an unnamed temporary file."""

import os
import tempfile

import numpy as np

from gsc_jax.evidence.lifting import Evidence
from gsc_jax.scene import InputError

IN_MEMORY = 2**30
"""Bytes of evidence that are kept in memory."""


def blank_evidence(views: int, count: int, *, in_memory: int = IN_MEMORY) -> Evidence:
    """Evidence of zeros, on the host, to be filled view by view.

    The optimisation reads one view at a time but returns to it, so all of it has to be somewhere:
    what is large goes into a file that has no name and vanishes with the arrays, where the system
    keeps as much of it in memory as it can spare.

    Args:
        views: Number of views V.
        count: Number of Gaussians N.
        in_memory: Bytes up to which plain arrays are taken.

    Returns:
        NumPy arrays, shapes (V, N); in the folder of temporary files where they are larger, which
        should not be one in memory (TMPDIR names another).

    Raises:
        InputError: if that folder has no room for them.
    """
    if 8 * views * count <= in_memory:
        total, tampered = np.zeros((2, views, count), np.float32)
        return Evidence(total=total, tampered=tampered)
    with tempfile.TemporaryFile() as file:
        _reserve(file.fileno(), 8 * views * count)
        both = np.memmap(file, np.float32, "r+", shape=(2, views, count))
    return Evidence(total=both[0], tampered=both[1])


def _reserve(file: int, size: int) -> None:
    """Take the space of a file now: a full disk would kill the process when a page is written."""
    try:
        if hasattr(os, "posix_fallocate"):
            os.posix_fallocate(file, 0, size)
        else:
            os.ftruncate(file, size)
    except OSError as error:
        raise InputError(
            f"{tempfile.gettempdir()}: no room for {size / 2**30:.1f} GiB of evidence "
            f"({error.strerror}); make room, set TMPDIR to another folder, or use fewer views"
        ) from error
