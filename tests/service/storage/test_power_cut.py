"""After a power cut all that was acknowledged is there: a short version of `python -m benchmarks.power_cut`, and its disk."""

import os
import random
import shutil

import pytest

from benchmarks import power_cut
from benchmarks.forgetful_disk import ForgetfulDisk, Operation, recorded
from residuum.service.storage.durable_folder import make_folder


@pytest.fixture(scope="module")
def strace():
    """Skips loudly where programs cannot be traced; fails where CI may install what is needed."""
    if shutil.which("strace") is None:
        message = (
            "NO STRACE HERE, so power cuts were not tested; sh tests/system_packages.sh installs it"
        )
        if os.environ.get("CI") and os.getuid() == 0:
            pytest.fail(message)
        pytest.skip(message)


@pytest.mark.parametrize("name", list(power_cut.PROGRAMS))
def test_whenever_the_power_goes_nothing_acknowledged_is_lost_and_nothing_is_broken(strace, name):
    found = power_cut.campaign(name, count=12, cuts=40, seed=1)
    assert (
        found["lost"] == found["broken"] == 0 and found["right"] >= 40 and found["acknowledged"] > 0
    )


CARELESS = """
import json, os, sys
from pathlib import Path
folder = Path(sys.argv[1]) / "kept"
folder.mkdir()
with (folder / "a").open("wb") as file:
    file.write(b"0123456789" * 100)
    file.flush()
    os.fsync(file.fileno())
handle = os.open(folder, os.O_RDONLY)
os.fsync(handle)
print("done", flush=True)
os.truncate(folder / "a", 10)
(folder / "a").rename(folder / "b")
"""


def left(disk, folder, names, sectors):
    folder.mkdir()
    disk.cut(folder, names, sectors, random.Random(0))
    return {
        str(place.relative_to(folder)): place.read_bytes()
        for place in folder.rglob("*")
        if place.is_file()
    }


def test_the_log_of_a_program_holds_what_it_did_in_its_order(strace, tmp_path):
    (tmp_path / "root").mkdir()
    steps = recorded(["-c", CARELESS, str(tmp_path / "root")], tmp_path / "root", tmp_path / "log")
    kinds = [step.kind for step in steps]
    assert [kind for kind, before in zip(kinds, ["", *kinds], strict=False) if kind != before or kind == "sync"] == [
        "folder", "create", "truncate", "write", "sync", "sync", "said", "truncate", "rename",
    ]  # fmt: skip
    assert b"".join(step.data for step in steps if step.kind == "said") == b"done\n"
    (written,) = [step for step in steps if step.kind == "write"]
    assert written.data == b"0123456789" * 100 and written.offset == 0


def test_a_file_whose_folder_was_not_synced_may_be_gone(tmp_path):
    """And so this disk finds what `make_folder` is for."""
    root = tmp_path / "root"
    disk = ForgetfulDisk(root)
    for step in (
        Operation("folder", f"{root}/kept"),
        Operation("create", f"{root}/kept/a"),
        Operation("write", f"{root}/kept/a", 0, b"x" * 2000),
        Operation("sync", f"{root}/kept/a"),
        Operation("sync", f"{root}/kept"),
    ):
        disk.do(step)
    assert left(disk, tmp_path / "1", 0.0, 0.0) == {} and left(disk, tmp_path / "2", 1.0, 0.0) == {
        "kept/a": b"x" * 2000
    }
    disk.do(Operation("sync", str(root)))
    assert left(disk, tmp_path / "3", 0.0, 0.0) == {"kept/a": b"x" * 2000}


def test_what_was_not_synced_is_kept_sector_by_sector_as_chance_has_it(tmp_path):
    root = tmp_path / "root"
    disk = ForgetfulDisk(root)
    for step in (
        Operation("create", f"{root}/a"),
        Operation("write", f"{root}/a", 0, b"o" * 4096),
        Operation("sync", f"{root}/a"),
        Operation("sync", str(root)),
        Operation("write", f"{root}/a", 100, b"n" * 3000),
        Operation("rename", f"{root}/a", target=f"{root}/b"),
    ):
        disk.do(step)
    assert left(disk, tmp_path / "1", 0.0, 0.0) == {"a": b"o" * 4096}
    assert left(disk, tmp_path / "2", 1.0, 1.0) == {"b": b"o" * 100 + b"n" * 3000 + b"o" * 996}
    (torn,) = left(disk, tmp_path / "3", 1.0, 0.5).values()
    sectors = [torn[max(100, begin) : min(3100, begin + 512)] for begin in range(0, 4096, 512)]
    assert all(len(set(sector)) <= 1 for sector in sectors) and {b"o", b"n"} <= {
        sector[:1] for sector in sectors
    }


def test_a_folder_is_made_with_those_above_it_and_each_is_synced(tmp_path, monkeypatch):
    synced = []
    monkeypatch.setattr("residuum.service.storage.durable_folder.sync_folder", synced.append)
    make_folder(tmp_path / "a" / "b" / "c")
    assert (tmp_path / "a" / "b" / "c").is_dir() and synced == [
        tmp_path,
        tmp_path / "a",
        tmp_path / "a" / "b",
    ]
    make_folder(tmp_path / "a" / "b" / "c")
    assert len(synced) == 3
