"""The error for bad input, and the ranges of numbers."""

from collections.abc import Mapping
from typing import Any

import numpy as np

BELOW_1 = float(np.nextafter(1, 0))
"""Largest number below 1, the upper bound of a threshold."""


class InputError(ValueError):
    """Bad input; its one-line message names the file, what was expected, found, and what to do."""


def in_range(value: Any, least: float, most: float) -> bool:
    """Whether a value is a number, no bool, in a closed range: a whole one if `least` is an int."""
    kinds = (int, np.integer) if isinstance(least, int) else (int, float, np.number)
    number = isinstance(value, kinds) and not isinstance(value, bool)
    return number and bool(least <= value <= most)


def check_ranges(owner: Any, ranges: Mapping[str, tuple[float, float]]) -> None:
    """Raise ValueError if a field is no number in its closed range, as by `in_range`."""
    for name, (least, most) in ranges.items():
        if not in_range(value := getattr(owner, name), least, most):
            kind = "a whole number " if isinstance(least, int) else ""
            bounds = f"[{least:g}, 1)" if most == BELOW_1 else f"[{least:g}, {most:g}]"
            raise ValueError(f"{name} must be {kind}in {bounds}, got {value!r}")
