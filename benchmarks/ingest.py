"""Bus ingest: CPU and losses at the demo's full traffic, beside python-can's own receive loop on the same bus.

    python -m benchmarks.ingest [--seconds 60] [--speed 20]        # 600 for the ten minutes of the requirement

The three simulated machines run as processes of their own: 5000 CAN frames, 413 CAN FD frames and 1010 Modbus samples a
second, times the speed. The CPU is that of this process alone: sockets, decoding, sequence counters, clock alignment and window
cutting, without diagnosers and storage; that of the machines' processes, their equations and their sending, stands beside it.
"""

import argparse
import json
import os
import resource
import subprocess
import sys
import time
from pathlib import Path

import can

from residuum.service.fieldbus.can import multicast_address
from residuum.service.machines.machine_line import MachineLine
from residuum.service.simulated.demo import Demo


def residuum_share(seconds: float, speed: float) -> dict[str, object]:
    """Share of one core, losses and rates of our sources and cutters."""
    demo = Demo(speed)
    lines = [MachineLine(machine, lambda *_: lambda: None, lambda _: None) for machine in demo.machines]
    demo.start()
    for line in lines:
        line.start()
    try:
        _wait_until_all_are_good(lines)
        peer = subprocess.Popen(
            [
                sys.executable,
                "-m",
                "benchmarks.ingest",
                "--python-can",
                demo.machines[2].sources[0].channel,
                "--seconds",
                str(seconds),
            ],
            stdout=subprocess.PIPE,
        )
        before = {name: state["samples"] for line in lines for name, state in line.source_status().items()}
        cpu, begun, machines = time.process_time(), time.monotonic(), _machines_cpu(demo)
        time.sleep(seconds)
        share, wall = time.process_time() - cpu, time.monotonic() - begun
        machines_share = {name: (used - machines[name]) / wall for name, used in _machines_cpu(demo).items()}
        states = {name: state for line in lines for name, state in line.source_status().items()}
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        peer_share = json.loads(peer.communicate(timeout=60)[0])
    finally:
        demo.stop()
        for line in lines:
            line.stop()
    return {
        "seconds": wall,
        "share_of_one_core": share / wall,
        "share_of_the_machines": machines_share,
        "memory_mb": memory,
        "python_can_share_for_the_5000_frames_alone": peer_share,
        "windows": {line.settings.asset: len(line._windows) + line._dropped for line in lines},
        "sources": {
            name: {
                "samples_per_second": round((state["samples"] - before[name]) / wall, 1),
                "losses": {counter: times for counter, times in state["counters"].items() if times and counter != "bus_errors"},
            }
            for name, state in states.items()
        },
    }


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
        if all(state["quality"] == "good" for line in lines for state in line.source_status().values()):
            return
        time.sleep(0.2)
    raise SystemExit("the machines did not come up")


def python_can_share(channel: str, seconds: float) -> float:
    """Share of one core that python-can's receive loop takes for the same frames, undecoded."""
    group, port, _ = multicast_address(channel.partition(":")[2])
    with can.Bus(interface="udp_multicast", channel=group, port=port, hop_limit=0) as bus:
        cpu, begun = time.process_time(), time.monotonic()
        while time.monotonic() < begun + seconds - 2:
            bus.recv(0.1)
        return (time.process_time() - cpu) / (time.monotonic() - begun)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--python-can", help=argparse.SUPPRESS)
    given, _ = parser.parse_known_args()
    result = python_can_share(given.python_can, given.seconds) if given.python_can else residuum_share(given.seconds, given.speed)
    print(json.dumps(result, indent=None if given.python_can else 2))


if __name__ == "__main__":
    main()
