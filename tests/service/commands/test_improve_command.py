"""What `residuum improve` tells of the effects that it added: their sizes with doubt, the same as in the model file."""

import json
import re

import pytest

from residuum.identification.discrepancy import improve
from residuum.identification.physics import load_model
from residuum.identification.record import Record
from residuum.identification.record_formats import write_record
from residuum.service.cli import DONE, run
from residuum.simulation import MACHINES


@pytest.fixture
def record_file(tmp_path):
    signals = MACHINES["gate-drive"](
        seed=3, effects={"coulomb-friction": "medium"}, profile="rich", rate=200.0
    ).simulate(20.0)
    path = tmp_path / "drive.csv"
    write_record(Record(signals.channels, signals.units, signals.sample_time), path)
    return path


def test_sizes_are_told_as_they_are_in_the_model_file(record_file, tmp_path, capsys):
    out = tmp_path / "better.yaml"
    asked = [
        "improve",
        "gate-drive",
        str(record_file),
        "--add",
        "coulomb-friction",
        "--out",
        str(out),
    ]
    assert run([*asked, "--json"]) == DONE
    told = json.loads(capsys.readouterr().out)
    (effect,) = told["effects"]
    friction = effect["parameters"]["tau_c"]
    assert (effect["effect"], effect["at"], friction["unit"]) == (
        "coulomb-friction",
        "shaft",
        "N*m",
    )
    assert effect["probability"] is None  # it was asked for, not found
    assert friction["value"] == load_model(str(out)).values["coulomb-friction@shaft.tau_c"]
    assert 0.0 < friction["std"] < 0.05 * friction["value"]
    assert run(asked) == DONE
    assert re.search(
        r"coulomb-friction in shaft: tau_c = 0\.0\d+ ± \S+ N\*m\n", capsys.readouterr().out
    )


def test_nothing_is_written_where_all_that_is_named_would_make_the_model_worse(
    record_file, tmp_path, capsys, monkeypatch
):
    """The friction of this record is real; here its error on what is kept aside is said to have risen."""
    monkeypatch.setattr(improve, "first_that_holds", lambda *_: None)
    out = tmp_path / "worse.yaml"
    asked = [
        "improve",
        "gate-drive",
        str(record_file),
        "--auto",
        "--effects",
        "coulomb-friction",
        "--out",
        str(out),
    ]
    assert run([*asked, "--json"]) == DONE
    told = json.loads(capsys.readouterr().out)
    assert (told["model_file"], told["refused"], told["effects"]) == (
        None,
        ["coulomb-friction"],
        [],
    )
    assert [step["added"] for step in told["history"]] == [None] and told["history"][0][
        "remaining"
    ]["share"] == 1.0
    assert run(asked) == DONE
    assert "nothing is written" in capsys.readouterr().out and not out.exists()
