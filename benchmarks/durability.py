"""Acknowledged = stored: the service is killed with SIGKILL again and again; every window answered with 201 is then looked for.

    python -m benchmarks.durability --kills 1000 --windows 50 [--database postgresql+psycopg://…] [--keep FILE]

Each service is a process of its own (forked from a process that has imported everything, so that a start is quick), on a
real socket. Clients post without pause, and post anew, under the same idempotency key, what the kill left without an answer.
One kill in ten comes at a random moment of the start, the others after a random number of answers. A hundred kills share a
database and a folder; then all is counted and removed.

Lost: answered with 201 and not there, or with other samples, or with a block that differs from its checksum.
Twice: two windows under one idempotency key. Wrong: rows and blocks that do not fit each other, or a damaged database.
With --keep, every finished hundred is written to a file, and a campaign that was stopped goes on after the last of them.
"""

from __future__ import annotations

import argparse
import io
import json
import multiprocessing
import random
import sys
import tempfile
import threading
import time
from collections import Counter
from http.client import HTTPConnection, HTTPException
from multiprocessing.process import BaseProcess
from pathlib import Path

import numpy as np
import uvicorn
from sqlalchemy import func, select, text

from benchmarks.free_port import free_port
from residuum.service.app import create_app
from residuum.service.settings import load_settings
from residuum.service.storage import DiskStore
from residuum.service.storage.blocks import Blocks, BrokenBlock
from residuum.service.storage.database import Database
from residuum.service.storage.rows.block_rows import references
from residuum.service.storage.tables import assets, findings, windows
from residuum.service.work import worker_pool

ASSET = "press"
CLIENTS = 4
TOGETHER = 100
"""Kills that share a database."""
AT_START = 0.1
"""Share of kills that come while the service starts."""
PATH = f"/api/v1/assets/{ASSET}/windows?diagnoser=bearing&channel=acceleration%20%5Bm%2Fs%C2%B2%5D&sample_time=7.8125e-05"
N = 256
PATIENCE = 120.0


def serve(data: str, url: str, port: int) -> None:
    """Be the service until killed; it judges these windows itself, and a server of workers would be that of this benchmark."""
    worker_pool._begin_server = threading.Event
    app = create_app(
        load_settings(data=Path(data), database=url, port=port, workers=1, log_level="error")
    )
    uvicorn.run(app, port=port, log_config=None, access_log=False)


class Client(threading.Thread):
    """Posts windows whose samples are their numbers, each until it is answered; `answered` is number → window."""

    def __init__(self, first: int, port: int) -> None:
        super().__init__(daemon=True)
        self.answered: dict[int, int] = {}
        self.outcomes: Counter[str] = Counter()
        self._number, self._port = first, port
        self._stopping = threading.Event()

    def run(self) -> None:
        connection = HTTPConnection("127.0.0.1", self._port, timeout=30)
        again = False
        while not self._stopping.is_set():
            headers = {
                "Content-Type": "application/octet-stream",
                "Idempotency-Key": f"key-{self._number}",
            }
            try:
                connection.request("POST", PATH, _npy(self._number), headers)
                answer = connection.getresponse()
                content = answer.read()
            except (OSError, HTTPException):
                connection.close()
                again = True
                self._stopping.wait(0.005)
                continue
            if answer.status == 201:
                self.answered[self._number] = json.loads(content)["window"]["id"]
                self.outcomes["posted anew"] += again
                self._number, again = self._number + CLIENTS, False
            else:
                self.outcomes[f"status {answer.status}"] += 1

    def stop(self) -> None:
        self._stopping.set()
        self.join(60)


def hundred(url: str | None, kills: int, per_kill: int, seed: int) -> dict[str, int]:
    """Kill the service `kills` times on one database, then count."""
    moments = random.Random(seed)
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["residuum.service.app", "uvicorn"])
    port = free_port()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        url = url or f"sqlite:///{folder / 'residuum.db'}"
        clients = [Client(first, port) for first in range(CLIENTS)]
        for client in clients:
            client.start()
        for _ in range(kills):
            # no daemon: it has workers
            process = context.Process(target=serve, args=(name, url, port))
            process.start()
            try:
                _wait(process, clients, moments, per_kill)
            finally:
                process.kill()
                process.join()
        for client in clients:
            client.stop()
        found = count(folder, url, clients)
        Database(url).migrate("base")
        return {"kills": kills} | found


def _wait(
    process: BaseProcess, clients: list[Client], moments: random.Random, per_kill: int
) -> None:
    """Return at the moment of the next kill."""
    if moments.random() < AT_START:
        time.sleep(moments.uniform(0.0, 0.5))
    else:
        share = per_kill / (1 - AT_START)
        enough = answers(clients) + moments.uniform(0.4 * share, 1.6 * share)
        end = time.monotonic() + PATIENCE
        while answers(clients) < enough:
            if time.monotonic() > end or not process.is_alive():
                raise RuntimeError(
                    f"the service does not answer: {[dict(client.outcomes) for client in clients]}"
                )
            time.sleep(0.001)


def answers(clients: list[Client]) -> int:
    """How many windows were acknowledged so far."""
    return sum(len(client.answered) for client in clients)


def count(folder: Path, url: str, clients: list[Client]) -> dict[str, int]:
    """What became of the acknowledged windows, and of the rest on the disk."""
    acknowledged = {
        number: window for client in clients for number, window in client.answered.items()
    }
    outcomes = sum((client.outcomes for client in clients), Counter[str]())
    store, database, blocks = DiskStore(folder, url), Database(url), Blocks(folder / "blocks")
    with database.read() as connection:
        kept = {
            row.idempotency_key: row.id
            for row in connection.execute(select(windows.c.id, windows.c.idempotency_key)).all()
        }
        rows = connection.scalar(select(func.count()).select_from(windows)) or 0
        judged = connection.scalar(select(func.count(func.distinct(findings.c.window_id)))) or 0
        judgements = connection.scalar(select(func.count()).select_from(findings)) or 0
        counted = connection.scalar(select(assets.c.windows).where(assets.c.id == ASSET)) or 0
        held = references(connection)
        damage = _damage(database, connection)
    lost = 0
    for number, window in acknowledged.items():
        lost += not (
            kept.get(f"key-{number}") == window
            and np.all(store.window_record(ASSET, window)["acceleration"] == number)
        )
    broken = 0
    for reference in held:
        try:
            blocks.verify(reference)
        except BrokenBlock:
            broken += 1
    orphans = store.sweep()
    misfits = (
        abs(rows - judged)
        + abs(rows - judgements)
        + abs(rows - counted)
        + abs(rows - len(blocks.paths()))
    )
    store.close()
    database.close()
    return {
        "acknowledged": len(acknowledged),
        "lost": lost + broken,
        "twice": rows - len(kept) + len(acknowledged) - len(set(acknowledged.values())),
        "wrong": misfits + damage,
        "posted anew": outcomes["posted anew"],
        "stored without an answer": rows - len(acknowledged),
        "orphan blocks swept": orphans,
        "other answers": sum(
            times for what, times in outcomes.items() if what.startswith("status")
        ),
    }


def _damage(database: Database, connection: object) -> int:
    if database.url.get_backend_name() != "sqlite":
        return 0
    check = connection.execute(text("PRAGMA integrity_check")).scalars().all()
    astray = connection.execute(text("PRAGMA foreign_key_check")).all()
    return (check != ["ok"]) + len(astray)


def _npy(number: int) -> bytes:
    file = io.BytesIO()
    np.save(file, np.full(N, float(number)))
    return file.getvalue()


def campaign(
    kills: int, per_kill: int, url: str | None, seed: int, keep: Path | None
) -> dict[str, int]:
    """All hundreds together; those in the file `keep` are not done again."""
    if url and Database(url).revision() is not None:
        raise SystemExit("--database: is not empty; give one that is")
    done: list[dict[str, int]] = []
    if keep is not None and keep.exists():
        done = [json.loads(line) for line in keep.read_text().splitlines()]
    while (over := sum(hundred["kills"] for hundred in done)) < kills:
        found = hundred(url, min(TOGETHER, kills - over), per_kill, seed + len(done))
        done.append(found)
        sys.stderr.write(f"{over + found['kills']} of {kills} kills: {found}\n")
        if keep is not None:
            with keep.open("a") as file:
                file.write(json.dumps(found) + "\n")
    return dict(sum((Counter(found) for found in done), Counter[str]()))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument(
        "--windows", type=int, default=50, help="acknowledged windows a kill, on average"
    )
    parser.add_argument("--database", default=None, help="an empty database; default: SQLite")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--keep", type=Path, default=None, help="file of finished hundreds, to go on later"
    )
    given = parser.parse_args()
    found = campaign(given.kills, given.windows, given.database, given.seed, given.keep)
    for what in (
        "kills",
        "acknowledged",
        "lost",
        "twice",
        "wrong",
        "posted anew",
        "stored without an answer",
        "orphan blocks swept",
    ):
        print(f"{what:<26}{found.get(what, 0)}")
    if any(found.get(what, 0) for what in ("lost", "twice", "wrong", "other answers")):
        sys.exit(1)


if __name__ == "__main__":
    main()
