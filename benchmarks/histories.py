"""A plant's history at a second a row and twenty tags: rows a second, first rows, memory; windows of many machines judged.

    python -m benchmarks.histories postgresql://postgres@127.0.0.1/plant --machines 40 --hours 6
    python -m benchmarks.histories postgresql://postgres@127.0.0.1/plant --judged --hours 8760 --every 60    # a year

Makes the table `residuum_benchmark` in that database, an empty one of your own, and drops it in the end. Each reading is a
process of its own: its peak of memory holds its imports, its time to the first rows does not. The client library alone only takes
the rows. The run that judges is killed when a third is done.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from contextlib import closing
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import psycopg

from residuum.identification.record_formats.histories import HistoryReader, windows_of

TABLE, TAGS = "residuum_benchmark", 20
WINDOW, HEALTHY = 600, 1800
"""[rows] Of a window that is judged, and of what a machine's baseline is trained from."""
BEGIN = "2026-03-01"
COLUMNS = ["u", "y", *(f"t{k}" for k in range(2, TAGS))]


def make_table(url: str, machines: int, hours: float, every: int = 1) -> int:
    """A row in so many seconds: inputs of ±1, outputs that follow them, and tags of noise; gives the number of rows."""
    others = ", ".join(f"random() AS t{k}" for k in range(2, TAGS))
    follows = "0.5 * lag(u) OVER w + 0.25 * lag(u, 2) OVER w + 0.1 * lag(u, 3) OVER w"
    with psycopg.connect(url, autocommit=True) as connection:
        connection.execute(f"DROP TABLE IF EXISTS {TABLE}")
        connection.execute("SELECT setseed(0.5)")
        made = connection.execute(
            f"CREATE UNLOGGED TABLE {TABLE} AS SELECT time, machine, u,"
            f" coalesce({follows}, 0) + 0.02 * (random() + random() + random() - 1.5) AS y, {others}"
            f" FROM (SELECT '{BEGIN}'::timestamptz + make_interval(secs => {every} * row) AS time,"
            " format('machine-%s', machine) AS machine, sign(random() - 0.5) AS u"
            f" FROM generate_series(1, {machines}) machine,"
            f" generate_series(0, {round(3600 * hours / every) - 1}) row) AS drawn"
            " WINDOW w AS (PARTITION BY machine ORDER BY time)"
        )
        connection.execute(f"CREATE INDEX ON {TABLE} (machine, time)")
        connection.execute(f"ANALYZE {TABLE}")
        return made.rowcount


def client_alone(url: str, where: str) -> dict[str, Any]:
    """Rows of a binary COPY, each taken and left."""
    columns = ", ".join(COLUMNS)
    query = f"COPY (SELECT time, {columns} FROM {TABLE} WHERE {where} ORDER BY time) TO STDOUT (FORMAT binary)"
    with psycopg.connect(url) as connection, connection.cursor() as cursor:
        begun, cpu = time.perf_counter(), time.process_time()
        with cursor.copy(query) as copy:
            rows = sum(1 for _ in copy)
        return _rates("client alone", rows, begun, cpu)


def in_windows(address: str, seconds: int, process_begun: float) -> dict[str, Any]:
    """Windows of a history, one after another."""
    begun, cpu, first, rows = time.perf_counter(), time.process_time(), 0.0, 0
    with closing(HistoryReader(address)) as history:
        for name in windows_of(f"{address}&window={seconds}"):
            rows += history.read(name).n
            first = first or time.perf_counter()
    found = _rates(f"windows of {seconds} s", rows, begun, cpu)
    return found | {"first rows [s]": round(first - process_begun, 2)}


def _rates(what: str, rows: int, begun: float, cpu: float) -> dict[str, Any]:
    return {
        "what": what,
        "rows": rows,
        "rows/s": round(rows / (time.perf_counter() - begun)),
        "rows/s of its processor time": round(rows / (time.process_time() - cpu)),
        "peak [MiB]": round(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024),
    }


def judged(url: str, machines: int, workers: int, every: int = 1) -> dict[str, Any]:
    """Windows of all machines by each one's baseline, killed when a third is done, and gone on with."""
    from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
    from residuum.identification.record_formats import read_record

    address, window = f"{url}/{TABLE}?tags=u,y", WINDOW * every
    healthy_until = (
        f"{datetime.fromisoformat(BEGIN) + timedelta(seconds=HEALTHY * every):%Y-%m-%dT%H:%M:%S}"
    )
    with tempfile.TemporaryDirectory() as name:
        folder, out = Path(name), Path(name) / "scored.jsonl"
        for machine in range(1, machines + 1):
            healthy = read_record(f"{address}&machine=machine-{machine}&end={healthy_until}")
            RobustResidual().fit([healthy]).save(folder / f"machine-{machine}.baseline")
        command = [sys.executable, "-m", "residuum", "rescore", "robust-residual"]
        command += [f"{address}&each=machine&window={window}", "--baseline", name]
        command += ["--out", str(out), "--workers", str(workers), "--json"]
        windows = len(windows_of(f"{address}&each=machine&window={window}"))
        first = subprocess.Popen(command, stderr=subprocess.DEVNULL)
        _until(lambda: out.exists() and out.read_bytes().count(b"\n") > windows / 3)
        first.kill()
        first.wait()
        left = out.read_bytes().count(b"\n")
        begun = time.perf_counter()
        again = subprocess.Popen(command, stderr=subprocess.DEVNULL, stdout=subprocess.DEVNULL)
        peaks: dict[int, int] = {}
        _until(lambda: _note_peaks(again.pid, peaks) or again.poll() is not None)
        took = time.perf_counter() - begun
        answers = [json.loads(line) for line in out.read_bytes().splitlines()]
        drawn = np.random.default_rng(0).choice(len(answers), min(200, len(answers)), replace=False)
        return {
            "windows": windows,
            "judged before the kill": left,
            "judged in the end, each once": len({answer["file"] for answer in answers}),
            "lines": len(answers),
            "of 200 drawn ones equal to each scored alone": sum(
                _alone(answers[k], folder) for k in drawn
            ),
            "windows/s after the kill, start and all": round((windows - left) / took, 1),
            "rows/s": round((windows - left) * WINDOW / took),
            "peak of a process [MiB]": max(peaks.values()) // 1024,
        }


def _alone(answer: dict[str, Any], folder: Path) -> bool:
    from residuum.diagnosis.diagnosers.robust_residual import RobustResidual
    from residuum.identification.record_formats import read_record

    machine = answer["file"].partition("machine=")[2].partition("&")[0]
    finding = RobustResidual.load(folder / f"{machine}.baseline").score(read_record(answer["file"]))
    return bool(json.loads(json.dumps(finding.to_json())) == answer["finding"])


def _note_peaks(pid: int, peaks: dict[int, int]) -> bool:
    """Peaks of a process and all that came from it [KiB]; false, so that a wait goes on."""
    listed = subprocess.run(["ps", "-eo", "pid,ppid"], capture_output=True, text=True, check=True)
    parents = {int(a): int(b) for a, b in map(str.split, listed.stdout.splitlines()[1:])}
    family = {pid}
    while more := {child for child, parent in parents.items() if parent in family} - family:
        family |= more
    for one in family:
        try:
            status = Path(f"/proc/{one}/status").read_text()
        except OSError:
            continue
        if "VmHWM:" in status:
            peaks[one] = int(status.partition("VmHWM:")[2].split()[0])
    return False


def _until(true: Callable[[], bool]) -> None:
    while not true():
        time.sleep(1)


def main() -> None:
    begun = time.perf_counter()
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("database")
    parser.add_argument("--machines", type=int, default=40)
    parser.add_argument("--hours", type=float, default=6.0)
    parser.add_argument("--every", type=int, default=1, help="seconds a row")
    parser.add_argument(
        "--judged", action="store_true", help="judge alone, of what is read say nothing"
    )
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--only", choices=["client", *map(str, (600, 3600, 86_400))])
    given = parser.parse_args()
    if given.only:
        found = (
            client_alone(given.database, "machine = 'machine-1'")
            if given.only == "client"
            else in_windows(
                f"{given.database}/{TABLE}?machine=machine-1&tags={','.join(COLUMNS)}",
                int(given.only),
                begun,
            )
        )
        print(json.dumps(found))
        return
    same = [given.database, "--machines", str(given.machines)]
    try:
        # one machine for long enough to read, then many
        if not given.judged:
            print("rows", make_table(given.database, 1, given.machines * given.hours))
        for only in () if given.judged else ("client", "600", "3600", "86400"):
            subprocess.run(
                [sys.executable, "-m", "benchmarks.histories", *same, "--only", only], check=True
            )
        print("rows", make_table(given.database, given.machines, given.hours, given.every))
        found = judged(given.database, given.machines, given.workers, given.every)
        print(json.dumps(found, indent=1))
    finally:
        with psycopg.connect(given.database, autocommit=True) as connection:
            connection.execute(f"DROP TABLE IF EXISTS {TABLE}")


if __name__ == "__main__":
    main()
