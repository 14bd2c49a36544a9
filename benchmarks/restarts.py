"""PostgreSQL restarts in the midst, again and again: every window that was answered with 201 is there afterwards, once.

    python -m benchmarks.restarts --restarts 100 --windows 20

A server of PostgreSQL of its own, in a folder of its own, restarted at random moments while four clients post to one service
without pause, and post anew, under the same idempotency key, what was refused or left without an answer. Three restarts in four
are immediate (as after a crash), the others orderly. The exit status is 1 when a window is lost, stored twice, or fits no row.
Needs `initdb` and `pg_ctl`, and the user `postgres` where it is run by root.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import shutil
import subprocess
import sys
import tempfile
from multiprocessing import get_context
from pathlib import Path

from benchmarks.durability import CLIENTS, Client, answers, count, serve
from benchmarks.free_port import free_port
from benchmarks.partition import wait_for

ORDERLY = 0.25
"""Share of restarts that let transactions end."""


class Server:
    """A server of PostgreSQL on a port and in a folder of its own."""

    def __init__(self, folder: Path) -> None:
        self._as = ["runuser", "-u", "postgres", "--"] if os.geteuid() == 0 else []
        self._data, self.port = folder / "data", free_port()
        folder.chmod(0o755)
        self._data.mkdir(mode=0o700)
        if self._as:
            shutil.chown(self._data, "postgres")
        self._run("initdb", "-A", "trust", "-U", "postgres", "-D")
        self._run(
            "pg_ctl",
            "-w",
            "-l",
            str(self._data / "log"),
            "-o",
            f"-p {self.port} -k ''",
            "start",
            "-D",
        )

    @property
    def url(self) -> str:
        """Of its database."""
        return f"postgresql+psycopg://postgres@127.0.0.1:{self.port}/postgres"

    def restart(self, mode: str) -> None:
        """Stop it in a mode of `pg_ctl`, and start it again."""
        self._run("pg_ctl", "-w", "-m", mode, "-l", str(self._data / "log"), "restart", "-D")

    def stop(self) -> None:
        """End it."""
        self._run("pg_ctl", "-w", "-m", "immediate", "stop", "-D")

    def _run(self, program: str, *options: str) -> None:
        known = sorted(Path("/usr/lib/postgresql").glob(f"*/bin/{program}"))
        path = shutil.which(program) or str(known[-1])
        subprocess.run(
            [*self._as, path, *options, str(self._data)],
            check=True,
            stdout=subprocess.DEVNULL,
            cwd="/",
        )


def campaign(restarts: int, per_restart: int, seed: int) -> dict[str, int]:
    """Restart the server so often, each time after about so many answers, then count."""
    moments, port = random.Random(seed), free_port()
    context = get_context("forkserver")
    with tempfile.TemporaryDirectory() as data, tempfile.TemporaryDirectory() as name:
        server = Server(Path(data))
        service = context.Process(target=serve, args=(name, server.url, port))
        clients = [Client(first, port) for first in range(CLIENTS)]
        try:
            service.start()
            for client in clients:
                client.start()
            for _ in range(restarts):
                enough = answers(clients) + moments.uniform(0.4 * per_restart, 1.6 * per_restart)
                wait_for(
                    lambda enough=enough: answers(clients) >= enough, "the service does not answer"
                )
                server.restart("fast" if moments.random() < ORDERLY else "immediate")
            for client in clients:
                client.stop()
            service.terminate()
            service.join()
            return {"restarts": restarts} | count(Path(name), server.url, clients)
        finally:
            service.kill()
            server.stop()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--restarts", type=int, default=100)
    parser.add_argument(
        "--windows", type=int, default=20, help="acknowledged windows a restart, on average"
    )
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    found = campaign(given.restarts, given.windows, given.seed)
    print(json.dumps(found))
    sys.exit(bool(found["lost"] or found["twice"] or found["wrong"]))


if __name__ == "__main__":
    main()
