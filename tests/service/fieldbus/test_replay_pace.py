"""Frames are replayed at their pace, also by a computer that stood still for a while."""

import pytest

from residuum.service.fieldbus import replay
from residuum.service.fieldbus.can.can_log import TimedFrame
from residuum.service.fieldbus.replay import replay_to_can


class Clock:
    """Time that passes only where it is slept, and where a frame is sent that holds everything up."""

    def __init__(self, stall_at, stall):
        self.now, self.sent = 0.0, []
        self._stall = {stall_at: stall}

    def monotonic(self):
        return self.now

    def sleep(self, seconds):
        self.now += seconds

    def send(self, _frame_id, _data, *, is_fd):
        self.sent.append(self.now)
        self.now += self._stall.get(len(self.sent), 0.0)


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_what_was_missed_while_the_computer_stood_still_is_not_sent_in_one_burst(
    monkeypatch, speed
):
    clock = Clock(stall_at=500, stall=3.0)
    monkeypatch.setattr(replay, "time", clock)
    frames = [TimedFrame(k / 1000, 1, b"", False) for k in range(2000)]
    assert replay_to_can(frames, clock, speed) == 2000
    at = [moment for moment in clock.sent if moment > 3.0]
    for begin in at:
        burst = sum(begin <= moment < begin + 0.01 for moment in at)
        assert burst <= (0.2 + 0.02) * 1000 * speed
    assert clock.now == pytest.approx(2.0 / speed + 3.0 - 0.2, abs=0.02)
