"""A backup brings back all of it, between SQLite and PostgreSQL too, and a damaged one is refused as a whole."""

import io
import json
import tarfile
import uuid

import numpy as np
import pytest

from residuum.diagnosis.finding import Finding
from residuum.identification.record import Record
from residuum.service.cli import run
from residuum.service.storage import DiskStore
from residuum.service.storage.retention import Retention


@pytest.fixture
def make_url(tmp_path, request):
    """URLs of new databases of either kind; those of PostgreSQL are dropped in the end."""

    def make(kind):
        if kind == "sqlite":
            return f"sqlite:///{tmp_path / uuid.uuid4().hex}.db"
        return request.getfixturevalue("new_postgresql_database")()

    return make


def fill(folder, url):
    store = DiskStore(folder, url)
    for number, verdict in enumerate(("healthy", "healthy", "faulty", "not-assessable")):
        record = Record({"y": np.arange(100.0) + number}, {"y": "m/s²"}, 1e-3, t0=0.1)
        found = Finding(
            "bearing",
            verdict,
            fault_class="ball" if verdict == "faulty" else None,
            indicators={"rms": 0.1},
            reason="-",
        )
        store.add_window("press", record, found, f"key-{number}", "digest")
    store.add_record("a.csv", Record({"u": [0.5, np.nan]}, {"u": "V"}, 0.1))
    store.add_model_version("drive", "physical", bytes(range(256)), "first")
    store.retain(Retention(float("inf"), 1300))
    store.close()


def everything(folder, url):
    """All that a store tells, with the samples."""
    store = DiskStore(folder, url)
    windows = store.windows("press").items
    signals = {
        window.id: None
        if window.signal_let_go_at
        else store.window_record("press", window.id)["y"].tolist()
        for window in windows
    }
    told = (
        windows, signals, store.findings("press").items, store.assets().items, store.alarms(active=False).items,
        [store.alarm_journal(alarm.id) for alarm in store.alarms(active=False).items], store.records().items,
        store.record_samples(1)["u"][0], store.model_versions("drive"), store.model_content("drive"),
    )  # fmt: skip
    new = store.add_window(
        "press",
        Record({"y": [1.0, 2.0]}, {"y": "m/s²"}, 1e-3),
        Finding("bearing", "healthy", reason="-"),
    )
    assert new == max(signals) + 1
    store.close()
    return told


@pytest.mark.parametrize(
    ("source", "target"), [("sqlite", "sqlite"), ("sqlite", "postgresql"), ("postgresql", "sqlite")]
)
def test_all_comes_back(tmp_path, make_url, capsys, source, target):
    urls = make_url(source), make_url(target)
    fill(tmp_path / "old", urls[0])
    file = tmp_path / "plant.backup"
    assert (
        run(["backup", str(file), "--data", str(tmp_path / "old"), "--database", urls[0], "--json"])
        == 0
    )
    written = json.loads(capsys.readouterr().out)
    assert written["rows"]["windows"] == 4 and 1 < written["blocks"] < 5
    assert run(["restore", str(file), "--data", str(tmp_path / "new"), "--database", urls[1]]) == 0
    assert "Verified and restored" in capsys.readouterr().out
    assert everything(tmp_path / "new", urls[1]) == everything(tmp_path / "old", urls[0])


@pytest.fixture
def backup(tmp_path):
    fill(tmp_path / "old", f"sqlite:///{tmp_path / 'old' / 'residuum.db'}")
    assert run(["backup", str(tmp_path / "b"), "--data", str(tmp_path / "old")]) == 0
    return tmp_path / "b"


def refused(capsys, folder, *arguments):
    assert run([*map(str, arguments), "--data", str(folder)]) == 2
    return capsys.readouterr().err


def test_whatever_bit_flips_what_comes_back_is_right_or_nothing(tmp_path, backup, capsys):
    content = backup.read_bytes()
    right = everything(tmp_path / "old", f"sqlite:///{tmp_path / 'old' / 'residuum.db'}")
    rng = np.random.default_rng(7)
    places = rng.choice(len(content.rstrip(b"\0")), size=80, replace=False)
    unharmed = 0
    for number, place in enumerate(places):
        damaged = bytearray(content)
        damaged[place] ^= 0x10
        backup.write_bytes(damaged)
        new = tmp_path / f"new-{number}"
        # padding, or a field of the tar header that says nothing
        if run(["restore", str(backup), "--data", str(new)]) == 0:
            unharmed += 1
            assert everything(new, f"sqlite:///{new / 'residuum.db'}") == right
        else:
            assert not list(new.glob("blocks/*/*"))
    assert unharmed < len(places) / 2
    backup.write_bytes(content[: len(content) // 2])
    assert "not a whole backup" in refused(capsys, tmp_path / "half", "restore", backup)


def test_a_member_outside_the_folder_is_refused(tmp_path, capsys):
    evil = tmp_path / "evil.backup"
    with tarfile.open(evil, "w") as archive:
        archive.addfile(tarfile.TarInfo("blocks/../../evil.block"), io.BytesIO())
    assert "does not belong into a backup" in refused(capsys, tmp_path / "new", "restore", evil)
    assert not list(tmp_path.rglob("evil.block"))


def test_nothing_is_overwritten_and_no_broken_block_is_backed_up(tmp_path, backup, capsys):
    assert "never replaces" in refused(capsys, tmp_path / "old", "backup", backup)
    assert "not empty" in refused(capsys, tmp_path / "old", "restore", backup)
    block = sorted(tmp_path.glob("old/blocks/*/*.block"))[0]
    block.write_bytes(block.read_bytes()[:-1] + b"x")
    assert f"{block.name} differs from its checksum" in refused(
        capsys, tmp_path / "old", "backup", tmp_path / "c"
    )
    block.unlink()
    assert f"{block.name}: is missing" in refused(
        capsys, tmp_path / "old", "backup", tmp_path / "c"
    )
    assert not list(tmp_path.glob("c*"))


def test_the_settings_and_what_they_name_come_back_beside_the_data(tmp_path, capsys, monkeypatch):
    fill(tmp_path / "data", f"sqlite:///{tmp_path / 'data' / 'residuum.db'}")
    (tmp_path / "hall 1").mkdir()
    bus, file = tmp_path / "hall 1" / "press map.yaml", tmp_path / "settings.yaml"
    bus.write_text("streams: {}\n")
    machine = {
        "asset": "press",
        "diagnoser": "robust-residual",
        "window": {"cut": "sliding"},
        "sources": [{"kind": "modbus", "host": "127.0.0.1", "map": str(bus)}],
    }
    file.write_text(
        json.dumps({"port": 9000, "mqtt": "mqtt://plant:secret@broker", "machines": [machine]})
    )
    monkeypatch.delenv("RESIDUUM_SETTINGS", raising=False)
    monkeypatch.setenv("RESIDUUM_SETTINGS", str(file))
    saved, back = tmp_path / "saved", tmp_path / "back"
    left = tmp_path / "saved.unfinished"  # of a backup that was killed, open to all
    left.write_bytes(b"")
    left.chmod(0o644)
    assert run(["backup", str(saved), "--data", str(tmp_path / "data")]) == 0
    assert saved.stat().st_mode & 0o777 == 0o600
    monkeypatch.delenv("RESIDUUM_SETTINGS")
    capsys.readouterr()
    assert run(["restore", str(saved), "--data", str(back), "--json"]) == 0
    folder = back / "settings-of-backup"
    assert json.loads(capsys.readouterr().out)["settings"] == [
        "000-settings.yaml",
        "001-press_map.yaml",
        "places.json",
    ]
    assert (folder / "000-settings.yaml").read_bytes() == file.read_bytes()
    assert (folder / "001-press_map.yaml").read_bytes() == bus.read_bytes()
    assert json.loads((folder / "places.json").read_bytes())["001-press_map.yaml"] == str(bus)
    assert (
        folder.stat().st_mode & 0o777 == 0o700
        and (folder / "places.json").stat().st_mode & 0o777 == 0o600
    )
    content = saved.read_bytes()
    saved.write_bytes(content.replace(b"plant:secret", b"plant:sEcret"))
    assert run(["restore", str(saved), "--data", str(tmp_path / "other")]) == 2
    assert "the settings differ from their checksums" in capsys.readouterr().err
    assert not (tmp_path / "other" / "settings-of-backup").exists()
