"""Apply a function to views in threads, with a bounded number of results in memory.

NumPy and XLA release the interpreter lock while they compute, so two threads use two cores.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from typing import TypeVar

Item = TypeVar("Item")
Value = TypeVar("Value")

WORKERS = 2
"""Threads, and items in flight: more of them only cost memory, since XLA has its own threads."""


def bounded_map(
    pool: Executor, function: Callable[[Item], Value], items: Iterable[Item]
) -> Iterator[Value]:
    """Map in the threads of a pool, in order, with at most `WORKERS` items in flight."""
    waiting: deque[Future[Value]] = deque()
    for item in items:
        waiting.append(pool.submit(function, item))
        if len(waiting) == WORKERS:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()
