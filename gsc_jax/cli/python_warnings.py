"""Warnings that libraries raise during a run: kept for its end, instead of between the bars."""

import contextlib
import warnings
from collections.abc import Iterator
from pathlib import Path

import gsc_jax

OWN = Path(gsc_jax.__file__).parent


@contextlib.contextmanager
def caught() -> Iterator[list[str]]:
    """Collects Python's warnings.

    Which of them count is a matter of Python's filters (-W, PYTHONWARNINGS), as ever.

    Yields:
        A list that is filled when the block ends, however it does: each warning once, in a line,
        with the place that it comes from where that is not this package.
    """
    said: list[str] = []
    with warnings.catch_warnings(record=True) as found:
        try:
            yield said
        finally:
            said += dict.fromkeys(_told(warning) for warning in found)


def _told(warning: warnings.WarningMessage) -> str:
    text, place = " ".join(str(warning.message).split()), Path(warning.filename)
    if warning.category is UserWarning and place.is_relative_to(OWN):
        return text
    return f"{text} ({warning.category.__name__} in {place.name}, line {warning.lineno})"
