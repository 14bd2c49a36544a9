"""Bus ingest: CPU and losses at the demo's full traffic.

    python -m benchmarks.ingest [--seconds 60] [--speed 5]        # 600 for the ten minutes of the requirement

The three simulated machines run as processes of their own: 5000 CAN frames, 413 CAN FD frames and 1010 Modbus samples a
second, times the speed. The CPU is that of this process alone: sockets, decoding, sequence counters, clock alignment and window
cutting, without diagnosers and storage; that of the machines' processes, their equations and their sending, stands beside it.
"""

import argparse
import json
import os
import resource
import time
from pathlib import Path

from residuum.service.machines.machine_line import MachineLine
from residuum.service.simulated.demo import Demo


def residuum_share(seconds: float, speed: float) -> dict[str, object]:
    """Share of one core, losses and rates of our sources and cutters."""
    demo = Demo(speed)
    lines = [
        MachineLine(machine, lambda *_: lambda: None, lambda _: None) for machine in demo.machines
    ]
    demo.start()
    for line in lines:
        line.start()
    try:
        _wait_until_all_are_good(lines)
        before = {name: state for line in lines for name, state in line.source_status().items()}
        cpu, begun, machines = time.process_time(), time.monotonic(), _machines_cpu(demo)
        time.sleep(seconds)
        share, wall = time.process_time() - cpu, time.monotonic() - begun
        machines_share = {
            name: (used - machines[name]) / wall for name, used in _machines_cpu(demo).items()
        }
        states = {name: state for line in lines for name, state in line.source_status().items()}
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    finally:
        demo.stop()
        for line in lines:
            line.stop()
    return {
        "seconds": wall,
        "share_of_one_core": share / wall,
        "share_of_the_machines": machines_share,
        "memory_mb": memory,
        "windows": {line.settings.asset: len(line._windows) + line._dropped for line in lines},
        "sources": {
            name: {
                "samples_per_second": round((state["samples"] - before[name]["samples"]) / wall, 1),
                "losses": _counted_since(before[name]["counters"], state["counters"]),
            }
            for name, state in states.items()
        },
    }


def _counted_since(before: dict[str, int], counters: dict[str, int]) -> dict[str, int]:
    return {name: times - before[name] for name, times in counters.items() if times != before[name]}


def _machines_cpu(demo: Demo) -> dict[str, float]:
    """Processor time of each machine's process so far [s]."""
    used = {}
    for name, process in demo._processes.items():
        fields = Path(f"/proc/{process.pid}/stat").read_text().rsplit(")", 1)[1].split()
        used[name] = (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")
    return used


def _wait_until_all_are_good(lines: list[MachineLine]) -> None:
    end = time.monotonic() + 120
    while time.monotonic() < end:
        if all(
            state["quality"] == "good" for line in lines for state in line.source_status().values()
        ):
            return
        time.sleep(0.2)
    raise SystemExit("the machines did not come up")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--speed", type=float, default=1.0)
    given, _ = parser.parse_known_args()
    print(json.dumps(residuum_share(given.seconds, given.speed), indent=2))


if __name__ == "__main__":
    main()
