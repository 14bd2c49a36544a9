"""Independent pieces of work side by side: simulations and sums run without the interpreter's lock.

Each is counted as work of its own, and what is left for the next is known only when those before it
are done: so many begin at once on every machine, however many threads it has.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextvars import copy_context
from typing import TypeVar

from residuum.identification.work import Work, begun, counted_as, go_on

MOST_THREADS = 4
"""Threads for pieces of work side by side."""
BEGUN_AT_ONCE = 8
"""Pieces of work that begin before it is asked again how much work is left, on every machine."""

T = TypeVar("T")
R = TypeVar("R")


def beside(function: Callable[[], R]) -> Callable[[], R]:
    """Begin a piece of work beside what follows; what is returned waits for it, and gives its
    result or raises its error.
    """
    part = begun().part()
    pool = ThreadPoolExecutor(1)
    # In a copy of the context, so that the words of a refusal are those of the door that asked.
    running = pool.submit(copy_context().run, _counted, part, function)
    pool.shutdown(wait=False)  # the thread ends with its piece; nothing else is given to it

    def result() -> R:
        try:
            return running.result()
        finally:
            begun().take(part)

    return result


def side_by_side(function: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """`function` of each item, in order; raises `OutOfWork` before the next item once a search's
    work is done.
    """

    def bounded(item: T) -> R:
        go_on()
        return function(item)

    return each_beside(bounded, items)


def each_beside(function: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """`function` of each item, in order, which looks itself whether work is left."""
    if len(items) < 2:
        return [function(item) for item in items]
    results: list[R] = []
    with ThreadPoolExecutor(min(MOST_THREADS, os.cpu_count() or 1, len(items))) as pool:
        for begin in range(0, len(items), BEGUN_AT_ONCE):
            whole, several = begun(), items[begin : begin + BEGUN_AT_ONCE]
            # Counts of their own, added in order below: no thread writes into another's.
            parts = [whole.part() for _ in several]
            running = [
                pool.submit(copy_context().run, _counted, part, lambda item=item: function(item))
                for part, item in zip(parts, several, strict=True)
            ]
            # an error is raised after all pieces of the batch are done, so that all are counted
            try:
                results += [future.result() for future in running]
            finally:
                for future, part in zip(running, parts, strict=True):
                    future.exception()  # waits
                    whole.take(part)
    return results


def _counted(part: Work, function: Callable[[], R]) -> R:
    with counted_as(part):
        return function()
