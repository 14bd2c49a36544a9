"""Token buckets: how many requests a client may make, in the long run and at once."""

from __future__ import annotations

import math
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass

_MOST_CLIENTS = 10_000
"""Buckets kept; beyond, the client that was silent for longest is forgotten, which fills its bucket."""


@dataclass
class _Bucket:
    tokens: float
    at: float


class RateLimit:
    """One bucket a client: it holds `burst` tokens, `rate` come in a second, a request takes one.

    Parameters
    ----------
    rate : float
        Requests a second [1/s] in the long run.
    burst : float
        Requests at once.
    clock : callable
        Seconds, never running backwards.

    Examples
    --------
    >>> limit = RateLimit(rate=2.0, burst=1.0, clock=iter([0.0, 0.0, 0.5]).__next__)
    >>> limit.wait("a"), limit.wait("a"), limit.wait("a")
    (0.0, 0.5, 0.0)
    """

    def __init__(self, rate: float, burst: float, clock: Callable[[], float]) -> None:
        self._rate = rate
        self._burst = burst
        self._clock = clock
        self._buckets: OrderedDict[str, _Bucket] = OrderedDict()

    def wait(self, client: str) -> float:
        """Seconds until the client's next request would be taken: 0 when this one is, and then it is counted."""
        now = self._clock()
        bucket = self._buckets.pop(client, None) or _Bucket(self._burst, now)
        self._buckets[client] = bucket
        if len(self._buckets) > _MOST_CLIENTS:
            self._buckets.popitem(last=False)
        bucket.tokens = min(self._burst, bucket.tokens + (now - bucket.at) * self._rate)
        bucket.at = now
        if bucket.tokens >= 1.0:
            bucket.tokens -= 1.0
            return 0.0
        return (1.0 - bucket.tokens) / self._rate


def retry_after(seconds: float) -> dict[str, str]:
    """The header that says when to come again: whole seconds, rounded up."""
    return {"Retry-After": str(max(1, math.ceil(seconds)))}
