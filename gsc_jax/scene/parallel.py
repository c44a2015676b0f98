"""Apply a function to views in threads or to rows in blocks, with a bound on memory.

NumPy and XLA release the interpreter lock while they compute, so two threads use two cores.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from itertools import cycle
from typing import TypeVar

import jax
import numpy as np

Item = TypeVar("Item")
Value = TypeVar("Value")

WORKERS = 2
"""Threads for a device: more of them only cost memory, since XLA has its own threads."""
BLOCK = 2**18
"""Rows per call of `in_blocks`: their intermediate results take a few hundred megabytes at most."""


def view_threads() -> ThreadPoolExecutor:
    """Threads for views, which are independent; each thread computes on the next device of JAX."""
    devices = cycle(jax.local_devices())

    def start() -> None:
        if jax.local_device_count() > 1:  # with one, programs are shared with the main thread
            jax.default_device(next(devices)).__enter__()  # it ends with the thread

    return ThreadPoolExecutor(WORKERS * jax.local_device_count(), initializer=start)


def bounded_map(
    pool: Executor, function: Callable[[Item], Value], items: Iterable[Item]
) -> Iterator[Value]:
    """Map in the threads of a pool, in order, with at most `WORKERS` items a device in flight."""
    waiting: deque[Future[Value]] = deque()
    for item in items:
        waiting.append(pool.submit(function, item))
        if len(waiting) == WORKERS * jax.local_device_count():
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()


def in_blocks(function: Callable[[np.ndarray], np.ndarray], rows: np.ndarray) -> np.ndarray:
    """Apply a function of each row on its own to blocks of rows, and concatenate the results."""
    return np.concatenate([function(rows[block]) for block in blocks(max(len(rows), 1))])


def blocks(count: int, size: int = BLOCK) -> list[slice]:
    """Slices of at most `size` that cover `count` rows."""
    return [slice(start, start + size) for start in range(0, count, size)]
