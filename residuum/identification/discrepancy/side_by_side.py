"""Independent pieces of work side by side: simulations and sums run without the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

from residuum.identification.discrepancy.deadline import in_time
from residuum.identification.discrepancy.policy.trials import MOST_THREADS

T = TypeVar("T")
R = TypeVar("R")


def beside(function: Callable[[], R]) -> Callable[[], R]:
    """Begin a piece of work beside what follows; what is returned waits for it, and gives its result or raises its error."""
    pool = ThreadPoolExecutor(1)
    work = pool.submit(copy_context().run, function)
    pool.shutdown(wait=False)
    return work.result


def side_by_side(function: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """`function` of each item, in order; raises `OutOfTime` before the next item once a search's time is over."""

    def timed(item: T) -> R:
        in_time()
        return function(item)

    return each_beside(timed, items)


def each_beside(function: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """`function` of each item, in order, which looks after the time itself."""
    if len(items) < 2:
        return [function(item) for item in items]
    with ThreadPoolExecutor(min(MOST_THREADS, os.cpu_count() or 1, len(items))) as pool:
        contexts = [copy_context() for _ in items]
        return list(pool.map(lambda context, item: context.run(function, item), contexts, items))
