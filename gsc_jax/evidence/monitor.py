"""Seconds and peak memory of each stage of a run, for the report."""

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator

Progress = Callable[[str, int, int], None]
"""Told (stage, done, total) as a run proceeds; the command line draws bars with it."""


def silent(stage: str, done: int, total: int) -> None:
    """Progress for nobody."""
    del stage, done, total


class Stages:
    """Collects how long each stage took and the memory peak of the process when it ended.

    Stages that run in several threads overlap: their seconds then add up to more than has passed.
    """

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}
        self.peak_mib: dict[str, float] = {}
        self._lock = threading.Lock()
        self._begin = time.perf_counter()

    @contextlib.contextmanager
    def __call__(self, name: str) -> Iterator[None]:
        """Time a block as part of a stage; blocks of one name add up."""
        begin = time.perf_counter()
        try:
            yield
        finally:
            elapsed = time.perf_counter() - begin
            with self._lock:
                self.seconds[name] = self.seconds.get(name, 0.0) + elapsed
                self.peak_mib[name] = peak_memory_mib()

    def elapsed(self) -> float:
        """Wall time since the beginning, in seconds."""
        return time.perf_counter() - self._begin

    def summary(self) -> dict[str, dict[str, float]]:
        """Seconds and peak MiB by stage, in the order of their first block."""
        return {
            name: {"seconds": round(seconds, 4), "peak_mib": round(self.peak_mib[name], 1)}
            for name, seconds in self.seconds.items()
        }


def peak_memory_mib() -> float:
    """Largest resident memory of this process so far, in MiB; NaN where the system cannot tell."""
    try:
        import resource
    except ImportError:  # Windows
        return float("nan")
    unit = 2**20 if sys.platform == "darwin" else 2**10
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / unit
