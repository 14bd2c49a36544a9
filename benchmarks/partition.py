"""PostgreSQL falls silent behind a proxy, for a while: every window is stored afterwards, once, in its order, soon.

    python -m benchmarks.partition --database postgresql+psycopg://… --seconds 5 60

A service in a process of its own, its database behind a proxy that lets nothing through for so long, once keeping what was said
in the silence and once throwing it away. Windows are sent one after the other, each until it is answered. Beside them the
service's own way of windows from buses (`JudgeAndStore`) stores into another asset. Recovered: a window that is sent after the
silence is answered with 201. The exit status is 1 when a window is lost, stored twice or out of
order, or recovery takes over 10 s.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import threading
import time
from http.client import HTTPConnection, HTTPException
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy.engine import make_url

from benchmarks.durability import serve
from benchmarks.free_port import free_port
from benchmarks.http_cases import _wait
from benchmarks.silent_proxy import SilentProxy
from residuum.identification.record import Record
from residuum.service.fieldbus.settings import MachineSettings, SourceSettings, WindowSettings
from residuum.service.machines.pipeline import JudgeAndStore
from residuum.service.storage import DiskStore

RECOVERED_WITHIN = 10.0
"""Seconds from the end of the silence."""
PATIENCE = 600.0


class Source(threading.Thread):
    """Sends windows over HTTP, numbered by their `t0`, each until it is answered; `answered` are (number, when)."""

    def __init__(self, port: int, asset: str) -> None:
        super().__init__(daemon=True)
        self.answered: list[tuple[int, float]] = []
        self.refused = 0
        self._port, self._asset, self._stopping = port, asset, threading.Event()

    def run(self) -> None:
        """Send until told to stop."""
        number = 0
        while not self._stopping.is_set():
            body = {
                "sample_time": 1e-3,
                "t0": float(number),
                "channels": {"acceleration": [0.0, 1.0] * 200},
            }
            content = json.dumps(body | {"units": {"acceleration": "m/s²"}}).encode()
            headers = {
                "Content-Type": "application/json",
                "Idempotency-Key": f"{self._asset}-{number}",
            }
            connection = HTTPConnection("127.0.0.1", self._port, timeout=60)
            try:
                connection.request(
                    "POST",
                    f"/api/v1/assets/{self._asset}/windows?diagnoser=bearing",
                    content,
                    headers,
                )
                taken = connection.getresponse().status in (200, 201)
            except (OSError, HTTPException):
                taken = False
            finally:
                connection.close()
            if taken:
                self.answered.append((number, time.monotonic()))
                number += 1
            else:
                self.refused += 1
            self._stopping.wait(0.05)

    def stop(self) -> None:
        """End with the window that is being sent."""
        self._stopping.set()
        self.join(PATIENCE)


def machine(asset: str) -> MachineSettings:
    """A machine whose windows are only recorded."""
    source = SourceSettings(kind="modbus", port=1, map="process_plant.yaml")
    return MachineSettings(
        asset=asset, diagnoser="bearing", window=WindowSettings(cut="sliding"), sources=[source]
    )


def from_the_bus(store: DiskStore, asset: str, stopped: threading.Event) -> int:
    """Store windows the way that a machine's line does, one after the other; gives how many."""
    handle, number = JudgeAndStore(None, store), 0  # type: ignore[arg-type]  # nothing is judged without a baseline
    never = threading.Event()
    while not stopped.is_set():
        handle(
            machine(asset),
            Record({"y": np.arange(8.0)}, {"y": "V"}, 1.0, t0=float(number)),
            None,
            never,
        )()
        number += 1
        stopped.wait(0.05)
    return number


def stored(store: DiskStore, asset: str) -> list[float]:
    """The `t0` of all windows of an asset, in the order in which they were stored."""
    found, cursor = [], None
    while True:
        page = store.windows(asset, cursor, 500)
        found += [window.t0 for window in page.items]
        if (cursor := page.next_cursor) is None:
            return found[::-1]


def wait_for(condition: Any, what: str) -> None:
    """Until it holds; RuntimeError after a long while."""
    end = time.monotonic() + PATIENCE
    while not condition():
        if time.monotonic() > end:
            raise RuntimeError(what)
        time.sleep(0.02)


def silence(proxy: SilentProxy, sources: list[Source], seconds: float) -> float:
    """Be silent once the sources are under way; gives the seconds from its end until each has had a window taken."""
    for source in sources:
        wait_for(
            lambda source=source: len(source.answered) > 3, "nothing is taken before the silence"
        )
    proxy.fall_silent()
    time.sleep(seconds)
    proxy.speak()
    ended = time.monotonic()
    for source in sources:
        wait_for(
            lambda source=source: source.answered[-1][1] > ended,
            "nothing is taken after the silence",
        )
    return max(min(at for _, at in source.answered if at > ended) for source in sources) - ended


def campaign(url: str, seconds: float, *, keeps: bool) -> dict[str, Any]:
    """One silence; what was answered, lost, stored twice or out of order, and how long recovery took."""
    target = make_url(url)
    proxy = SilentProxy((target.host or "127.0.0.1", target.port or 5432), keeps=keeps)
    behind = target.set(host="127.0.0.1", port=proxy.port).render_as_string(hide_password=False)
    with tempfile.TemporaryDirectory() as folder:
        port = free_port()
        service = get_context("spawn").Process(target=serve, args=(folder, behind, port))
        service.start()
        stopped, counted = threading.Event(), []
        try:
            _wait(port)
            store = DiskStore(Path(folder), behind)
            name = f"{'kept' if keeps else 'thrown'}-{seconds:g}"
            sources = [Source(port, f"{name}-{k}") for k in range(3)]
            bus = threading.Thread(
                target=lambda: counted.append(from_the_bus(store, f"{name}-bus", stopped)),
                daemon=True,
            )
            for thread in (*sources, bus):
                thread.start()
            took = silence(proxy, sources, seconds)
            for source in sources:
                source.stop()
            stopped.set()
            bus.join(PATIENCE)
            kept = {source: stored(store, source._asset) for source in sources}
            wrong = [
                source._asset
                for source in sources
                if kept[source] != [float(n) for n, _ in source.answered]
            ]
            wrong += (
                []
                if stored(store, f"{name}-bus") == [float(n) for n in range(counted[0])]
                else [f"{name}-bus"]
            )
            answered = sum(len(source.answered) for source in sources)
            refused = sum(source.refused for source in sources)
            store.close()
            return {
                "answered": answered,
                "refused": refused,
                "from the bus": counted[0],
                "wrong": wrong,
                "recovered [s]": took,
            }
        finally:
            proxy.close()
            service.kill()
            service.join()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--database", required=True)
    parser.add_argument("--seconds", type=float, nargs="+", default=[5.0, 60.0])
    given = parser.parse_args()
    failed = False
    for seconds in given.seconds:
        for keeps in (True, False):
            found = campaign(given.database, seconds, keeps=keeps)
            print(
                f"{seconds:g} s, what is said is {'kept' if keeps else 'thrown away'}: {found}",
                flush=True,
            )
            failed |= bool(found["wrong"]) or found["recovered [s]"] > RECOVERED_WITHIN
    sys.exit(int(failed))


if __name__ == "__main__":
    main()
