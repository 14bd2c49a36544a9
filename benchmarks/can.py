"""CAN faults on python-can's virtual bus: drops, repetitions, disorder, counter jumps, error frames and bus-off.

    python -m benchmarks.can --faults 10000

A gate actuator opens again and again, recorded healthy; most of its movements suffer faults on the bus, some one alone. What the
source counts is held against what was done, every sample that it hands on against the one that was sent, and every window
against both: it must hold what came, miss what did not, and reach across no jump. Windows with a hole are scored; none may be
healthy. Those of undisturbed movements must be, or the test would prove nothing.
"""

from __future__ import annotations

import argparse
import sys
import time
import uuid
from collections import Counter
from collections.abc import Sequence
from typing import Any

import can
import numpy as np
import numpy.typing as npt

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.identification.record import Record
from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.can.can_bus import open_bus
from residuum.service.fieldbus.can.frame_layout import read_dbc
from residuum.service.fieldbus.sequence import BREAK
from residuum.service.fieldbus.settings import MAPS, SourceSettings, WindowSettings
from residuum.service.fieldbus.source import Block
from residuum.service.machines.windows import make_cutter

Numbers = npt.NDArray[np.int64]

DRIVE = read_dbc(MAPS / "gate_actuator.dbc")["drive"]
TURN = 1 << DRIVE.counter_bits
K, R = 0.0696, 0.7473
"""Motor constant [V·s/rad] and resistance [Ω] of the gate's motor: its current follows from voltage and speed."""
PAUSE = 5000
"""Samples of standstill between two movements."""
PER_MOVEMENT = 340
SAMPLE_FAULTS = ("drop", "repetition", "disorder")
BUS_FAULTS = ("jump", "error frame", "bus-off")
BUS_FAULT_SHARE = 0.2
"""Of the faults of every third movement; the others have faults of single samples, so their windows are cut."""
_BUS_OFF = 0x40
PATIENCE = 60.0


def healthy_gate() -> tuple[Diagnoser, dict[str, npt.NDArray[np.float64]]]:
    """A trained diagnoser, and one healthy movement with its pause, at the stream's rate."""
    example = DIAGNOSERS["gate-actuator"].examples()[0]
    judge = DIAGNOSERS["gate-actuator"]().fit(
        [_at_bus_rate(record) for record in example.training], example.labels
    )
    movement = _at_bus_rate(example.healthy[0])
    still = {"speed": 0.0, "current": 0.0, "voltage": 0.0, "phase": 0.0}
    return judge, {
        name: np.concatenate([np.full(PAUSE, value), movement[name]])
        for name, value in still.items()
    }


def _at_bus_rate(record: Record) -> Record:
    time_then = np.arange(0.0, record.duration - record.sample_time, DRIVE.sample_time)
    time_now = np.arange(record.n) * record.sample_time
    channels = {name: np.interp(time_then, time_now, record[name]) for name in record.names}
    channels["current"] = (channels["voltage"] - K * channels["speed"]) / R
    return Record(channels, {**record.units, "current": "A"}, DRIVE.sample_time)


class Bus:
    """A sender that knows what it sent, and the source beside it that reads.

    Samples are numbered as they are made; a jump of the sender's counter begins a new era.
    """

    def __init__(self, cycle: dict[str, npt.NDArray[np.float64]]) -> None:
        self.cycle = cycle
        self.done: Counter[str] = Counter()
        self.expected: Counter[str] = Counter()
        self.sent: list[Numbers] = []
        self.eras: list[int] = [0]
        self._offset = self._next = self._frames = 0
        self.blocks: list[Block] = []
        settings = SourceSettings(
            kind="can", channel=f"virtual:{uuid.uuid4()}", map="gate_actuator.dbc"
        )
        self.source = SOURCES["can"](settings, self._take)
        # frames come faster than they would be made; a pause here is no silent sender
        self.source._clock = lambda: 0.0
        self.source.start()
        self._bus = open_bus(settings.channel)
        self._wait(lambda: self.source._bus is not None)

    def _take(self, block: Block) -> bool:
        self.blocks.append(block)
        return True

    def _wait(self, condition: Any) -> None:
        end = time.monotonic() + PATIENCE
        while not condition():
            if time.monotonic() > end:
                raise RuntimeError(f"the source does not follow: {self.source.health.snapshot()}")
            time.sleep(0.002)

    def truth(self, number: Numbers) -> dict[str, npt.NDArray[np.float64]]:
        """What was measured at these samples."""
        place = number % len(self.cycle["phase"])
        return {name: values[place] for name, values in self.cycle.items()}

    def send(self, numbers: Numbers) -> None:
        """Frames of these samples, in this order."""
        for piece in np.array_split(numbers, max(1, len(numbers) // 500)):
            frames = DRIVE.encode((piece + self._offset) % TURN, self.truth(piece))
            self._bus.send_many(DRIVE.frame_id, frames)
        self.sent.append(np.unique(numbers))
        self._frames += len(numbers)

    def settle(self) -> None:
        """Wait until every frame has been read."""
        self._wait(lambda: self.source.health.snapshot()["frames"] == self._frames)

    def movement(self, rng: np.random.Generator, faults: int, share_on_bus: float = 0.0) -> None:
        """One pause and one movement with so many faults, all at places of their own."""
        n = len(self.cycle["phase"])
        begin, self._next = self._next, self._next + n
        slots = np.sort(rng.choice(np.arange(4, n // 40 - 4), faults, replace=False)) * 40 + begin
        on_bus = rng.random(faults) < share_on_bus
        waiting, at = [], begin
        for slot, of_bus in zip(slots.tolist(), on_bus.tolist(), strict=True):
            waiting.append(np.arange(at, slot))
            if of_bus:
                self.send(np.concatenate(waiting))
                waiting, at = (
                    [],
                    slot
                    + self._bus_fault(str(rng.choice(BUS_FAULTS, p=[0.45, 0.45, 0.1])), slot, rng),
                )
            else:
                piece, at = self._sample_fault(str(rng.choice(SAMPLE_FAULTS)), slot, rng)
                waiting.append(piece)
        waiting.append(np.arange(at, self._next))
        self.send(np.concatenate(waiting))

    def _sample_fault(self, kind: str, slot: int, rng: np.random.Generator) -> tuple[Numbers, int]:
        """The samples as they are sent instead, and the first one after them."""
        self.done[kind] += 1
        length = int(rng.integers(1, 8))
        piece = np.arange(slot, slot + 10)
        if kind == "drop":
            self.expected["lost"] += length
            return piece[length:], slot + 10
        if kind == "repetition":
            self.expected["duplicated"] += 1
            return np.insert(piece, length + 1, piece[rng.integers(0, length + 1)]), slot + 10
        self.expected["reordered"] += 1
        return np.insert(piece[1:], length, piece[0]), slot + 10

    def _bus_fault(self, kind: str, slot: int, rng: np.random.Generator) -> int:
        """Let it happen before sample `slot`; returns how many samples are lost with it."""
        self.done[kind] += 1
        if kind == "jump":
            self._offset += int(rng.integers(round(0.3 * TURN), round(0.8 * TURN)))
            self.eras.append(slot)
            self.expected["counter_jumps"] += 1
            return 0
        self.expected["bus_errors"] += 1
        if kind == "error frame":
            self._bus._bus.send(can.Message(arbitration_id=0, is_error_frame=True))
            return 0
        self.expected["reconnects"] += 1
        self._bus._bus.send(can.Message(arbitration_id=_BUS_OFF, is_error_frame=True))
        self._wait(lambda: self.source.health["reconnects"] == self.expected["reconnects"])
        lost = int(rng.integers(1, 30))
        self.expected["lost"] += lost
        return lost

    def stop(self) -> None:
        self.source.stop()
        self.source.join()
        self._bus.close()


class Places:
    """The sample that was made at each number that the source gave, era by era."""

    def __init__(self, bus: Bus) -> None:
        number = np.concatenate([block.number for block in bus.blocks])
        self.came = np.sort(number)
        firsts = np.searchsorted(self.came, np.arange(len(bus.eras)) * BREAK)
        self._begin = np.append(self.came[firsts], np.iinfo(np.int64).max)
        self._shift = np.array(bus.eras) - self._begin[:-1]

    def sample(self, number: Numbers) -> Numbers:
        """The sample made at a number."""
        era = np.searchsorted(self._begin, number, side="right") - 1
        return number + self._shift[era]

    def eras(self, start: int, stop: int) -> int:
        """Eras between two numbers."""
        return (
            int(
                np.searchsorted(self._begin, stop - 1, side="right")
                - np.searchsorted(self._begin, start, side="right")
            )
            + 1
        )


def campaign(faults: int, seed: int = 0) -> dict[str, Any]:
    """Movements with and without faults in turn, until there were enough faults; returns what was counted."""
    judge, cycle = healthy_gate()
    rng = np.random.default_rng(seed)
    bus = Bus(cycle)
    try:
        bus.movement(rng, 0)
        while sum(bus.done.values()) < faults:
            bus.movement(rng, min(PER_MOVEMENT, faults), BUS_FAULT_SHARE)
            bus.movement(rng, int(rng.integers(0, 4)))
            bus.movement(rng, min(PER_MOVEMENT, faults))
        bus.settle()
    finally:
        bus.stop()
    counted = {
        name: times for name, times in bus.source.health.snapshot()["counters"].items() if times
    }
    places = Places(bus)
    wrong = sum(_wrong_samples(bus, places, block) for block in bus.blocks)
    sent = np.concatenate(bus.sent)
    return {
        "faults": sum(bus.done.values()),
        "of each kind": dict(bus.done),
        "frames": bus._frames,
        "counted": counted,
        "counted wrongly": sum(
            abs(counted.get(name, 0) - bus.expected[name]) for name in {*counted, *bus.expected}
        ),
        "wrong samples": wrong
        + len(places.came)
        - len(np.unique(places.came))
        + abs(len(places.came) - len(sent)),
        **_windows(bus, places, judge),
    }


def _wrong_samples(bus: Bus, places: Places, block: Block) -> int:
    truth = bus.truth(places.sample(block.number))
    differs = [np.abs(block.channels[name] - values) > 0.021 for name, values in truth.items()]
    return int(np.any(differs, axis=0).sum())


def _windows(bus: Bus, places: Places, judge: Diagnoser) -> dict[str, int]:
    """Cut and judge what came; a window that does not hold exactly what came is counted as wrong."""
    cutter = make_cutter(WindowSettings(cut="movement"), bus.source.streams[:1], "gate")
    cut: Sequence[Record] = [window for block in bus.blocks for window in cutter.push(block)]
    found = Counter(
        {"windows wrong": 0, "windows across a jump": 0, "windows with a hole, healthy": 0}
    )
    for window in cut:
        start = round(window.t0 / window.sample_time)
        number = np.arange(start, start + window.n)
        came = np.isin(
            number, places.came[slice(*np.searchsorted(places.came, [start, start + window.n]))]
        )
        found["windows wrong"] += not np.array_equal(came, ~window.missing("speed"))
        found["windows across a jump"] += places.eras(start, start + window.n) > 1
        healthy = judge.score(window).verdict == "healthy"
        kind = "whole" if came.all() else "with a hole"
        found[f"windows {kind}"] += 1
        found[f"windows {kind}, healthy"] += healthy
    return dict(found)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--faults", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    found = campaign(given.faults, given.seed)
    for what, figure in found.items():
        print(f"{what:<30}{figure}")
    bad = (
        "counted wrongly",
        "wrong samples",
        "windows wrong",
        "windows across a jump",
        "windows with a hole, healthy",
    )
    if any(found[what] for what in bad):
        sys.exit(1)


if __name__ == "__main__":
    main()
