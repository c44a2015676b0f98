"""Readers with planted faults, which the harness must report, and one without."""

import os
import time
from pathlib import Path
from random import Random

import numpy as np
from fuzz.harness import Format

from gsc_jax.scene import InputError

CONTENTS, PLANTED = 4, 3
"""Number of different inputs, each of one byte, and the one that reaches the fault."""


def make(rng: Random | None, folder: Path) -> Path:
    path = folder / "input.bin"
    path.write_bytes(bytes([0 if rng is None else rng.randrange(CONTENTS)]))
    return path


def planted(path: Path) -> bool:
    return path.read_bytes()[0] == PLANTED


def read_well(path: Path) -> None:
    if planted(path):
        raise InputError(f"{path}: refused")


def read_with_traceback(path: Path) -> None:
    if planted(path):
        raise KeyError("planted")


def read_anonymously(path: Path) -> None:
    if planted(path):
        raise InputError("something is wrong")


def read_to_nan(path: Path) -> None:
    value = np.float32("nan") if planted(path) else np.float32(1)
    assert np.isfinite(value)


def read_forever(path: Path) -> None:
    while planted(path):
        pass


def read_and_die(path: Path) -> None:
    if planted(path):
        os._exit(11)


def read_too_much(path: Path) -> None:
    if planted(path):
        np.ones(3 * 2**28)  # 6 GiB


def read_and_sleep(path: Path) -> None:
    if planted(path):
        time.sleep(60)  # takes no time of the processor


SLEEPER = Format(name="read_and_sleep", make=make, read=read_and_sleep)
FORMATS = {
    read.__name__: Format(name=read.__name__, make=make, read=read)
    for read in (
        *(read_well, read_with_traceback, read_anonymously, read_to_nan),
        *(read_forever, read_and_die, read_too_much),
    )
}
