"""Backoff: how long to wait before the next attempt to reach a device that does not answer."""

from __future__ import annotations

import random


class Backoff:
    """Waits that double from `first` to `longest` seconds, each spread by ±50 % so that many sources do not knock in step.

    Examples
    --------
    >>> backoff = Backoff(first=1.0, longest=4.0, seed=0)
    >>> waits = [backoff.next() for _ in range(4)]
    >>> all(low / 2 <= wait <= low * 1.5 for wait, low in zip(waits, (1, 2, 4, 4)))
    True
    """

    def __init__(self, first: float = 0.1, longest: float = 2.5, seed: int | None = None) -> None:
        self._first, self._longest = first, longest
        self._random = random.Random(seed)
        self._wait = first

    def next(self) -> float:
        """Seconds to wait now."""
        wait = self._wait
        self._wait = min(2 * wait, self._longest)
        return wait * self._random.uniform(0.5, 1.5)

    def reset(self) -> None:
        """Begin anew after a success."""
        self._wait = self._first
