"""Independent pieces of work side by side: simulations and sums run without the interpreter's lock."""

from __future__ import annotations

import os
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

T = TypeVar("T")
R = TypeVar("R")
_THREADS = min(4, os.cpu_count() or 1)


def beside(function: Callable[[], R]) -> Callable[[], R]:
    """Begin a piece of work beside what follows; what is returned waits for it, and gives its result or raises its error."""
    pool = ThreadPoolExecutor(1)
    work = pool.submit(function)
    pool.shutdown(wait=False)
    return work.result


def side_by_side(function: Callable[[T], R], items: Sequence[T]) -> list[R]:
    """`function` of each item, in order."""
    if len(items) < 2:
        return [function(item) for item in items]
    with ThreadPoolExecutor(min(_THREADS, len(items))) as pool:
        return list(pool.map(function, items))
