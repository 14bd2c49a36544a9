"""A simulated device lives at its pace, also on a computer that stood still for a while."""

import asyncio

import pytest

from residuum.service.simulated import device
from residuum.service.simulated.device import Device
from residuum.service.simulated.wiring import Wiring

STALL = 3.0


class Clock:
    """Time that passes a little with every look at it, and once a lot."""

    def __init__(self, stopped):
        self.now, self._looks, self._stopped = 0.0, 0, stopped

    def monotonic(self):
        self._looks += 1
        self.now += STALL if self._looks == 100 else 0.01
        if self._looks == 300:
            self._stopped.set()
        return self.now


class Lived:
    """A machine that notes how long each piece of its life was."""

    sample_time = 0.0002

    def __init__(self):
        self.active_faults, self.pieces = {}, []

    def advance(self, duration):
        self.pieces.append(duration)
        return {}


@pytest.mark.parametrize("speed", [1.0, 20.0])
def test_what_a_device_missed_is_not_lived_in_one_burst(monkeypatch, speed):
    async def no_sleep(_seconds):
        pass

    stopped, machine = asyncio.Event(), Lived()
    clock = Clock(stopped)
    monkeypatch.setattr(device, "time", clock)
    monkeypatch.setattr(device.asyncio, "sleep", no_sleep)
    asyncio.run(
        Device(machine, Wiring("any"), None, None, speed, pytest.fail).run(
            stopped, lambda _port: None
        )
    )
    assert max(machine.pieces) <= 0.25 * speed
    assert sum(machine.pieces) == pytest.approx((clock.now - STALL + 0.2) * speed, abs=0.05 * speed)
