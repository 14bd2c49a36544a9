"""A token bucket takes what it must take, exactly, and remembers a bounded number of clients."""

import numpy as np
import pytest

from residuum.service.security import gate
from residuum.service.security.gate import RateLimit, retry_after


class Clock:
    now = 0.0

    def __call__(self):
        return self.now


def test_over_any_time_no_more_than_burst_and_rate_are_taken():
    clock, rng = Clock(), np.random.default_rng(3)
    limit = RateLimit(rate=10.0, burst=5.0, clock=clock)
    taken = []
    for pause in rng.exponential(0.02, 5000):  # five times what is allowed
        clock.now += pause
        if limit.wait("a") == 0.0:
            taken.append(clock.now)
    taken = np.array(taken)
    assert len(taken) == pytest.approx(10.0 * clock.now + 5, rel=0.01)
    for span in (1, 10, 100):
        counts = np.searchsorted(taken, taken + span) - np.arange(len(taken))
        assert counts.max() <= 10 * span + 5 + 1


def test_who_waits_as_long_as_told_is_taken_and_others_do_not_matter():
    clock = Clock()
    limit = RateLimit(rate=0.5, burst=1.0, clock=clock)
    assert limit.wait("a") == 0.0
    wait = limit.wait("a")
    assert wait == 2.0 and limit.wait("b") == 0.0
    clock.now += wait
    assert limit.wait("a") == 0.0
    assert retry_after(0.01) == {"Retry-After": "1"} and retry_after(1.5) == {"Retry-After": "2"}


def test_clients_are_forgotten_oldest_first(monkeypatch):
    monkeypatch.setattr(gate, "_MOST_CLIENTS", 2)
    limit = RateLimit(rate=1.0, burst=1.0, clock=Clock())
    assert [limit.wait(client) for client in ("a", "b", "a")] == [0.0, 0.0, 1.0]
    assert limit.wait("c") == 0.0  # b goes
    assert limit.wait("a") == 1.0 and limit.wait("b") == 0.0
