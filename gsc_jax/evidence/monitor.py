"""Time, peak memory and progress of a run, in one object that is passed once."""

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

Item = TypeVar("Item")

Progress = Callable[[str, int, int], None]
"""Called with (stage, done, total) as a run proceeds; the command line draws bars with it."""


class Monitor:
    """Collect seconds and peak memory of each stage, and pass progress on.

    Stages that run in threads overlap: their seconds then add up to more than the wall time.

    Args:
        progress: Called with (stage, done, total); None ignores progress.
    """

    def __init__(self, *, progress: Progress | None = None) -> None:
        self.seconds: dict[str, float] = {}
        self.peak_mib: dict[str, float] = {}
        self._progress = progress
        self._expected: dict[str, int] = {}
        self._lock = threading.Lock()
        self._start = time.perf_counter()

    @contextlib.contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Time a block as part of a stage; the seconds of blocks with one name are added."""
        start = time.perf_counter()
        try:
            yield
        finally:
            elapsed = time.perf_counter() - start
            with self._lock:
                self.seconds[name] = self.seconds.get(name, 0.0) + elapsed
                self.peak_mib[name] = peak_memory_mib()

    def progress(self, stage: str, done: int, total: int) -> None:
        """Report that `done` of `total` items of a stage are finished."""
        if self._progress is not None:
            self._progress(stage, done, self._expected.get(stage, total))

    def track(self, stage: str, items: Iterable[Item], total: int, done: int = 0) -> Iterator[Item]:
        """Yield the items of a stage, of which `done` are finished, and report the progress."""
        self.progress(stage, done, total)  # shown before a slow first item ends
        for count, item in enumerate(items, start=done + 1):
            yield item
            self.progress(stage, count, total)

    def expect(self, stage: str, total: int) -> None:
        """Report the progress of a stage from now on as the first part of `total` items."""
        self._expected[stage] = total

    def elapsed(self) -> float:
        """Wall time since this monitor was made, in seconds."""
        return time.perf_counter() - self._start

    def summary(self) -> dict[str, dict[str, float]]:
        """Seconds and peak MiB by stage, in the order in which the stages first ended."""
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
