"""What a start of the service refuses, in one line and with nothing changed; and that Ctrl-C ends it whenever it comes."""

import contextlib
import os
import re
import shutil
import signal
import sqlite3
import subprocess
import sys
import time
from pathlib import Path

import httpx
import pytest
from sqlalchemy import create_engine, text

from residuum.service.cli import run
from residuum.service.storage.database import Database

COMMAND = [sys.executable, "-m", "residuum", "serve", "--port", "0"]
WINDOW = {
    "sample_time": 1e-3,
    "channels": {"acceleration": [0.0, 1.0] * 500},
    "units": {"acceleration": "m/s²"},
}
PATH = "api/v1/assets/press/windows?diagnoser=bearing"


@contextlib.contextmanager
def serving(*options):
    """A service as its own process, with its address once it is there."""
    with subprocess.Popen(
        [*COMMAND, *options], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as process:
        try:
            process.address = process.stdout.readline().split()[-1]
            yield process
        finally:
            process.kill()


def refused(capsys, *options):
    """The one line with which a start is refused."""
    assert run(["serve", "--port", "0", *options]) == 2
    says = capsys.readouterr().err
    assert says.startswith("residuum: ") and says.count("\n") == 1 and "Traceback" not in says, says
    return says


def taken_once_free(options):
    """Whether a service starts there, as soon as the system has given back what a killed one held."""
    end = time.monotonic() + 60
    while True:
        process = subprocess.Popen(
            [*COMMAND, *options], stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
        )
        with process:
            try:
                if process.stdout.readline().startswith("Residuum is at"):
                    return True
            finally:
                process.kill()
        assert time.monotonic() < end, "the killed service still holds it"


def blocks_in(folder):
    return sorted(file.name for file in folder.glob("blocks/*/*.block"))


@pytest.fixture
def filled(tmp_path):
    """A data folder with a window, left by a service that was killed."""
    folder = tmp_path / "filled"
    with serving("--data", str(folder)) as service:
        httpx.post(service.address + PATH, json=WINDOW, timeout=60).raise_for_status()
    assert blocks_in(folder)
    return folder


def test_a_second_service_on_a_data_folder_is_refused_until_the_first_has_gone(tmp_path, capsys):
    options = ("--data", str(tmp_path / "data"))
    with serving(*options) as first:
        says = refused(capsys, *options)
        assert (
            f"(process {first.pid})" in says and "runs on it already" in says and "--data" in says
        )
        first.send_signal(signal.SIGKILL)
        first.wait(60)
        assert taken_once_free(options)


def test_on_postgresql_a_copy_of_the_data_folder_is_no_way_round(
    tmp_path, capsys, new_postgresql_database
):
    url = new_postgresql_database()
    first, copy = ("--data", str(tmp_path / "data")), ("--data", str(tmp_path / "copy"))
    with serving(*first, "--database", url) as service:
        shutil.copytree(tmp_path / "data", tmp_path / "copy")
        assert "a copy of this data folder" in refused(capsys, *copy, "--database", url)
        service.send_signal(signal.SIGKILL)
        service.wait(60)
        assert taken_once_free([*copy, "--database", url])


def test_another_database_or_another_folder_is_refused_and_nothing_is_deleted(
    tmp_path, filled, capsys
):
    before = blocks_in(filled)
    for other in ("new.db", "other.db"):
        url = f"sqlite:///{tmp_path / other}"
        if other == "other.db":
            with serving("--data", str(tmp_path / "others"), "--database", url):
                """It belongs to another folder from now on."""
        says = refused(capsys, "--data", str(filled), "--database", url)
        assert "nothing was changed" in says and "--database" in says and "--data" in says
        assert run(["doctor", "--sweep", "--data", str(filled), "--database", url]) == 2
        assert "Traceback" not in capsys.readouterr().err and blocks_in(filled) == before
    says = refused(
        capsys,
        "--data",
        str(tmp_path / "empty"),
        "--database",
        f"sqlite:///{filled / 'residuum.db'}",
    )
    assert "of which none is there" in says
    with serving("--data", str(filled)) as service:
        assert (
            httpx.get(
                f"{service.address}api/v1/assets/press/windows/1/record", timeout=60
            ).status_code
            == 200
        )


def test_a_folder_of_before_there_were_identities_is_taken_up(filled):
    (filled / "identity").unlink()
    database = create_engine(f"sqlite:///{filled / 'residuum.db'}")
    with database.begin() as connection:
        connection.execute(text("DELETE FROM identity"))
    with serving("--data", str(filled)) as service:
        assert httpx.get(f"{service.address}health/ready", timeout=60).json()["status"] == "ready"
    with database.connect() as connection:
        assert (
            connection.execute(text("SELECT folder FROM identity")).scalar_one()
            == (filled / "identity").read_text().strip()
        )
    database.dispose()


def test_blocks_that_no_row_names_are_deleted_on_request_alone(filled, capsys):
    (named,) = blocks_in(filled)
    orphan = filled / "blocks" / "2020-01-01" / "left.block"
    orphan.parent.mkdir()
    orphan.write_bytes(b"half a block")
    os.utime(orphan, (time.time() - 3600,) * 2)
    with serving("--data", str(filled)):
        assert orphan.exists()
    run(["doctor", "--data", str(filled)])
    assert re.search(
        r"NOTE +signal blocks .* 1 more that no row names; `residuum doctor --sweep`",
        capsys.readouterr().out,
    )
    run(["doctor", "--sweep", "--data", str(filled)])
    assert "deleted 1 signal blocks" in capsys.readouterr().err and blocks_in(filled) == [named]


def test_a_file_for_a_folder_and_a_newer_schema_are_told_in_one_line(tmp_path, capsys):
    (tmp_path / "file").write_text("no folder")
    assert "setting data:" in refused(capsys, "--data", str(tmp_path / "file"))
    assert "setting data:" in refused(capsys, "--data", str(tmp_path / "file" / "below"))
    newer = Database(f"sqlite:///{tmp_path / 'newer' / 'residuum.db'}")
    newer.migrate()
    with newer.write() as connection:
        connection.execute(text("UPDATE alembic_version SET version_num = '9999'"))
    newer.close()
    says = refused(capsys, "--data", str(tmp_path / "newer"))
    assert "9999, is newer than this program" in says and "start the program that wrote it" in says


def test_a_damaged_database_is_refused(filled, capsys):
    file = filled / "residuum.db"
    with contextlib.closing(sqlite3.connect(file)) as database:
        database.execute("PRAGMA wal_checkpoint(TRUNCATE)")
        (size,) = database.execute("PRAGMA page_size").fetchone()
    pages = bytearray(file.read_bytes())
    for begin in range(4 * size, len(pages), size):
        pages[begin : begin + 16] = bytes(16)
    file.write_bytes(pages)
    says = refused(capsys, "--data", str(filled))
    assert "setting database:" in says and re.search("damaged|malformed", says)


def test_a_full_or_read_only_disk_is_told_in_one_line(make_disk, capsys):
    disk, remount = make_disk(2**20)
    filler = disk / "filler"
    with contextlib.suppress(OSError):
        filler.write_bytes(bytes(2**21))
    assert re.search("space|full", refused(capsys, "--data", str(disk / "data")))
    filler.unlink()
    remount(disk, "ro")
    assert "ead-only" in refused(capsys, "--data", str(disk / "data"))
    remount(disk, "rw")


def has(process, folder):
    """What tells how far a start is: a module's library in memory, then the lock, the database, the greeting."""
    with contextlib.suppress(OSError):
        return {
            "imports": "pydantic_core" in Path(f"/proc/{process.pid}/maps").read_text(),
            "lock": (folder / "service.lock").exists(),
            "database": (folder / "residuum.db").exists(),
        }
    return {}


@pytest.mark.parametrize("stage", ["imports", "lock", "database", "greeting"])
def test_an_early_interrupt_ends_it_in_one_line(tmp_path, stage):
    with subprocess.Popen(
        [*COMMAND, "--data", str(tmp_path)],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        if stage == "greeting":
            process.stdout.readline()
        end = time.monotonic() + 120
        while stage != "greeting" and not has(process, tmp_path).get(stage):
            assert process.poll() is None and time.monotonic() < end
            time.sleep(0.005)
        process.send_signal(signal.SIGINT)
        _, says = process.communicate(timeout=60)
    assert process.returncode == 130, says
    assert [line for line in says.splitlines() if not re.match(r"\d{4}-\d\d-\d\dT", line)] == [
        "residuum: interrupted"
    ]
