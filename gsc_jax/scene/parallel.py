"""Views are independent: a few are worked on at once, in threads, without holding them all.

NumPy and XLA release the interpreter while they compute, so two threads use two cores.
"""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from typing import TypeVar

Item = TypeVar("Item")
Value = TypeVar("Value")

WORKERS = 2
"""Threads, and how many items are on their way; more only cost memory, XLA has its own threads."""


def ahead(
    pool: Executor, function: Callable[[Item], Value], items: Iterable[Item]
) -> Iterator[Value]:
    """`map` in the threads of a pool, in order, a bounded number of items ahead.

    Args:
        pool: Where the function runs.
        function: Of one item.
        items: Taken as they are needed.

    Yields:
        The values, in the order of the items.
    """
    waiting: deque[Future[Value]] = deque()
    for item in items:
        waiting.append(pool.submit(function, item))
        if len(waiting) == WORKERS:
            yield waiting.popleft().result()
    while waiting:
        yield waiting.popleft().result()
