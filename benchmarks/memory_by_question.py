"""What one question, and a hundred at once, add to the memory of the service, over a database of large rows.

    python -m benchmarks.memory_by_question --rows 2000 --kilobytes 100

Findings with much evidence, windows of many channels, two with 64 MiB of samples, records with long notes and an asset each are
stored; then every list and history is asked for with its largest limit, and long signals with what is made of them. The peak of
the process's resident memory is reset before each question and read after it. The exit status is 1 when one question adds more
than 64 MiB, or a hundred add more than 256 MiB.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import threading
from collections import Counter
from http.client import HTTPConnection
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.durability import serve
from benchmarks.free_port import free_port
from benchmarks.http_cases import _wait
from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.storage import DiskStore
from residuum.service.work.loaded_modules import settle_memory
from residuum.service.work.worker_pool import give_back_large_arrays

ONE, HUNDRED = 64, 256
"""MiB that one question may add, and a hundred at once."""
LONG, CHANNELS = 64, 6
"""MiB of the samples of a long window, and its channels; beside it one of a single channel."""
QUESTIONS = (
    "assets?limit=500",
    "assets/press/findings?limit=500",
    "assets/press/windows?limit=500",
    "assets/press/indicators?limit=5000",
    "assets/press/indicators?limit=5000&from=2020-01-01",
    "assets/press/history?limit=8784",
    "assets/press/tables/findings?from=2020-01-01&to=2099-01-01",
    "records?limit=500",
    "alarms?limit=500&active=false",
    "alarms/history?limit=500",
    "audit?limit=500",
    "models?limit=500",
    "assets/press/windows/4/signal?points=20000",
    "assets/long/windows/1/signal?points=20000",
    "assets/long/windows/1/signal?points=20000&to=10",
    "assets/long/windows/1/record",
    "assets/long/windows/1/spectrum?points=20000",
    "assets/long/windows/1/kurtogram",
    "assets/long/windows/1/envelope",
    "assets/long/tables/waveform?points=20000",
    "assets/longest/windows/2/signal?points=20000",
    "assets/longest/windows/2/record",
)


def fill(data: Path, rows: int, kilobytes: int) -> None:
    """Store so many windows whose findings have so much evidence, with assets and records beside them."""
    rng = np.random.default_rng(0)
    store = DiskStore(data, f"sqlite:///{data / 'residuum.db'}")
    for asset, channels in (("long", CHANNELS), ("longest", 1)):
        long = {f"y{k}": rng.normal(size=LONG * 2**20 // 8 // channels) for k in range(channels)}
        store.add_window(
            asset, Record(long, dict.fromkeys(long, "m/s²"), 1e-4), Finding("bearing", "healthy")
        )
    del long
    numbers = rng.normal(size=1024 * kilobytes // 20).tolist()
    wide = {f"a rather long name of a channel, number {k}": rng.normal(size=16) for k in range(256)}
    record = Record(wide, dict.fromkeys(wide, "m/s²"), 1e-3, notes=("n" * 60_000,))
    for number in range(rows):
        values = {f"indicator {k}": float(k) for k in range(50)}
        finding = Finding(
            "bearing",
            "faulty",
            None,
            values,
            values,
            dict.fromkeys(values, "m/s²"),
            {"spectrum": numbers},
            "r" * 500,
        )
        store.add_window("press" if number % 2 else f"press-{number}", record, finding)
        if number % 5 == 0:
            store.add_record("r" * 200, record)
    store.close()


def peak(pid: int) -> int:
    """The largest resident memory since it was reset [MiB]."""
    status = Path(f"/proc/{pid}/status").read_text()
    return (
        int(next(line for line in status.splitlines() if line.startswith("VmHWM")).split()[1])
        // 1024
    )


def reset(pid: int) -> int:
    """Begin to look for the peak anew; gives what is resident now [MiB]."""
    Path(f"/proc/{pid}/clear_refs").write_text("5")
    return peak(pid)


def ask(port: int, question: str, seen: Counter[Any]) -> None:
    """One question by a client of its own."""
    connection = HTTPConnection("127.0.0.1", port, timeout=600)
    connection.request("GET", f"/api/v1/{question}")
    answer = connection.getresponse()
    seen[answer.status, len(answer.read()) >> 20] += 1
    connection.close()


def listed(port: int, question: str) -> int:
    """How many items a list has by all its pages."""
    count, cursor = 0, ""
    while cursor is not None:
        connection = HTTPConnection("127.0.0.1", port, timeout=600)
        connection.request("GET", f"/api/v1/{question}{cursor}")
        page = json.loads(connection.getresponse().read())
        connection.close()
        count += len(page["items"])
        cursor = None if page["next_cursor"] is None else f"&cursor={page['next_cursor']}"
    return count


def _serve(data: str, port: int) -> None:
    give_back_large_arrays()
    settle_memory()
    serve(data, "", port)


def campaign(rows: int, kilobytes: int) -> dict[str, Any]:
    """MiB added by each question, by a hundred at once, and the items of the lists by all their pages."""
    with tempfile.TemporaryDirectory() as folder:
        fill(Path(folder), rows, kilobytes)
        port = free_port()
        service = get_context("spawn").Process(target=_serve, args=(folder, port))
        service.start()
        try:
            _wait(port)
            pid, found = int(service.pid or 0), {}
            for question in QUESTIONS[-1:]:
                ask(port, question, Counter())  # what the first question of all loads
            for question in QUESTIONS:
                seen: Counter[Any] = Counter()
                before = reset(pid)
                ask(port, question, seen)
                found[question] = {"added": peak(pid) - before, "status, MiB": dict(seen)}
            seen = Counter()
            before = reset(pid)
            threads = [
                threading.Thread(target=ask, args=(port, QUESTIONS[k % len(QUESTIONS)], seen))
                for k in range(100)
            ]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join()
            found["a hundred at once"] = {
                "added": peak(pid) - before,
                "status": dict(Counter(key[0] for key in seen.elements())),
            }
            found["items"] = {
                "findings of press": listed(port, "assets/press/findings?limit=500") == rows // 2,
                "assets": listed(port, "assets?limit=500") == rows - rows // 2 + 3,
            }
            return found
        finally:
            service.kill()
            service.join()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rows", type=int, default=2000)
    parser.add_argument("--kilobytes", type=int, default=100)
    given = parser.parse_args()
    found = campaign(given.rows, given.kilobytes)
    for what, figures in found.items():
        print(f"{what:<60}{figures}")
    too_large = [
        name
        for name, each in found.items()
        if each.get("added", 0) > (HUNDRED if name.startswith("a hundred") else ONE)
    ]
    if too_large or not all(found["items"].values()):
        sys.exit(1)


if __name__ == "__main__":
    main()
