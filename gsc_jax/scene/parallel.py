"""Apply a function to views in threads or to rows in blocks, with a bound on memory."""

import contextlib
import os
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from itertools import cycle
from pathlib import Path
from typing import TypeVar

import jax
import numpy as np

Item = TypeVar("Item")
Value = TypeVar("Value")

BLOCK = 2**16
"""Rows per block: their intermediate results take a hundred megabytes at most."""
LARGE = 2**20
"""Gaussians from which two views at a time use enough memory: up to 180 bytes of each Gaussian."""


def usable_cores() -> list[int]:
    """The cores that this process may use; all of the machine where the system does not tell."""
    affinity = getattr(os, "sched_getaffinity", None)  # not on macOS and Windows
    return sorted(affinity(0)) if affinity else list(range(os.cpu_count() or 1))


def workers() -> int:
    """Threads for rows: at most two, since each holds the intermediate results of a block."""
    return min(2, len(usable_cores()))


def compute_in_calling_thread() -> None:
    """Make JAX compute on the CPU in the thread that calls it, and XLA use no other threads.

    XLA divides even small steps among all cores and waits for them, which costs more than it gains
    where views have a thread for each core. For programs, not for libraries: call it before JAX
    computes. It does nothing on systems other than Linux.
    """
    if sys.platform != "linux":
        return
    jax.config.update("jax_cpu_enable_async_dispatch", False)
    cores, tasks = os.sched_getaffinity(0), Path("/proc/self/task")
    before = set(tasks.iterdir())
    os.sched_setaffinity(0, {min(cores)})  # XLA starts as many threads
    try:
        jax.devices()
    finally:
        os.sched_setaffinity(0, cores)
        for started in set(tasks.iterdir()) - before:
            with contextlib.suppress(ProcessLookupError):  # it has ended
                os.sched_setaffinity(int(started.name), cores)


class ViewThreads(ThreadPoolExecutor):
    """Threads for views of N Gaussians, each of which computes on the next device of JAX.

    There is one for each core, at most eight for each device, and two in scenes that are `LARGE`.
    """

    def __init__(self, gaussians: int = 0) -> None:
        devices = jax.local_devices()
        most = (2 if gaussians > LARGE else 8) * len(devices)
        turn, self.count = cycle(devices), max(len(devices), min(most, len(usable_cores())))

        def start() -> None:
            if len(devices) > 1:  # with one, programs are shared with the main thread
                jax.default_device(next(turn)).__enter__()  # it ends with the thread

        super().__init__(self.count, initializer=start)


def bounded_map(
    pool: ViewThreads, function: Callable[[Item], Value], items: Iterable[Item]
) -> Iterator[Value]:
    """Map in threads, in order; per call, at most one item for each thread is in flight."""
    waiting: deque[Future[Value]] = deque()
    for item in items:
        waiting.append(pool.submit(function, item))
        if len(waiting) == pool.count:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


def map_views(
    function: Callable[[Item], Value], views: Iterable[Item], *, gaussians: int = 0
) -> Iterator[Value]:
    """Map views of N Gaussians, in order, in threads of their own."""
    with ViewThreads(gaussians) as pool:
        yield from bounded_map(pool, function, views)


def in_blocks(function: Callable[[np.ndarray], np.ndarray], rows: np.ndarray) -> np.ndarray:
    """Apply a function of each row on its own to blocks of rows, and concatenate the results."""
    with ThreadPoolExecutor(workers()) as pool:
        parts = pool.map(lambda block: function(rows[block]), blocks(max(len(rows), 1)))
        return np.concatenate(list(parts))


def blocks(count: int, size: int = BLOCK) -> list[slice]:
    """Slices of at most `size` that cover `count` rows."""
    return [slice(start, start + size) for start in range(0, count, size)]
