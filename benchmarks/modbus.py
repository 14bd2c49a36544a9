"""Modbus faults on real sockets: devices whose replies are wrong in every way we know, beside one that is in order.

    python -m benchmarks.modbus --faults 10000 --devices 6

A sixth of the replies is faulty. Every value that a source hands on is held against what the device wrote under that number.
Wrong: a value that differs, or a number handed on twice. Unaccounted: a number that neither came nor was counted as lost.
Recovery: from the end of a fault to the next good data of that device, or of the last fault where more came before any good
data. The device in order must deliver everything.
"""

from __future__ import annotations

import argparse
import importlib.util
import itertools
import random
import sys
import threading
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from residuum.service.fieldbus.modbus.modbus_source import ModbusSource
from residuum.service.fieldbus.modbus.register_map import read_register_map
from residuum.service.fieldbus.sequence import BREAK
from residuum.service.fieldbus.settings import MAPS
from residuum.service.fieldbus.source import Block

_SERVER = Path(__file__).parents[1] / "tests" / "service" / "fieldbus" / "faulty_modbus.py"
SHARE = 1 / 6
TIMEOUT = 0.05
PAGES, EVERY = 2, 0.02
"""Pages that each device writes every so many seconds."""
IN_TIME = 5.0
PATIENCE = 60.0


def _faulty_modbus() -> Any:
    spec = importlib.util.spec_from_file_location("faulty_modbus", _SERVER)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


class Device:
    """A device with its faults, and the source that reads it; every block is checked as it comes."""

    def __init__(self, faulty_modbus: Any, faults: Any, timeout: float = TIMEOUT) -> None:
        self._truth = faulty_modbus.truth
        self.server = faulty_modbus.FaultyModbus(faults, away=0.3, late=1.5 * TIMEOUT)
        self.wrong = self.samples = 0
        self.last = -1
        self.came: list[float] = []
        registers = read_register_map(MAPS / "process_plant.yaml")
        self.source = ModbusSource(
            "127.0.0.1", self.server.port, registers, self._take, timeout=timeout
        )

    def _take(self, block: Block) -> bool:
        self.came.append(time.monotonic())
        for number, u, y in zip(
            block.number.tolist(), block.channels["u"], block.channels["y"], strict=True
        ):
            expected = self._truth(number % BREAK)
            self.wrong += (u, y) != (expected["u"], expected["y"]) or number <= self.last
            self.last = number
            self.samples += 1
        return True

    def unaccounted(self) -> int:
        """Numbers that the device wrote and that neither came nor were counted as lost."""
        return abs(int(self.server.complete) - self.samples - self.source.health["lost"])

    def recoveries(self) -> list[float]:
        """Seconds from the end of the last fault before it to each good data that came after one."""
        came, ended = (
            np.array(self.came),
            np.array(sorted(moment for _, moment in self.server.ended)),
        )
        after = np.searchsorted(came, ended, side="right")
        last = np.flatnonzero(np.diff(after, append=-1))
        return [float(came[after[k]] - ended[k]) if after[k] < len(came) else np.inf for k in last]

    def stop(self) -> None:
        self.source.stop()
        self.source.join()
        self.server.stop()


def campaign(faults: int, devices: int, seed: int = 0) -> dict[str, Any]:
    """Let the devices be faulty until enough faults have been; returns what was counted."""
    faulty_modbus = _faulty_modbus()
    over = threading.Event()

    def draw(rng: random.Random) -> Any:
        for _ in itertools.count():
            yield (
                rng.choice(faulty_modbus.KINDS)
                if not over.is_set() and rng.random() < SHARE
                else None
            )

    faulty = [Device(faulty_modbus, draw(random.Random(seed + k))) for k in range(devices)]
    # it may be slow with this machine; it may lose nothing
    sound = Device(faulty_modbus, iter(()), IN_TIME)
    everyone = [*faulty, sound]
    for device in everyone:
        device.source.start()
    while sum(device.server.done for device in faulty) < faults:
        for device in everyone:
            device.server.publish(PAGES)
        time.sleep(EVERY)
    over.set()
    for device in everyone:  # so that good data come after every fault
        device.server.publish(PAGES)
    end = time.monotonic() + PATIENCE
    while any(device.unaccounted() for device in everyone) and time.monotonic() < end:
        time.sleep(0.05)
    for device in everyone:
        device.stop()
    return _counted(faulty, sound)


def _counted(faulty: list[Device], sound: Device) -> dict[str, Any]:
    recoveries = [wait for device in faulty for wait in device.recoveries()]
    counters = sum(
        (Counter(device.source.health.snapshot()["counters"]) for device in faulty), Counter[str]()
    )
    sound_losses = sum(sound.source.health.snapshot()["counters"].values())
    kinds = Counter(kind for device in faulty for kind, _ in device.server.ended)
    return {
        "faults": sum(device.server.done for device in faulty),
        "kinds": len(kinds),
        "fewest of a kind": min(kinds.values()),
        "samples handed on": sum(device.samples for device in faulty),
        "wrong values": sum(device.wrong for device in [*faulty, sound]),
        "unaccounted": sum(device.unaccounted() for device in [*faulty, sound]),
        "counted as lost": counters["lost"],
        "longest recovery [s]": round(max(recoveries), 3),
        "recoveries over 5 s": sum(wait > IN_TIME for wait in recoveries),
        "recoveries": len(recoveries),
        "median recovery [s]": round(float(np.median(recoveries)), 3),
        "sound device: samples": sound.samples,
        "sound device: lost, late or wrong": sound_losses + sound.wrong,
        "counters": dict(+counters),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--faults", type=int, default=10_000)
    parser.add_argument("--devices", type=int, default=6)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    found = campaign(given.faults, given.devices, given.seed)
    for what, figure in found.items():
        print(f"{what:<36}{figure}")
    if any(
        found[what]
        for what in (
            "wrong values",
            "unaccounted",
            "recoveries over 5 s",
            "sound device: lost, late or wrong",
        )
    ):
        sys.exit(1)


if __name__ == "__main__":
    main()
