"""Apply a function to views in threads or to rows in blocks, with a bound on memory."""

import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from itertools import cycle
from typing import TypeVar

import jax
import numpy as np

Item = TypeVar("Item")
Value = TypeVar("Value")

BLOCK = 2**16
"""Rows per block: their intermediate results take a hundred megabytes at most."""


def usable_cores() -> list[int]:
    """The cores that this process may use; all of the machine where the system does not tell."""
    affinity = getattr(os, "sched_getaffinity", None)  # not on macOS and Windows
    return sorted(affinity(0)) if affinity else list(range(os.cpu_count() or 1))


def workers(devices: int = 1) -> int:
    """Threads: one for each core, since NumPy and XLA use few at once, at most eight a device."""
    return max(devices, min(8 * devices, len(usable_cores())))


def view_threads() -> ThreadPoolExecutor:
    """Threads for views, which are independent; each thread computes on the next device of JAX."""
    devices = cycle(jax.local_devices())

    def start() -> None:
        if jax.local_device_count() > 1:  # with one, programs are shared with the main thread
            jax.default_device(next(devices)).__enter__()  # it ends with the thread

    return ThreadPoolExecutor(workers(jax.local_device_count()), initializer=start)


def bounded_map(
    pool: Executor, function: Callable[[Item], Value], items: Iterable[Item]
) -> Iterator[Value]:
    """Map in the threads of a pool, in order, with at most one item for each of `workers`."""
    most = workers(jax.local_device_count())
    waiting: deque[Future[Value]] = deque()
    for item in items:
        waiting.append(pool.submit(function, item))
        if len(waiting) == most:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


def in_blocks(function: Callable[[np.ndarray], np.ndarray], rows: np.ndarray) -> np.ndarray:
    """Apply a function of each row on its own to blocks of rows, and concatenate the results."""
    with ThreadPoolExecutor(workers()) as pool:
        parts = pool.map(lambda block: function(rows[block]), blocks(max(len(rows), 1)))
        return np.concatenate(list(parts))


def blocks(count: int, size: int = BLOCK) -> list[slice]:
    """Slices of at most `size` that cover `count` rows."""
    return [slice(start, start + size) for start in range(0, count, size)]
