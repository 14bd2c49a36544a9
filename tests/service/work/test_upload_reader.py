"""Whatever an uploaded file does to its reader, the service gets a record or one line."""

import os
import tempfile
from pathlib import Path

import numpy as np
import pytest

from residuum.identification.errors import BadInput, BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats import write_record
from residuum.identification.record_formats.npz import read_npz
from residuum.service.body_errors import BadBody
from residuum.service.work import limited_process
from residuum.service.work.upload_reader import read_upload

LIMITS = {"memory": 512 * 2**20, "seconds": 10}


@pytest.mark.parametrize("ending", [".csv", ".npz", ".wav", ".parquet"])
def test_a_record_comes_back_as_it_was_written(tmp_path, ending):
    channels = {
        "y": np.array([0.25, np.nan, -0.5]) if ending != ".wav" else np.array([0.25, 0.0, -0.5])
    }
    record = Record(channels, {"y": "V"}, 1e-3)
    write_record(record, tmp_path / f"r{ending}")
    back = read_upload((tmp_path / f"r{ending}").read_bytes(), ending, "mine.x", **LIMITS)
    np.testing.assert_allclose(back[back.names[0]], record["y"], atol=1e-4)
    assert back.sample_time == pytest.approx(1e-3) and back.source == "mine.x"


def test_a_refusal_is_one_line_that_names_the_users_file():
    with pytest.raises(BadBody, match=r"^mine\.npz: is not an NPZ file") as refused:
        read_upload(b"PK\x03\x04 and no more", ".npz", "mine.npz", **LIMITS)
    assert "/tmp" not in str(refused.value) and "\n" not in str(refused.value)


def test_a_refusal_does_not_repeat_the_file(tmp_path):
    """A damaged NPZ whose first name has become thousands of bytes long: the library's words quote all of them."""
    write_record(
        Record({"y": np.random.default_rng(1).normal(size=3000)}, {"y": "V"}, 1e-3),
        tmp_path / "r.npz",
    )
    content = bytearray((tmp_path / "r.npz").read_bytes())
    content[26:28] = (9000).to_bytes(2, "little")
    for read in (
        lambda: read_upload(bytes(content), ".npz", "mine.npz", **LIMITS),
        lambda: read_npz(tmp_path / "long.npz"),
    ):
        (tmp_path / "long.npz").write_bytes(content)
        with pytest.raises(BadInput, match="is not an NPZ file") as refused:
            read()
        assert len(str(refused.value)) < 400


def replaced(monkeypatch, tmp_path, body):
    """Let the reading process run `body` where it would read the file."""
    (tmp_path / "sitecustomize.py").write_text(
        "import residuum.identification.record_formats as formats\ndef read_record(file, options):\n    " + body
        + "\nformats.read_record = read_record\n"
    )  # fmt: skip
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)


@pytest.mark.parametrize(
    ("body", "says"),
    [
        (
            "return bytearray(2**30)",
            "mine.csv: reading it takes more than 536870912 bytes of memory",
        ),
        ("import os; os.abort()", r"mine.csv: reading it ended the process that did \(-6\)"),
        ("import os; os.kill(os.getpid(), 9)", r"\(-9\)"),
        ("raise ZeroDivisionError", r"\(1\)"),
        ("[open('/dev/null') for _ in range(100)]", r"\(1\)"),
        ("open('big', 'wb').truncate(2**30)", r"\(-25\)|\(1\)"),
    ],
)
def test_a_reader_that_breaks_a_limit_or_dies_harms_nobody(monkeypatch, tmp_path, body, says):
    replaced(monkeypatch, tmp_path, body)
    with pytest.raises(BadRecord, match=says):
        read_upload(b"t [s],y [V]\n0,1\n", ".csv", "mine.csv", **LIMITS)


@pytest.mark.parametrize(
    ("body", "says"),
    [
        ("while True: pass", r"\(-(9|24)\)|longer than 9 s"),
        ("import time; time.sleep(9999)", "longer than 9 s"),
    ],
)
def test_a_reader_that_never_ends_is_ended(monkeypatch, tmp_path, body, says):
    replaced(monkeypatch, tmp_path, body)
    monkeypatch.setattr(limited_process, "_PATIENCE", 3)
    with pytest.raises(BadRecord, match=says):
        read_upload(b"", ".csv", "mine.csv", memory=2**29, seconds=3)


def test_what_a_library_leaves_behind_goes_with_the_upload(tmp_path):
    write_record(Record({"y": np.arange(500.0)}, {"y": "V"}, 1e-3), tmp_path / "r.mf4")
    whole = (tmp_path / "r.mf4").read_bytes()
    # flags of a recording that was not ended: the library works on a copy
    unfinished = whole[:60] + b"\x21" + whole[61:200]
    with pytest.raises(BadRecord):
        read_upload(unfinished, ".mf4", "mine.mf4", **LIMITS)
    assert list(Path(tempfile.gettempdir()).glob("*_upload.mf4")) == []


def test_what_a_loggers_file_leaves_open_is_said_with_the_upload():
    content = b"Zeit;speed [rpm]\n01.02.2024 10:00:00;1,500\n01.02.2024 10:00:01;2,500\n"
    with pytest.raises(BadRecord, match="say decimal=SIGN"):
        read_upload(content, ".csv", "log.csv", **LIMITS)
    record = read_upload(content, ".csv", "log.csv", **LIMITS, options={"decimal": ","})
    assert record["speed"].tolist() == [1.5, 2.5] and record.units["speed"] == "rpm"
