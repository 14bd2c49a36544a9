"""The demo for a day of its machines' time, faster than real time: memory, open files, missed faults, alarms without a fault.

    python -m benchmarks.soak --hours 24 --speed 5

`residuum serve --demo` runs as it is, its machines on their buses so many times faster. One machine after the other gets each
of its faults, switched over its own bus, and is repaired once it was found. Retention is set low, so that rows and signals stop
growing early. Memory is that of all processes together: the last fifth of the run beside the second one. Time is that of the
samples that arrived; on a machine that is too slow for the speed asked for, the devices fall behind and the run takes longer.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.error
import urllib.request
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

WITHIN = {"gate-actuator": 2, "gripping-pliers": 4, "process-plant": 12}
"""Windows after the switching within which a fault must be found; the first may have begun before."""
SETTLES = {"gate-actuator": 2, "gripping-pliers": 4, "process-plant": 8}
"""Windows after the repair that still show the fault."""
HEALTHY = {"gate-actuator": 6, "gripping-pliers": 40, "process-plant": 20}
"""Windows without a fault between two."""
LAG = 1.0
"""Seconds of this computer's time until an order and the samples after it have come through: at 5 × two rounds of the pliers."""
LOOK = 1.0
ORDERS = 60
LONGEST_STEP = 3600.0
SPARING = {
    "RESIDUUM_KEEP_BYTES": str(64 * 2**20),
    "RESIDUUM_KEEP_ROWS": "1000",
    "RESIDUUM_LOG_LEVEL": "error",
}
FLAT = 0.05


class Service:
    """The demo as a process, and its interface."""

    def __init__(self, data: str, speed: float) -> None:
        command = [sys.executable, "-c", "from residuum.service.cli import main; main()"]
        command += ["serve", "--demo", "--port", "0", "--data", data]
        environment = {**os.environ, **SPARING, "RESIDUUM_DEMO_SPEED": str(speed)}
        self.process = subprocess.Popen(command, env=environment, stdout=subprocess.PIPE, text=True)
        self.url = self.process.stdout.readline().split()[-1].rstrip("/")

    def ask(self, path: str, body: dict[str, Any] | None = None) -> Any:
        data = None if body is None else json.dumps(body).encode()
        request = urllib.request.Request(
            f"{self.url}/api/v1/{path}", data, {"Content-Type": "application/json"}
        )
        with urllib.request.urlopen(request, timeout=120) as answer:
            return json.load(answer)

    def stop(self) -> float:
        begun = time.monotonic()
        self.process.terminate()
        self.process.wait(60)
        self.process.stdout.close()
        return time.monotonic() - begun


@dataclass
class Machine:
    """One machine's faults in turn, and what its windows said."""

    name: str
    faults: list[str]
    speed: float = 1.0
    seen: int = 0
    windows: int = 0
    healthy_windows: int = 0
    false: int = 0
    found: int = 0
    not_assessable: int = 0
    missed: list[str] = field(default_factory=list)
    since: int = 0
    waiting: int = 0
    orders_again: int = 0
    on: str | None = None
    next_fault: int = 0
    seconds: float = 0.0
    until: float | None = None

    def look(self, service: Service) -> None:
        """Take note of the windows judged since the last look; switch a fault on or off when its time has come."""
        switched = False
        for finding in reversed(list(self._new_findings(service))):
            if switched:  # judged before the switching, though seen after it
                self.windows += 1
            else:
                switched = self._note(service, finding["verdict"])
        newest = service.ask(f"assets/{self.name}/windows?limit=1")["items"]
        if newest:
            end = newest[0]["t0"] + newest[0]["n"] * newest[0]["sample_time"]
            step = 0.0 if self.until is None else end - self.until
            # numbers leap where a device was lost sight of
            self.seconds += step if 0 < step < LONGEST_STEP else 0.0
            self.until = end

    def _new_findings(self, service: Service) -> Iterator[dict[str, Any]]:
        items = service.ask(f"assets/{self.name}/findings?limit=200")["items"]
        known, self.seen = self.seen, items[0]["id"] if items else self.seen
        yield from (item for item in items if item["id"] > known)

    def _note(self, service: Service, verdict: str) -> bool:
        """Take note of one window; whether a fault was switched because of it."""
        self.windows += 1
        if verdict == "not-assessable":  # samples were lost: it says nothing of the machine
            self.not_assessable += 1
            return False
        self.since += 1
        if self.on is not None:
            late = self.since > WITHIN[self.name] + self.waiting
            if verdict == "faulty" or late:
                self.found += verdict == "faulty"
                self.missed += [self.on] if verdict != "faulty" else []
                return self._switch(service, None)
        elif self.since > SETTLES[self.name] + self.waiting:
            self.healthy_windows += 1
            self.false += verdict == "faulty"
            if self.since > HEALTHY[self.name] + self.waiting:
                self.next_fault += 1
                return self._switch(service, self.faults[(self.next_fault - 1) % len(self.faults)])
        return False

    def _switch(self, service: Service, fault: str | None) -> bool:
        for _ in range(ORDERS):
            try:
                service.ask(f"demo/machines/{self.name}/fault", {"fault": fault or "none"})
                break
            except urllib.error.HTTPError as error:
                # the device did not take the order: it is given again
                self.orders_again += 1
                last = error
                time.sleep(LOOK)
        else:
            raise last
        self.on, self.since = fault, 0
        # cut before, judged after
        self.waiting = service.ask("status")["machines"][self.name]["windows_waiting"]
        # and not even cut
        self.waiting += round(LAG * self.speed * self.windows / self.seconds) if self.seconds else 0
        return True


def usage(root: int) -> tuple[float, int]:
    """Resident memory [MiB] and open files of a process and all below it."""
    memory, files = 0.0, 0
    for process in _tree(root):
        try:
            pages = int(Path(f"/proc/{process}/statm").read_text().split()[1])
            files += len(os.listdir(f"/proc/{process}/fd"))
        except OSError:
            continue  # it has just ended
        memory += pages * os.sysconf("SC_PAGE_SIZE") / 2**20
    return memory, files


def _tree(root: int) -> list[int]:
    parents: dict[int, list[int]] = {}
    for entry in Path("/proc").iterdir():
        if entry.name.isdecimal():
            try:
                parent = int((entry / "stat").read_text().rsplit(")", 1)[1].split()[1])
            except OSError:
                continue
            parents.setdefault(parent, []).append(int(entry.name))
    found, at = [root], 0
    while at < len(found):
        found += parents.get(found[at], [])
        at += 1
    return found


def campaign(hours: float, speed: float, minutes: float) -> dict[str, Any]:
    """Run until the machines have lived so many hours, or this computer so many minutes; returns what was measured."""
    with tempfile.TemporaryDirectory() as data:
        service = Service(data, speed)
        try:
            _wait_until_trained(service)
            machines = [
                Machine(
                    name,
                    [fault["id"] for fault in service.ask(f"demo/machines/{name}/fault")["faults"]],
                    speed,
                )
                for name in WITHIN
            ]
            begun, used = time.monotonic(), []
            while time.monotonic() - begun < 60 * minutes:
                time.sleep(LOOK)
                for machine in machines:
                    machine.look(service)
                used.append(usage(service.process.pid))
                if min(machine.seconds for machine in machines) >= 3600 * hours:
                    break
            took = time.monotonic() - begun
            status = service.ask("status")
        finally:
            stopped_in = service.stop()
    return _figures(machines, used, took, status) | {"stopped in [s]": round(stopped_in, 1)}


def _wait_until_trained(service: Service) -> None:
    end = time.monotonic() + 1200
    while any(state["state"] != "running" for state in service.ask("status")["machines"].values()):
        if time.monotonic() > end:
            raise RuntimeError(f"the demo was not trained: {service.ask('status')['machines']}")
        time.sleep(LOOK)


def _figures(
    machines: list[Machine], used: list[tuple[float, int]], took: float, status: dict[str, Any]
) -> dict[str, Any]:
    fifth = max(1, len(used) // 5)
    early, late = used[fifth : 2 * fifth] or used, used[-fifth:]
    memory = [statistics.median(each[0] for each in part) for part in (early, late)]
    files = [max(each[1] for each in part) for part in (early, late)]
    hours = min(machine.seconds for machine in machines) / 3600
    days = sum(machine.seconds for machine in machines) / len(machines) / 86400
    return {
        "minutes": round(took / 60, 1),
        "hours of the machines": round(hours, 3),
        "speed reached": round(hours * 3600 / took, 1),
        "windows dropped": {
            name: state["windows_dropped"] for name, state in status["machines"].items()
        },
        **_judgements(machines, days),
        "memory [MiB], second and last fifth": [round(each) for each in memory],
        "memory grown [%]": round(100 * (memory[1] / memory[0] - 1), 1),
        "open files, most in each": files,
        "bus counters": _bus_counters(status),
        "load of the machine": os.getloadavg()[0],
    }


def _judgements(machines: list[Machine], days: float) -> dict[str, Any]:
    return {
        "windows": {machine.name: machine.windows for machine in machines},
        "not assessable": {machine.name: machine.not_assessable for machine in machines},
        "orders given again": sum(machine.orders_again for machine in machines),
        "faults found": sum(machine.found for machine in machines),
        "faults missed": [
            f"{machine.name} {fault}" for machine in machines for fault in machine.missed
        ],
        "windows faulty without a fault": {
            machine.name: f"{machine.false} of {machine.healthy_windows}" for machine in machines
        },
        "… a machine's day": round(
            sum(machine.false for machine in machines) / max(days, 1e-9) / len(machines), 1
        ),
    }


def _bus_counters(status: dict[str, Any]) -> dict[str, dict[str, int]]:
    counted = {
        name: {kind: n for kind, n in source["counters"].items() if n}
        for name, source in status["sources"].items()
    }
    return {name: counters for name, counters in counted.items() if counters}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--hours", type=float, default=24.0, help="of the machines' time")
    parser.add_argument(
        "--speed",
        type=float,
        default=5.0,
        help="5 is what python-can and pymodbus keep up with on two cores",
    )
    parser.add_argument(
        "--minutes", type=float, default=600.0, help="end then, whatever was reached"
    )
    given = parser.parse_args()
    found = campaign(given.hours, given.speed, given.minutes)
    for what, figure in found.items():
        print(f"{what:<38}{figure}")
    grown = found["open files, most in each"][1] > found["open files, most in each"][0]
    if (
        found["memory grown [%]"] > 100 * FLAT
        or grown
        or found["faults missed"]
        or found["hours of the machines"] < given.hours
    ):
        sys.exit(1)


if __name__ == "__main__":
    main()
