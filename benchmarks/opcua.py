"""A campaign against the OPC UA source: servers killed, sessions dropped, status not good, clocks set, values too fast.

PYTHONPATH=. python -m benchmarks.opcua [--faults N] [--seed S] [--kinds kill,drop] [--seconds T]

Every value says when it was measured (see `opcua_server`), so a sample in a wrong place or of a wrong status is seen. Exit status
1 when one is, when a loss is not counted, or when good data came later than 5 s after a server's return.
"""

import argparse
import math
import os
import random
import signal
import subprocess
import sys
import time

import numpy as np
from asyncua import ua

from benchmarks.free_port import free_port
from benchmarks.opcua_server import STEP
from residuum.service.fieldbus.opcua.node_map import NodeMap
from residuum.service.fieldbus.opcua.opcua_source import OpcuaSource
from residuum.service.fieldbus.sequence import BREAK

KINDS = ("kill", "kill", "drop", "bad", "uncertain", "jump", "faster", "kill-and-set")
MAP = {
    "streams": {
        "s": {"sample_time": STEP, "channels": {n: {"node": f"ns=2;s=m.{n}"} for n in ("u", "y")}}
    }
}
RETURN = 5.0


class Server:
    """The server's process, which can be told to do things wrong."""

    def __init__(self, port):
        self.port, self.shift = port, 0.0
        self.start()

    def start(self):
        command = [sys.executable, "-m", "benchmarks.opcua_server", str(self.port), str(self.shift)]
        self.process = subprocess.Popen(
            command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        self.up = float(self.process.stdout.readline().split()[1])

    def kill(self):
        os.kill(self.process.pid, signal.SIGKILL)
        self.process.wait()

    def tell(self, line):
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()


class Judge:
    """Takes blocks and says what is wrong with them."""

    def __init__(self):
        self.wrong, self.good, self.last_good = 0, 0, 0.0
        self.offsets, self.numbers = {}, {}

    def take(self, block):
        u, y = block.channels["u"], block.channels["y"]
        for number, a, b in zip(block.number.tolist(), u.tolist(), y.tolist(), strict=True):
            segment = number // BREAK
            self.numbers.setdefault(segment, []).append(number)
            for i in [i for i in (a, (b - 1) / 2) if not math.isnan(i)]:
                self.wrong += (
                    i != int(i) or self.offsets.setdefault(segment, number - i) != number - i
                )
            if not (math.isnan(a) or math.isnan(b)):
                self.good += 1
                self.last_good = time.monotonic()
        return True

    def uncounted(self):
        """Numbers that never came, by segment, in all."""
        return sum(int(np.max(n) - np.min(n)) + 1 - len(set(n)) for n in self.numbers.values())

    def twice(self):
        return sum(len(n) - len(set(n)) for n in self.numbers.values())


def wait_for_good(judge, since, seconds=30.0):
    while judge.last_good <= since and time.monotonic() < since + seconds:
        time.sleep(0.02)
    return judge.last_good - since if judge.last_good > since else float("inf")


def provoke(kind, server, rng):
    """One fault from beginning to end; gives the time from which good data can come."""
    if kind.startswith("kill"):
        server.kill()
        if kind == "kill-and-set":
            server.shift += rng.choice((-40.0, -3.0, 3.0, 3600.0))
        time.sleep(rng.uniform(0.0, 1.5))
        server.start()
        return server.up
    if kind == "drop":
        server.tell("drop")
        time.sleep(0.1)
        return time.monotonic()
    if kind == "jump":
        by = rng.choice((-3600.0, -5.0, -0.7, 4.0, 3600.0))
        server.shift += by
        server.tell(f"jump {by}")
        time.sleep(0.1)
        return time.monotonic()
    if kind == "faster":
        server.tell(f"every {rng.choice((2, 3))}")
        time.sleep(rng.uniform(0.2, 0.6))
        server.tell("every 1")
        return time.monotonic()
    status = (
        ua.StatusCodes.BadSensorFailure
        if kind == "bad"
        else ua.StatusCodes.UncertainLastUsableValue
    )
    server.tell(f"status {status}")
    time.sleep(rng.uniform(0.2, 0.6))
    server.tell("status 0")
    return time.monotonic()


def run(faults, seed, kinds=KINDS, seconds=math.inf):
    rng, port = random.Random(seed), free_port()
    server, judge = Server(port), Judge()
    source = OpcuaSource(f"opc.tcp://127.0.0.1:{port}/", NodeMap.model_validate(MAP), judge.take)
    source.start()
    returns, counts, end = [], dict.fromkeys(KINDS, 0), time.monotonic() + seconds
    try:
        returns.append(wait_for_good(judge, time.monotonic()))
        for _ in range(faults):
            if time.monotonic() > end:
                break
            kind = rng.choice(kinds)
            counts[kind] += 1
            returns.append(wait_for_good(judge, provoke(kind, server, rng)))
            time.sleep(rng.uniform(0.1, 0.5))
    finally:
        source.stop()
        source.join()
        server.kill()
    counters = {name: n for name, n in source.health.snapshot()["counters"].items() if n}
    return judge, returns, counts, counters


def main():
    options = argparse.ArgumentParser()
    options.add_argument("--faults", type=int, default=200)
    options.add_argument("--seed", type=int, default=1)
    options.add_argument("--kinds", default=",".join(KINDS), help="Only these faults.")
    options.add_argument(
        "--seconds", type=float, default=math.inf, help="No new fault after so long."
    )
    given = options.parse_args()
    judge, returns, counts, counters = run(
        given.faults, given.seed, given.kinds.split(","), given.seconds
    )
    lost, counted = judge.uncounted(), counters.get("lost", 0)
    print(f"faults: {counts}")
    print(f"samples: {judge.good} good, {judge.wrong} wrong, {judge.twice()} twice")
    print(f"{lost} missing inside segments, {counted} counted lost")
    print(
        f"good data after return [s]: median {np.median(returns):.2f}, longest {max(returns):.2f}"
    )
    print(f"counters: {counters}")
    return int(judge.wrong > 0 or judge.twice() > 0 or counted < lost or max(returns) > RETURN)


if __name__ == "__main__":
    sys.exit(main())
