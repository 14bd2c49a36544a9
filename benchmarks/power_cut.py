"""Power cuts: a program's writes are recorded, forgotten from any point on what was not fsynced, and what comes up is looked at.

    python -m benchmarks.power_cut --windows 1000 --cuts 5000

Five programs: windows stored (with records, models and alarms handled between them), a backup, a restore, the migrations, a
spool. At each cut what was not synced is kept wholly, not at all, or sector by sector as chance has it, and its names likewise.

Lost: acknowledged before the cut and not there, or not as it was. Broken: a database that does not open, does not pass SQLite's
check, or has a row without its block; a backup that has its name and is not whole; a restore that is there in part; a spool that
cannot be opened. The exit status is 1 when there is one.
"""

from __future__ import annotations

import argparse
import json
import random
import shutil
import sqlite3
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.forgetful_disk import ForgetfulDisk, recorded
from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.alarms.alarm_states import AlarmEvent
from residuum.service.storage import DiskStore
from residuum.service.storage.backup import BackupReader, BadBackup, restore_backup, write_backup
from residuum.service.storage.blocks import Blocks
from residuum.service.storage.database import Database, known_revisions, newest_revision
from residuum.service.storage.rows.block_rows import references
from residuum.service.window_queue.spool import Spool

WAYS = ((0.0, 0.0), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0), (0.5, 0.5), (1.0, 0.5))
"""Parts of names and sectors, not yet synced, that a cut leaves."""


def database_of(data: Path) -> str:
    """The URL of the database in a data folder."""
    return f"sqlite:///{data / 'residuum.db'}"


def say(**told: Any) -> None:
    """Acknowledge: what is told from here on must be there whatever happens."""
    sys.stdout.write(json.dumps(told) + "\n")
    sys.stdout.flush()


def record(number: int) -> Record:
    """A short window that tells its number."""
    return Record({"y": np.full(64, float(number))}, {"y": "m/s²"}, 1e-3)


def store_windows(data: Path, count: int) -> None:
    """Store windows, and between them records, versions of a model and what an operator does."""
    store = DiskStore(data, database_of(data))
    for number in range(count):
        verdict = ("healthy", "faulty")[number // 5 % 2]
        finding = Finding("bearing", verdict, reason="-")
        window = store.add_window(
            f"press-{number % 3}", record(number), finding, f"key-{number}", "-"
        )
        say(window=window, value=number)
        if number % 10 == 3:
            say(record=store.add_record("r.csv", record(number)), value=number)
        if number % 10 == 5:
            say(
                model=store.add_model_version("drive", "physical", b"%d" % number).number,
                content=str(number),
            )
        if number % 10 == 7 and (page := store.alarms().items):
            alarm = store.operate_alarm(
                page[0].id, AlarmEvent.SUPPRESS if number % 20 == 7 else AlarmEvent.RELEASE
            )
            say(alarm=alarm.id, entries=len(store.alarm_journal(alarm.id, 10**6)))
    store.close()


def back_up(data: Path, _count: int) -> None:
    """Back up the folder `data` beside it."""
    database = Database(database_of(data))
    write_backup(database, data / "blocks", data / "saved")
    say(backup=True)
    database.close()


def bring_back(data: Path, _count: int) -> None:
    """Restore the backup `saved` into a new folder."""
    database = Database(database_of(data / "new"))
    restore_backup(data / "saved", database, data / "new" / "blocks")
    say(restored=True)
    database.close()


def migrate(data: Path, _count: int) -> None:
    """Up to the newest schema, down to the first with rows, and up again."""
    database = Database(database_of(data))
    for revision in ("head", f"-{len(known_revisions()) - 1}", "head"):
        database.migrate(revision)
        say(revision=revision)
    database.close()


def spool(data: Path, count: int) -> None:
    """Put messages into a spool, and let every third go."""
    kept = Spool(data / "spool", 2**30)
    for number in range(count):
        key = kept.put(b"%d" % number, "press")
        say(put=key, value=number)
        if number % 3 == 2:
            say(gone=key)
            kept.remove(key)


Program = Callable[[Path, int], None]
PROGRAMS: dict[str, Program] = {
    "windows": store_windows,
    "backup": back_up,
    "restore": bring_back,
    "migration": migrate,
    "spool": spool,
}


def prepared(name: str, folder: Path) -> None:
    """What is in a folder, and on its disk, before a program runs in it."""
    if name in ("backup", "restore", "migration"):
        store_windows_silently(folder, 30)
    if name == "restore":
        back_up_silently(folder)
        for each in ("residuum.db", "residuum.db-wal", "residuum.db-shm"):
            (folder / each).unlink(missing_ok=True)
        shutil.rmtree(folder / "blocks")
    if name == "migration":
        database = Database(database_of(folder))
        database.migrate(f"-{len(known_revisions()) - 1}")
        database.close()


def store_windows_silently(folder: Path, count: int) -> None:
    """Windows that were there before."""
    store = DiskStore(folder, database_of(folder))
    for number in range(count):
        store.add_window(
            "press-0",
            record(number),
            Finding("bearing", "faulty", reason="-"),
            f"key-{number}",
            "-",
        )
    store.close()


def back_up_silently(folder: Path) -> None:
    """A backup that was there before."""
    database = Database(database_of(folder))
    write_backup(database, folder / "blocks", folder / "saved")
    database.close()


def trouble(name: str, folder: Path, told: Sequence[dict[str, Any]], *, wholly: bool) -> str | None:
    """What is wrong with what a cut left, None when nothing is. `wholly`: opened by the service's own store, too."""
    if name == "spool":
        return _trouble_of_spool(folder / "spool", told)
    if name == "backup":
        return _trouble_of_backup(folder / "saved", told) or _trouble_of_store(
            folder, [], wholly=wholly
        )
    if name == "restore":
        return _trouble_of_restore(folder / "new", told, wholly=wholly)
    found = _trouble_of_store(folder, told, wholly=wholly)
    if found is None and name == "migration":
        with closing(sqlite3.connect(folder / "residuum.db")) as connection:
            if (count := connection.execute("SELECT count(*) FROM windows").fetchone()[0]) != 30:
                return f"lost: {30 - count} rows of 30"
    return found


def _trouble_of_store(folder: Path, told: Sequence[dict[str, Any]], *, wholly: bool) -> str | None:
    file = folder / "residuum.db"
    if not file.exists():
        return f"lost: the database, and {len(told)} that it had acknowledged" if told else None
    if wholly:
        try:
            DiskStore(folder, database_of(folder)).close()
        except Exception as error:
            return f"broken: {type(error).__name__}: {error}"
    with closing(sqlite3.connect(file)) as connection:
        try:
            if (says := connection.execute("PRAGMA integrity_check(1)").fetchone()[0]) != "ok":
                return f"broken: {says}"
            if connection.execute("PRAGMA foreign_key_check").fetchone():
                return "broken: a row points to none"
            tables = {row[0] for row in connection.execute("SELECT name FROM sqlite_master")}
            return (
                _lost(connection, folder / "blocks", told)
                if "windows" in tables
                else f"lost: {told[0]}"
                if told
                else None
            )
        except sqlite3.DatabaseError as error:
            return f"broken: {error}"


def _lost(
    connection: sqlite3.Connection, blocks: Path, told: Sequence[dict[str, Any]]
) -> str | None:
    kept = Blocks(blocks)
    values: dict[str, dict[int, float]] = {}
    for table in ("windows", "records"):
        rows = connection.execute(f"SELECT id, block_path FROM {table}").fetchall()
        try:
            values[table] = {number: float(kept.read(path)["y"][0]) for number, path in rows}
        except Exception as error:
            return f"broken: a row of {table} without its block: {error}"
    models = dict(connection.execute("SELECT number, content FROM model_versions").fetchall())
    journal = dict(
        connection.execute(
            "SELECT alarm_id, count(*) FROM alarm_journal GROUP BY alarm_id"
        ).fetchall()
    )
    for each in told:
        there = (
            values["windows"].get(each["window"]) == each["value"]
            if "window" in each
            else values["records"].get(each["record"]) == each["value"]
            if "record" in each
            else models.get(each["model"], b"").decode() == each["content"]
            if "model" in each
            else journal.get(each["alarm"], 0) >= each["entries"]
            if "alarm" in each
            else True
        )
        if not there:
            return f"lost: {each}"
    return None


def _trouble_of_backup(file: Path, told: Sequence[dict[str, Any]]) -> str | None:
    if not file.exists():
        return "lost: the backup" if told else None
    try:
        BackupReader().read(file)
    except BadBackup as error:
        return f"broken: {error}"
    return None


def _trouble_of_restore(
    folder: Path, told: Sequence[dict[str, Any]], *, wholly: bool
) -> str | None:
    if (found := _trouble_of_store(folder, [], wholly=wholly)) is not None or not folder.exists():
        return found or ("lost: the restored" if told else None)
    if not (folder / "residuum.db").exists():
        return "lost: the restored" if told else None
    database = Database(database_of(folder))
    try:
        rows = len(references_of(database)) if database.revision() is not None else 0
    finally:
        database.close()
    if rows not in (0, 30) or (told and rows != 30):
        return f"{'lost' if told else 'broken'}: {rows} of 30 windows restored"
    return None


def references_of(database: Database) -> Sequence[Any]:
    """The blocks that rows point to."""
    with database.read() as connection:
        return references(connection) if database.revision() == newest_revision() else []


def _trouble_of_spool(folder: Path, told: Sequence[dict[str, Any]]) -> str | None:
    if not folder.exists():
        return "lost: the spool" if told else None
    try:
        kept = Spool(folder, 2**30)
    except Exception as error:
        return f"broken: {error}"
    gone = {each["gone"] for each in told if "gone" in each}
    for each in told:
        if (
            "put" in each
            and each["put"] not in gone
            and kept.read(each["put"]) != b"%d" % each["value"]
        ):
            return f"lost: {each}"
    return None


def campaign(name: str, count: int, cuts: int, seed: int = 0) -> Counter[str]:
    """Record one program, cut it so many times, and count what came of it."""
    chance = random.Random(f"{seed} {name}")
    outcomes: Counter[str] = Counter()
    with tempfile.TemporaryDirectory(prefix="residuum-power-") as place:
        root, before, log = (Path(place) / each for each in ("data", "before", "log"))
        root.mkdir()
        prepared(name, root)
        shutil.copytree(root, before)
        module = [
            "-m",
            "benchmarks.power_cut",
            "--be",
            name,
            "--windows",
            str(count),
            "--data",
            str(root),
        ]
        operations = recorded(module, root, log)
        log.unlink()
        disk, told = ForgetfulDisk(root), []
        disk.begin_with(before)
        places = sorted(chance.sample(range(len(operations)), min(cuts, len(operations))))
        ways = max(1, -(-cuts // len(operations)))
        for number, operation in enumerate(operations):
            disk.do(operation)
            if operation.kind == "said":
                told += [json.loads(line) for line in operation.data.decode().splitlines()]
            if places and places[0] == number:
                places.pop(0)
                for way in chance.sample(WAYS, min(ways, len(WAYS))):
                    outcomes[_cut(name, disk, told, way, chance)] += 1
        outcomes["operations"], outcomes["acknowledged"] = len(operations), len(told)
    return outcomes


def _cut(
    name: str,
    disk: ForgetfulDisk,
    told: Sequence[dict[str, Any]],
    way: tuple[float, float],
    chance: random.Random,
) -> str:
    with tempfile.TemporaryDirectory(prefix="residuum-power-") as left:
        disk.cut(Path(left), *way, chance)
        found = trouble(name, Path(left), told, wholly=chance.random() < 0.02)
    if found is not None:
        sys.stderr.write(
            f"{name}, {way} of what was not synced, after {len(told)} acknowledged: {found}\n"
        )
    return "right" if found is None else found.split(":")[0]


def main(arguments: list[str]) -> int:
    """Run all, or be one of the programs; 1 when something was lost or broken."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--windows", type=int, default=1000)
    parser.add_argument(
        "--cuts",
        type=int,
        default=5000,
        help="of the windows; the other programs get a fifth of it each",
    )
    parser.add_argument("--be", choices=PROGRAMS)
    parser.add_argument("--data", type=Path)
    chosen = parser.parse_args(arguments)
    if chosen.be is not None:
        PROGRAMS[chosen.be](chosen.data, chosen.windows)
        return 0
    print(
        "| program | steps | acknowledged | cuts | right | lost | broken |\n|---|---|---|---|---|---|---|"
    )
    wrong = 0
    for name in PROGRAMS:
        found = campaign(
            name, chosen.windows, chosen.cuts if name == "windows" else chosen.cuts // 5
        )
        cuts = found["right"] + found["lost"] + found["broken"]
        wrong += cuts - found["right"]
        columns = (
            name,
            found["operations"],
            found["acknowledged"],
            cuts,
            found["right"],
            found["lost"],
            found["broken"],
        )
        print("|", " | ".join(map(str, columns)), "|", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
