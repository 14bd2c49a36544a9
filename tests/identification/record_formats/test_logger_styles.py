"""Sixty files in twelve styles, the style not told: read right, or refused with the place and the remedy; never read wrong."""

import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from residuum.identification.errors import BadInput
from residuum.identification.record_formats import ReadOptions, read_record
from residuum.service.cli import BAD_INPUT, DONE, run

_HERE = importlib.util.spec_from_file_location(
    "logger_styles", Path(__file__).with_name("logger_styles.py")
)
styles = importlib.util.module_from_spec(_HERE)
sys.modules["logger_styles"] = styles
_HERE.loader.exec_module(styles)
FILES = {
    f"{style.__name__}, {written.name}": written for style in styles.STYLES for written in style()
}


def test_there_are_sixty_files_of_twelve_styles():
    assert (len(FILES), len(styles.STYLES)) == (60, 12)
    assert sum(not written.refused for written in FILES.values()) >= 40


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_read_right_or_refused(tmp_path, name):
    written = FILES[name]
    file = tmp_path / f"log{written.ending}"
    file.write_bytes(written.content)
    options = ReadOptions(resample=written.resample)
    if written.refused:
        with pytest.raises(BadInput, match=written.refused) as refused:
            read_record(file, options)
        assert "\n" not in str(refused.value)
        return
    record = read_record(file, options)
    assert written.notes in " ".join(record.notes)
    assert set(record.names) == set(written.channels)
    for channel, values in written.channels.items():
        np.testing.assert_allclose(record[channel], values, atol=1e-9)
    assert {channel: unit for channel, unit in record.units.items() if unit} == written.units
    assert record.sample_time == pytest.approx(written.step, rel=1e-6)
    assert record.t0 == pytest.approx(written.t0, abs=1e-4)


def test_a_command_takes_such_a_file_and_says_how_it_was_read(tmp_path, capsys):
    time = np.arange(200) * 0.05
    rows = "\n".join(f"{t:.2f};{95.0:.1f};{t * t / 2:.6f}".replace(".", ",") for t in time)
    file = tmp_path / "log.csv"
    file.write_text(f"Messung 7\nZeit [s];Kraft (N);Weg [m]\n{rows}\n")
    named = ["--map", "force=Kraft", "--map", "position=Weg"]
    assert run(["compare", "linear-axis", str(file), *named]) == DONE
    assert "decimal sign ','" in capsys.readouterr().err


def test_a_time_column_is_named_and_a_unit_is_said_of_the_new_name(tmp_path, capsys):
    file = tmp_path / "log.csv"
    rows = "\n".join(f"{k * 20},95,{k * k * 2e-4:.6f}" for k in range(200))
    file.write_text(f"Stempel [ms],Kraft,Weg [m]\n{rows}\n")
    named = ["--map", "force=Kraft", "--map", "position=Weg", "--unit", "force=N"]
    assert run(["compare", "linear-axis", str(file), *named]) == BAD_INPUT
    assert "no time column found among Stempel, Kraft, Weg" in capsys.readouterr().err
    assert run(["compare", "linear-axis", str(file), *named, "--map", "time=Stempel"]) == DONE
    assert run(["compare", "linear-axis", str(file), *named, "--map", "time=Stempl"]) == BAD_INPUT
    assert "no column 'Stempl' for the time; the nearest are Stempel" in capsys.readouterr().err


def test_inspect_takes_the_column_of_times_and_its_form(tmp_path, capsys):
    file, mapping = tmp_path / "log.csv", tmp_path / "log.csv.mapping.yaml"
    rows = "\n".join(f"{k * 0.02:.2f},95,{k * k * 2e-4:.6f}" for k in range(200))
    file.write_text(f"Stempel,force [N],position [m]\n{rows}\n")
    assert run(["inspect", str(file), "--time", "seconds"]) == BAD_INPUT
    assert "say --map time=COLUMN, or" in capsys.readouterr().err
    assert (
        run(
            [
                "inspect",
                str(file),
                "--time",
                "seconds",
                "--map",
                "time=Stempel",
                "--out",
                str(mapping),
            ]
        )
        == DONE
    )
    assert "'Stempel': seconds" in capsys.readouterr().out
    assert run(["compare", "linear-axis", str(file), "--mapping", str(mapping)]) == DONE


def test_a_hole_is_left_missing_and_told(tmp_path, capsys):
    time = np.concatenate([np.arange(0, 5, 0.1), np.arange(25, 30, 0.1)])
    file = tmp_path / "log.csv"
    file.write_text(
        "time [s],force [N],position [m]\n"
        + "\n".join(f"{t:.1f},95,{t * t / 2:.4f}" for t in time)
        + "\n"
    )
    record = read_record(file, ReadOptions(resample=True))
    assert np.isnan(record["force"]).sum() == 200
    assert run(["compare", "linear-axis", str(file), "--resample"]) == DONE
    told = capsys.readouterr()
    assert "200 samples left missing" in told.err
    # nothing is simulated across the hole
    assert "(part 1: 0 to 4.9 s)" in told.out and "(part 2: 25 to 29.9 s)" in told.out
