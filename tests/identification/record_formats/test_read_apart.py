"""A file that ends the process which reads it is refused in one line, and takes nothing else with it."""

import sys

import numpy as np
import pytest
from scipy.io import savemat

import residuum as rs
from residuum.identification.errors import BadRecord
from residuum.identification.record_formats import MAY_CRASH, ReadOptions, read_record
from residuum.identification.record_formats.read_apart import read_safely
from residuum.service.cli import BAD_INPUT, run

T = 0.01 * np.arange(200)


@pytest.fixture
def drive(tmp_path):
    file = tmp_path / "drive.mat"
    savemat(
        file,
        {
            "time": T,
            "u": np.sign(np.sin(T)),
            "y": np.where(T > 1, np.nan, np.cos(T)),
            "units_u": "V",
            "left": np.ones((2, 9)),
        },
    )
    return file


def test_it_is_the_same_record(drive):
    here, apart = read_record(drive), read_safely(drive)
    assert (
        apart.names == here.names
        and dict(apart.units) == dict(here.units)
        and apart.notes == here.notes
    )
    assert (apart.sample_time, apart.t0, apart.source) == (here.sample_time, here.t0, here.source)
    for name in here.names:
        np.testing.assert_array_equal(apart[name], here[name])
        assert apart[name].dtype == here[name].dtype


def test_options_and_refusals_go_through(tmp_path):
    file = tmp_path / "bare.mat"
    savemat(file, {"u": np.sin(T)})
    with pytest.raises(BadRecord, match="say sample_time=SECONDS") as apart:
        read_safely(file)
    with pytest.raises(BadRecord) as here:
        read_record(file)
    assert str(apart.value) == str(here.value)
    record = read_safely(file, ReadOptions(sample_time=0.5, units={"u": "mm"}))
    assert (record.sample_time, record.units["u"]) == (0.5, "mm")


def test_a_reader_that_is_killed_is_one_line(drive, tmp_path, monkeypatch, capsys):
    """The interpreter that would read stands for a reader whose memory a damaged file has spoilt."""
    killed = tmp_path / "python"
    killed.write_text("#!/bin/sh\nkill -SEGV $$\n")
    killed.chmod(0o755)
    monkeypatch.setattr(sys, "executable", str(killed))
    with pytest.raises(
        BadRecord,
        match=r"drive.mat: reading it ended the process that did \(signal 11\): the file is damaged",
    ):
        rs.read(drive)
    for command in (["inspect", str(drive)], ["compare", "gate-drive", str(drive)]):
        assert run(command) == BAD_INPUT
        err = capsys.readouterr().err
        assert "signal 11" in err and len(err.splitlines()) == 1 and "Traceback" not in err


def test_text_is_read_where_it_is(tmp_path, monkeypatch):
    monkeypatch.setattr(sys, "executable", str(tmp_path / "none"))
    file = tmp_path / "drive.csv"
    file.write_text("time [s],u [V]\n0,1\n0.1,2\n")
    assert ".csv" not in MAY_CRASH and read_safely(file).n == 2
