"""`inspect` shows of every format what is read, what is left out, what has no unit, and the first rows."""

import json

import numpy as np
import pytest
from scipy.io import savemat

from residuum.service.cli import BAD_INPUT, DONE, run

TIME = 0.01 * np.arange(300)


def test_a_file_that_says_itself_how_it_is_read(tmp_path, capsys):
    file = tmp_path / "r.mat"
    savemat(
        file,
        {
            "time": TIME[:, None],
            "u": np.cos(TIME)[:, None],
            "units_u": "V",
            "w": TIME[:, None],
            "gains": [1.0, 2.0, 3.0],
        },
    )
    assert run(["inspect", str(file), "--json"]) == DONE
    shown = json.loads(capsys.readouterr().out)
    assert [(c["name"], c["unit"], c["missing"]) for c in shown["columns"]] == [
        ("u", "V", 0),
        ("w", "", 0),
    ]
    assert shown["samples"]["sample_time"] == pytest.approx(0.01) and len(shown["first_rows"]) == 3
    assert shown["notes"] == ["not read: gains (3 values)"]
    assert run(["inspect", str(file)]) == DONE
    said = capsys.readouterr().out
    assert "not read: gains" in said and "without a unit: w; --unit" in said


def test_a_loggers_file_shows_its_first_rows_and_what_has_no_unit(tmp_path, capsys):
    file = tmp_path / "r.txt"
    file.write_text(
        "t [s];p [bar];duty\n"
        + "\n".join(f"{k};{k / 4:.2f};{'' if k == 1 else 7}".replace(".", ",") for k in range(9))
    )
    assert run(["inspect", str(file), "--json"]) == DONE
    shown = json.loads(capsys.readouterr().out)
    assert shown["first_rows"] == [[0.0, 0.0, 7.0], [1.0, 0.25, None], [2.0, 0.5, 7.0]]
    assert shown["without_unit"] == ["duty"]


def test_a_cell_is_said_to_mean_no_value_for_every_command(tmp_path, capsys):
    file = tmp_path / "r.csv"
    file.write_text("time [s],U [V]\n0,1\n1,OL\n2,3\n3,4\n")
    assert run(["inspect", str(file)]) == BAD_INPUT
    assert "--missing OL " in capsys.readouterr().err
    mapping = tmp_path / "r.csv.mapping.yaml"
    assert run(["inspect", str(file), "--missing", "OL", "--out", str(mapping)]) == DONE
    assert "- ol" in mapping.read_text()


def test_every_format_is_shown_in_one_shape(tmp_path, capsys):
    logger, told = tmp_path / "r.txt", tmp_path / "r.mat"
    logger.write_text("t [s];duty\n" + "\n".join(f"{k};{k % 7}" for k in range(20)))
    savemat(told, {"time": TIME[:, None], "duty": np.cos(TIME)[:, None]})
    shapes = []
    for file in (logger, told):
        assert run(["inspect", str(file), "--json"]) == DONE
        shown = json.loads(capsys.readouterr().out)
        assert shown["without_unit"] == ["duty"] and len(shown["first_rows"]) == 3
        shapes.append((sorted(shown), sorted(shown["samples"]), sorted(shown["columns"][0])))
    assert shapes[0] == shapes[1]


def test_the_options_that_refusals_of_inspect_name_are_its_own(tmp_path, capsys):
    bare = tmp_path / "bare.mat"
    savemat(bare, {"gs": np.sin(np.arange(50.0))})
    assert run(["inspect", str(bare)]) == BAD_INPUT and "--sample-time" in capsys.readouterr().err
    assert run(["inspect", str(bare), "--sample-time", "0.01", "--unit", "gs=g"]) == DONE
    assert "50 rows of 0.01 s" in (shown := capsys.readouterr().out) and "gs [g]" in shown
    uneven = tmp_path / "uneven.mat"
    savemat(uneven, {"time": np.array([0, 0.1, 0.25, 0.3, 0.4]), "u": np.arange(5.0)})
    assert run(["inspect", str(uneven)]) == BAD_INPUT and "--resample" in capsys.readouterr().err
    assert (
        run(["inspect", str(uneven), "--resample"]) == DONE
        and "resampled to" in capsys.readouterr().out
    )


def test_rows_of_one_stamp_are_given_no_rate(tmp_path, capsys):
    file = tmp_path / "whole.csv"
    rows = [f"2024-03-11 09:58:{30 + k // 10},{k % 7}" for k in range(100)]
    file.write_text("\n".join(["Timestamp,p [bar]", *rows]))
    assert run(["inspect", str(file)]) == DONE
    shown = capsys.readouterr().out
    assert "100 rows, 10 stamps 1 s apart" in shown and "Hz" not in shown and "`spread`" in shown


def test_uneven_steps_of_a_text_are_shown_as_resample_makes_them(tmp_path, capsys):
    rows = [f"{k + 0.3 * (k % 2)};{k}" for k in range(40)]
    (tmp_path / "uneven.csv").write_text("\n".join(["Zeit [s];n [rpm]", *rows]) + "\n")
    found = {}
    for option in ([], ["--resample"]):
        assert run(["inspect", str(tmp_path / "uneven.csv"), "--json", *option]) == DONE
        found[bool(option)] = json.loads(capsys.readouterr().out)
    assert not found[False]["samples"]["even"] and found[True]["samples"]["even"]
    assert any(
        note.startswith("n resampled to 1.00056 s: each sample kept at its even")
        for note in found[True]["notes"]
    )
    assert (
        found[True]["guesses"] == found[False]["guesses"]
        and found[True]["mapping"] == found[False]["mapping"]
    )
