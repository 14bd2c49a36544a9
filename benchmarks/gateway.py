"""Windows from a gateway to a service, killed, cut off and restarted in the midst: each is stored once; how many a second.

    python -m benchmarks.gateway --windows 1000
    python -m benchmarks.gateway --throughput --windows 400 --samples 500

Gateway and service are processes of their own, with a proxy between them. At random moments the service or the gateway is killed
(SIGKILL), the service is stopped in good order and started again, the network falls silent (keeping what was said, or throwing it
away), or every connection is cut. Windows are numbered by their `t0`. Lost: the gateway had it on its disk, and the service has
it not. Twice, astray: stored a second time, or behind a later one of its machine. The exit status is 1 when there is one.

With --throughput nothing is disturbed: a spool that was filled before is emptied, and the windows a second are told.
"""

from __future__ import annotations

import argparse
import json
import multiprocessing
import random
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from multiprocessing.connection import Connection
from multiprocessing.context import ForkServerProcess
from pathlib import Path
from typing import Any

import numpy as np
import uvicorn

from benchmarks.free_port import free_port
from benchmarks.http_cases import _wait
from benchmarks.partition import machine, stored, wait_for
from benchmarks.silent_proxy import SilentProxy
from residuum.identification.record import Record
from residuum.service.app import create_app
from residuum.service.settings import load_settings
from residuum.service.storage import DiskStore
from residuum.service.window_queue.gateway import Gateway, Sending
from residuum.service.window_queue.set_aside import SetAside
from residuum.service.window_queue.spool import Spool

MACHINES = 4
PATIENCE = 5.0
"""Seconds for which this gateway waits for an answer: a silence is to cost little."""
SILENCE = 2.0
AHEAD = 20
"""Windows that wait in the spool at most: disturbances are to come while others are sent."""
MOST = 2**32

_PROCESSES = multiprocessing.get_context("forkserver")


def window(number: int, samples: int = 500) -> Record:
    """A window that tells its number by when it begins."""
    signal = np.random.default_rng(number).normal(size=samples)
    return Record({"acceleration": signal}, {"acceleration": "m/s²"}, 1e-3, t0=float(number))


def url_of(folder: Path) -> str:
    """The service's database."""
    return f"sqlite:///{folder / 'service' / 'residuum.db'}"


def be_service(folder: Path, port: int, workers: int) -> None:
    """Be the service until killed."""
    settings = load_settings(
        data=folder / "service", database=url_of(folder), port=port, workers=workers,
        log_level="error",
    )  # fmt: skip
    uvicorn.run(create_app(settings), port=port, log_config=None, access_log=False)


def be_gateway(folder: Path, port: int, windows: range, told: Connection, allowed: Any) -> None:
    """Be the gateway until killed: tell the number of each window that is on its disk, of those that are `allowed`."""
    load_settings()
    spool = Spool(folder / "spool", MOST)
    sending = Sending(f"http://127.0.0.1:{port}", patience=PATIENCE)
    gateway = Gateway(spool, SetAside(folder), sending)
    gateway.start()
    for number in windows:
        while number >= allowed.value:
            time.sleep(0.01)
        gateway.handle(machine(asset_of(number)), window(number), None, None)  # type: ignore[arg-type]
        told.send(number)
        while len(spool) > AHEAD:
            time.sleep(0.01)
    told.send(None)
    while len(spool):
        time.sleep(0.05)
    told.send("empty")
    while True:
        time.sleep(1.0)


def asset_of(number: int) -> str:
    """The machine that a window is of."""
    return f"press-{number % MACHINES}"


class Plant:
    """A gateway and a service, as processes that may be killed, and a proxy between them.

    Parameters
    ----------
    folder : Path
    windows : int
        How many are sent.
    """

    def __init__(self, folder: Path, windows: int) -> None:
        self.folder, self._windows = folder, windows
        self._port = free_port()
        self.proxy = SilentProxy(("127.0.0.1", self._port), keeps=True)
        self.on_disk: list[int] = []
        self._next, self.empty = 0, False
        # without a lock, which who is killed would keep
        self._allowed = _PROCESSES.RawValue("i", 0)
        _PROCESSES.set_forkserver_preload(["benchmarks.gateway"])
        self.service = self._started_service()
        _wait(self._port)
        self.gateway = self._started_gateway()

    def _started_service(self) -> ForkServerProcess:
        service = _PROCESSES.Process(target=be_service, args=(self.folder, self._port, 1))
        service.start()
        return service

    def _started_gateway(self) -> ForkServerProcess:
        self._told, told = _PROCESSES.Pipe(duplex=False)
        rest = range(self._next, self._windows)
        gateway = _PROCESSES.Process(
            target=be_gateway, args=(self.folder, self.proxy.port, rest, told, self._allowed)
        )
        gateway.start()
        told.close()
        return gateway

    def allow(self, windows: int) -> None:
        """Let the gateway come to so many windows, however fast it is."""
        self._allowed.value = windows

    def hear(self) -> int:
        """What the gateway has told so far: how many windows are on its disk, or were."""
        try:
            while self._told.poll():
                says = self._told.recv()
                if says == "empty":
                    self.empty = True
                elif says is not None:
                    self.on_disk.append(says)
                    self._next = says + 1
        except EOFError:
            """It was killed."""
        return len(self.on_disk)

    def kill_gateway(self) -> None:
        """SIGKILL, and start it again: with the window behind the one that it may have been writing."""
        self.gateway.kill()
        self.gateway.join()
        self.hear()
        self._next += 1
        self.gateway = self._started_gateway()

    def kill_service(self) -> None:
        """SIGKILL, and start it again."""
        self.service.kill()
        self.service.join()
        self.service = self._started_service()

    def restart_service(self) -> None:
        """Stop it in good order, and start it again."""
        self.service.terminate()
        self.service.join(30)
        self.kill_service()

    def silence(self) -> None:
        """The network carries nothing for a while, and then what was said meanwhile."""
        self._silent(keeps=True)

    def forgotten(self) -> None:
        """The network carries nothing for a while, and forgets what was said."""
        self._silent(keeps=False)

    def cut(self) -> None:
        """Every connection ends."""
        self.proxy.cut()

    def _silent(self, *, keeps: bool) -> None:
        self.proxy._keeps = keeps
        self.proxy.fall_silent()
        time.sleep(SILENCE)
        self.proxy.speak()

    def end(self) -> None:
        """Kill both."""
        self.proxy.close()
        for process in (self.gateway, self.service):
            process.kill()
            process.join()


DISTURBANCES: tuple[Callable[[Plant], None], ...] = (
    Plant.kill_gateway, Plant.kill_service, Plant.restart_service, Plant.silence, Plant.forgotten,
    Plant.cut,
)  # fmt: skip


def campaign(
    windows: int,
    every: int,
    seed: int = 0,
    disturbances: tuple[Callable[[Plant], None], ...] = DISTURBANCES,
) -> dict[str, Any]:
    """Send so many windows, with a disturbance after about so many, and count."""
    chance = random.Random(seed)
    done: Counter[str] = Counter()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        DiskStore(folder / "service", url_of(folder)).close()
        plant = Plant(folder, windows)
        try:
            order: list[Callable[[Plant], None]] = []
            while plant.hear() < windows - every:
                order = order or list(disturbances)
                enough = plant.hear() + chance.randint(every // 2, 3 * every // 2)
                # each that was killed left out a window
                plant.allow(enough + done.total() + every // 2)
                wait_for(
                    lambda enough=enough: plant.hear() >= min(enough, windows - len(done)),
                    "the gateway puts no window on its disk",
                )
                disturbance = order.pop(chance.randrange(len(order)))
                disturbance(plant)
                done[disturbance.__name__] += 1
            plant.allow(windows)
            wait_for(lambda: plant.hear() and plant.empty, "windows stay in the spool")
        finally:
            plant.end()
        return {"disturbances": dict(done)} | count(folder, plant.on_disk)


def count(folder: Path, on_disk: list[int]) -> dict[str, int]:
    """What became of the windows that the gateway had on its disk."""
    store = DiskStore(folder / "service", url_of(folder))
    kept = {asset: stored(store, asset) for asset in {asset_of(number) for number in on_disk}}
    store.close()
    numbers = [int(t0) for windows in kept.values() for t0 in windows]
    return {
        "on the gateway's disk": len(on_disk),
        "stored": len(numbers),
        "lost": len(set(on_disk) - set(numbers)),
        "twice": len(numbers) - len(set(numbers)),
        "astray": sum(windows != sorted(windows) for windows in kept.values()),
        "set aside": SetAside(folder).count,
    }


def throughput(machines: int, windows: int, samples: int, workers: int) -> dict[str, Any]:
    """Empty a spool that was filled before; the windows a second."""
    with tempfile.TemporaryDirectory() as name:
        folder, port = Path(name), free_port()
        service = _PROCESSES.Process(target=be_service, args=(folder, port, workers))
        service.start()
        spool = Spool(folder / "spool", MOST)

        def emptied(count: int) -> float:
            gateway = Gateway(spool, SetAside(folder), Sending(f"http://127.0.0.1:{port}"))
            for number in range(count):
                of = machine(f"press-{number % machines}")
                gateway.handle(of, window(number, samples), None, None)  # type: ignore[arg-type]
            begun = time.monotonic()
            gateway.start()
            wait_for(lambda: not len(spool), "windows stay in the spool")
            took = time.monotonic() - begun
            gateway.stop()
            return took

        try:
            _wait(port)
            emptied(3 * machines)  # its workers are there then
            took = emptied(windows)
        finally:
            service.terminate()
            service.join(30)
            service.kill()
    return {
        "machines": machines, "windows": windows, "samples": samples, "workers": workers,
        "a second": round(windows / took, 1),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--windows", type=int, default=1000)
    parser.add_argument("--every", type=int, default=40, help="windows a disturbance, on average")
    parser.add_argument("--seed", type=int, default=0)
    known = {disturbance.__name__: disturbance for disturbance in DISTURBANCES}
    parser.add_argument("--only", nargs="+", choices=known, default=list(known))
    parser.add_argument("--throughput", action="store_true")
    parser.add_argument("--machines", type=int, default=8)
    parser.add_argument("--samples", type=int, default=500)
    parser.add_argument("--workers", type=int, default=1)
    given = parser.parse_args()
    if given.throughput:
        found = throughput(given.machines, given.windows, given.samples, given.workers)
        print(json.dumps(found))
        return
    disturbances = tuple(known[name] for name in given.only)
    found = campaign(given.windows, given.every, given.seed, disturbances)
    print(json.dumps(found))
    sys.exit(bool(found["lost"] or found["twice"] or found["astray"] or found["set aside"]))


if __name__ == "__main__":
    main()
