"""Counted work: how much a search has computed, and when it has had its share.

A search whose end depends on the clock answers one record in two ways, on an idle machine and on a
busy one. So work is bounded by counting it: a *sample* is one integration step of a simulation, and
one more for each value that it is differentiated by; a *fit* costs some samples besides. Pieces of
work that run side by side are counted each for itself and added in order, so that the count, and
what is cut by it, depends on nothing but the data.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field

FIT_COST = 300_000
"""[samples] What an estimation costs besides what it simulates: proposals, linear algebra,
bookkeeping. Measured, roughly.
"""


Tell = Callable[[float, str], None]
"""Told how far the work is: share done 0 … 1, and what is done now."""


def part_of(tell: Tell, begin: float, end: float) -> Tell:
    """Tells how far a part is of the work that `tell` tells of: the part from `begin` to `end`,
    shares of the whole.

    >>> part_of(lambda share, doing: print(round(share, 3), doing), 0.5, 0.9)(0.25, "fitting")
    0.6 fitting
    """
    return lambda share, doing: tell(begin + (end - begin) * share, doing)


def rising(tell: Tell) -> Tell:
    """Tells a share that never falls, where work begins anew.

    >>> told = rising(lambda share, doing: print(share, doing))
    >>> told(0.5, "fitting"), told(0.2, "fitting again")
    0.5 fitting
    0.5 fitting again
    (None, None)
    """
    told = 0.0

    def forward(share: float, doing: str) -> None:
        nonlocal told
        told = max(told, share)
        tell(told, doing)

    return forward


def untold(_share: float, _doing: str) -> None:
    """For those who do not ask how far the work is."""


class OutOfWork(Exception):
    """A search has done all the work that it was given; what it found so far is lost, but for what
    it was told to keep.
    """


@dataclass(eq=False)
class Work:
    """What was done: `samples` simulated, `fits` (estimations), and what was `not_tried` because
    the work or the time was over.

    `most` bounds the `effort`; `ends` is the time (of `time.perf_counter`) at which it is over,
    where a user set one, and `timed_out` whether that cut it.
    """

    samples: int = 0
    fits: int = 0
    not_tried: list[str] = field(default_factory=list)
    timed_out: bool = False
    most: float = float("inf")
    ends: float = float("inf")

    @property
    def effort(self) -> int:
        """[samples] What is bounded: the simulations, and what the fits cost besides."""
        return self.samples + FIT_COST * self.fits

    def part(self, most: float = float("inf"), seconds: float | None = None) -> Work:
        """Work of its own that ends with this one at the latest; `take` adds it."""
        ends = self.ends
        if seconds is not None:
            ends = min(ends, time.perf_counter() + max(seconds, 0.0))
        return Work(most=min(most, self.most - self.effort), ends=ends)

    def take(self, part: Work) -> None:
        """Add what a part has done."""
        self.samples += part.samples
        self.fits += part.fits
        self.not_tried += [name for name in part.not_tried if name not in self.not_tried]
        self.timed_out |= part.timed_out


_now: ContextVar[Work | None] = ContextVar("work", default=None)


def begun() -> Work:
    """The work that counts here; one that nobody asks for, where none does."""
    return _now.get() or Work()


@contextmanager
def counted_as(work: Work) -> Iterator[Work]:
    """What is computed inside is counted as this work."""
    token = _now.set(work)
    try:
        yield work
    finally:
        _now.reset(token)


@contextmanager
def at_most(effort: float = float("inf"), seconds: float | None = None) -> Iterator[Work]:
    """What is computed inside raises `OutOfWork` after so much effort [samples], or so many seconds
    where a user asks for that.

    >>> with at_most(effort=100) as work:
    ...     count_samples(60)
    ...     go_on()
    >>> work.samples
    60
    """
    whole = begun()
    part = whole.part(effort, seconds)
    try:
        with counted_as(part):
            yield part
    finally:
        # Where the work ended early, too: what was done is done.
        whole.take(part)


def count_samples(samples: int) -> None:
    """Count what was simulated."""
    if (work := _now.get()) is not None:
        work.samples += samples


def count_fit() -> None:
    """Count an estimation."""
    if (work := _now.get()) is not None:
        work.fits += 1


def left_out(name: str) -> None:
    """Tell what is not tried, for the work or the time is over."""
    if (work := _now.get()) is not None and name not in work.not_tried:
        work.not_tried.append(name)


def go_on() -> None:
    """Raise `OutOfWork` where the work, or the time that a user gave, is over."""
    work = _now.get()
    if work is None:
        return
    if work.effort > work.most:
        raise OutOfWork
    # The clock is asked only where a user set a time: no other answer may hang on it.
    if work.ends < float("inf") and time.perf_counter() > work.ends:
        work.timed_out = True
        raise OutOfWork
