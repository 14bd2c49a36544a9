"""A search's time: whoever computes long asks now and then whether it is over."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

_ends: ContextVar[float | None] = ContextVar("search ends", default=None)


class OutOfTime(Exception):
    """The time that a search was given is over; what it found so far is lost."""


@contextmanager
def within(seconds: float | None) -> Iterator[None]:
    """What is computed inside raises `OutOfTime` once so many seconds have passed; None sets no limit of its own.

    >>> with within(60.0):
    ...     in_time()
    """
    if seconds is None:
        yield
        return
    outer, ends = _ends.get(), time.perf_counter() + max(seconds, 0.0)
    token = _ends.set(ends if outer is None else min(outer, ends))
    try:
        yield
    finally:
        _ends.reset(token)


def in_time() -> None:
    """Raise `OutOfTime` where the time is over."""
    ends = _ends.get()
    if ends is not None and time.perf_counter() > ends:
        raise OutOfTime
