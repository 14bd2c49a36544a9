"""A service on the wrong database, folder, clock or disk: nothing is deleted, and it is refused or degraded in one line.

    python -m benchmarks.misplaced --runs 10

Each run has a data folder with so many acknowledged windows. Begun on another database, an empty one or an empty folder, the
service must end with one line. With a clock two years ahead or behind it must keep every signal, and ahead say why. Where folder
or database file is moved, the disk is full or read-only while clients post, it must refuse, say so at `/health/ready` in one
line, and go on once that has passed. After each run every window that was answered with 201 is looked for. The exit status is 1
when one is lost, or nothing was said. Full and read-only disks need the right to mount one.
"""

from __future__ import annotations

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from datetime import UTC, datetime, timedelta
from http.client import HTTPConnection
from multiprocessing import get_context
from multiprocessing.process import BaseProcess
from pathlib import Path

from benchmarks.durability import CLIENTS, Client, answers, count
from benchmarks.free_port import free_port
from benchmarks.partition import wait_for
from residuum.service import cli
from residuum.service.storage import disk_store
from residuum.service.work import worker_pool

TWO_YEARS = 730
DISK = 3 * 2**20
_context = get_context("forkserver")


def be(arguments: list[str], days: int, told: str) -> None:
    """Be the command, by a clock that is wrong by so many days; what it writes goes into a file."""
    said = os.open(told, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
    os.dup2(said, 1)
    os.dup2(said, 2)
    if days:
        disk_store._now = lambda: datetime.now(UTC) + timedelta(days=days)
    os.environ["RESIDUUM_LOG_LEVEL"], os.environ["RESIDUUM_WORKERS"] = "error", "1"
    worker_pool._begin_server = threading.Event  # as in benchmarks.durability
    sys.exit(cli.run(["serve", *arguments]))


class Plant:
    """A data folder, its database, and clients whose windows are known."""

    def __init__(self, folder: Path, chance: random.Random, data: Path | None = None) -> None:
        self.folder, self.data = folder, data or folder / "data"
        self.file = folder / "database" / "residuum.db"
        self.file.parent.mkdir(exist_ok=True)
        self.port = free_port()
        self.clients = [Client(first, self.port) for first in range(CLIENTS)]
        self.enough = chance.randint(5, 60)
        self._told = folder / "told"

    @property
    def url(self) -> str:
        """Of its database."""
        return f"sqlite:///{self.file}"

    def begin(
        self, days: int = 0, data: Path | None = None, file: Path | None = None
    ) -> BaseProcess:
        """The service, on these or on its own."""
        arguments = [
            "--data",
            data or self.data,
            "--database",
            f"sqlite:///{file or self.file}",
            "--port",
            self.port,
        ]
        process = _context.Process(target=be, args=([*map(str, arguments)], days, str(self._told)))
        process.start()
        return process

    def fill(self) -> None:
        """Post until enough is acknowledged, and end everything in good order."""
        with self.posting():
            self.wait_for_more(self.enough)

    @contextmanager
    def posting(self, days: int = 0) -> Iterator[None]:
        """With the service and clients that post."""
        process = self.begin(days)
        for client in self.clients:
            client.start()
        try:
            yield
        finally:
            for client in self.clients:
                client.stop()
            process.terminate()
            process.join(60)
            process.kill()

    def wait_for_more(self, windows: int) -> None:
        """Until so many more windows are acknowledged."""
        there = answers(self.clients)
        wait_for(lambda: answers(self.clients) >= there + windows, "the service does not answer")

    def refused(self) -> Counter[str]:
        """How often the clients were refused, by status."""
        outcomes = sum((client.outcomes for client in self.clients), Counter[str]())
        return Counter(
            {what: times for what, times in outcomes.items() if what.startswith("status")}
        )

    def ready(self) -> tuple[int, str]:
        """What the service says of itself."""
        connection = HTTPConnection("127.0.0.1", self.port, timeout=60)
        connection.request("GET", "/health/ready")
        answer = connection.getresponse()
        found = answer.status, json.loads(answer.read()).get("detail", "")
        connection.close()
        return found

    def refuses_to_start(self, **where: Path) -> bool:
        """Whether a start there ends by itself, with one line, and changes nothing in the data folder."""
        before = blocks(self.data)
        process = self.begin(**where)
        process.join(60)
        ended = process.exitcode == 2
        process.kill()
        process.join()
        lines = self._told.read_text().splitlines()
        return (
            ended
            and len(lines) == 1
            and lines[0].startswith("residuum: ")
            and blocks(self.data) == before
        )

    def lost(self) -> int:
        """Windows that were acknowledged and are not there, or twice, or with other samples."""
        found = count(self.data, self.url, self.clients)
        return found["lost"] + found["twice"] + found["wrong"]


def blocks(folder: Path) -> dict[str, int]:
    """The signal blocks of a folder, with their sizes."""
    return {str(file): file.stat().st_size for file in folder.glob("blocks/*/*.block")}


def other_database(plant: Plant, chance: random.Random) -> bool:
    """Begin on a database that belongs to another folder."""
    plant.fill()
    other = plant.folder / "other"
    other.mkdir()
    another = Plant(other, chance)
    another.fill()
    return plant.refuses_to_start(file=another.file)


def empty_database(plant: Plant, _chance: random.Random) -> bool:
    """Begin on a database that is not there yet."""
    plant.fill()
    return plant.refuses_to_start(file=plant.folder / "new.db")


def empty_folder(plant: Plant, _chance: random.Random) -> bool:
    """Begin on a data folder that is not there."""
    plant.fill()
    return plant.refuses_to_start(data=plant.folder / "new")


def clock(days: int) -> Callable[[Plant, random.Random], bool]:
    """Begin with a clock that is wrong, for long enough that what is old goes; it says so where anything is."""

    def wrong(plant: Plant, _chance: random.Random) -> bool:
        plant.fill()
        before, process = blocks(plant.data), plant.begin(days)
        try:
            wait_for(lambda: answers_at(plant.port), "the service does not start")
            time.sleep(3.0)
            return set(before) <= set(blocks(plant.data)) and (
                days < 0 or "clock says" in status(plant.port)
            )
        finally:
            process.terminate()
            process.join(60)

    return wrong


def while_running(
    harm: Callable[[Plant], None], mend: Callable[[Plant], None]
) -> Callable[[Plant, random.Random], bool]:
    """Something happens while clients post, and passes."""

    def happens(plant: Plant, _chance: random.Random) -> bool:
        with plant.posting():
            plant.wait_for_more(plant.enough)
            before = sum(plant.refused().values())
            harm(plant)
            wait_for(lambda: sum(plant.refused().values()) > before + CLIENTS, "nothing is refused")
            time.sleep(1.1)  # readiness is looked at once a second
            code, says = plant.ready()
            mend(plant)
            plant.wait_for_more(5)
        return (
            code in (503, 507)
            and bool(says)
            and "\n" not in says
            and set(plant.refused()) <= {"status 503", "status 507"}
        )

    return happens


def move(what: Callable[[Plant], Path], *, back: bool) -> Callable[[Plant], None]:
    """Move a file or folder away, or back."""

    def moved(plant: Plant) -> None:
        here, away = what(plant), plant.folder / "elsewhere"
        os.rename(*((away, here) if back else (here, away)))

    return moved


def remount(below: str, how: str) -> Callable[[Plant], None]:
    """Change the disk of a folder of the data, as soon as no file there is just being written."""

    def changed(plant: Plant) -> None:
        command = ["mount", "-o", f"remount,{how}", str(plant.data / below)]
        wait_for(
            lambda: not subprocess.run(command, capture_output=True, check=False).returncode,
            f"cannot be done: {command}",
        )

    return changed


def fill_up(plant: Plant) -> None:
    """Take the rest of the disk, but for some windows."""
    with open(plant.data / "ballast", "wb") as file:
        free = os.statvfs(plant.data)
        file.write(bytes(max(0, free.f_bavail * free.f_frsize - 2**16)))


CASES: dict[str, tuple[str | None, Callable[[Plant, random.Random], bool]]] = {
    "another database": (None, other_database),
    "an empty database": (None, empty_database),
    "an empty data folder": (None, empty_folder),
    "data folder moved while it runs": (
        None,
        while_running(
            move(lambda plant: plant.data, back=False), move(lambda plant: plant.data, back=True)
        ),
    ),
    "database file moved while it runs": (
        None,
        while_running(
            move(lambda plant: plant.file, back=False), move(lambda plant: plant.file, back=True)
        ),
    ),
    "clock two years ahead": (None, clock(TWO_YEARS)),
    "clock two years behind": (None, clock(-TWO_YEARS)),
    "full disk": ("", while_running(fill_up, remount("", f"size={16 * DISK}"))),
    "read-only folder": ("blocks", while_running(remount("blocks", "ro"), remount("blocks", "rw"))),
}
"""What goes wrong; which folder of the data needs a disk of its own, if any (the data folder itself holds a lock open)."""


@contextmanager
def disk(folder: Path, below: str | None) -> Iterator[Path | None]:
    """A data folder that is, or has at a folder below, a small file system; None: no data folder of a special kind."""
    if below is None:
        yield None
        return
    place = folder / "disk" / below
    place.mkdir(parents=True)
    subprocess.run(["mount", "-t", "tmpfs", "-o", f"size={DISK}", "tmpfs", str(place)], check=True)
    try:
        yield folder / "disk"
    finally:
        subprocess.run(["umount", "--lazy", str(place)], check=True)


def answers_at(port: int) -> bool:
    """Whether a service is there."""
    try:
        connection = HTTPConnection("127.0.0.1", port, timeout=10)
        connection.request("GET", "/health/live")
        return connection.getresponse().status == 200
    except OSError:
        return False


def status(port: int) -> str:
    """What a service says of its state."""
    connection = HTTPConnection("127.0.0.1", port, timeout=60)
    connection.request("GET", "/health/ready")
    found = connection.getresponse().read().decode()
    connection.close()
    return found


def campaign(cases: list[str], runs: int, seed: int) -> dict[str, Counter[str]]:
    """Of each case: runs, windows that were acknowledged, those lost, and runs in which it was said in one line."""
    _context.set_forkserver_preload(
        ["residuum.service.app", "residuum.service.commands.serve", "uvicorn"]
    )
    chance = random.Random(seed)
    found: dict[str, Counter[str]] = {}
    for case in cases:
        below, happens = CASES[case]
        found[case] = Counter(runs=0, acknowledged=0, lost=0, said=0)
        for _ in range(runs):
            with tempfile.TemporaryDirectory() as name, disk(Path(name), below) as place:
                plant = Plant(Path(name), chance, place)
                said = happens(plant, chance)
                found[case].update(
                    runs=1, acknowledged=answers(plant.clients), lost=plant.lost(), said=said
                )
        print(f"{case:<36}{dict(found[case])}", flush=True)
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=10)
    parser.add_argument("--case", choices=CASES, action="append")
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    found = campaign(given.case or list(CASES), given.runs, given.seed)
    sys.exit(any(each["lost"] or each["said"] < each["runs"] for each in found.values()))


if __name__ == "__main__":
    main()
