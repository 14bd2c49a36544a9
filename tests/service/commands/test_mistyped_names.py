"""A mistyped name is refused in one line, with the nearest name as a question and all that there are, whatever it names."""

import pytest

import residuum as rs
from residuum.service.cli import BAD_INPUT, run

SETTINGS = """
machines:
  - asset: press
    diagnoser: bearing
    window: {cut: sliding}
    sources: [{kind: can, channel: "virtual:a", map: a.dbc}]
"""
MISTYPED = {
    "a command": ("comparee a b", "command 'comparee'", "compare"),
    "a command of a command": ("watch statu press", "command 'statu'", "status"),
    "an option": ("score bearing a.csv --baselin b", "option --baselin", "--baseline"),
    "a choice": ("residual run a b --threshold poster", "--threshold 'poster'", "posterior"),
    "a method": (
        "identify drive.csv --input voltage --output speed --method arxx --out o",
        "method 'arxx'",
        "arx",
    ),
    "a machine": ("simulate gate-driv --out a.csv", "machine 'gate-driv'", "gate-drive"),
    "an effect of a machine": (
        "simulate gate-drive --out a --effect coulom-friction",
        "'coulom-friction'",
        "coulomb-friction",
    ),
    "an effect's parameter": (
        "simulate gate-drive --out a.csv --effect viscous-friction:bb=1",
        "parameter 'bb'",
        "b",
    ),
    "a fault": (
        "simulate process-plant --out a.csv --fault sensor-ofset",
        "fault 'sensor-ofset'",
        "sensor-offset",
    ),
    "a watched machine": ("watch signals pres --settings settings.yaml", "machine 'pres'", "press"),
    "a diagnoser": ("score bearin drive.csv", "diagnoser 'bearin'", "bearing"),
    "a model": ("compare gate-driv drive.csv", "model 'gate-driv'", "gate-drive"),
    "an effect": (
        "explain gate-drive drive.csv --effects coulom-friction",
        "effect 'coulom-friction'",
        "coulomb-friction",
    ),
    "a channel": (
        "identify drive.csv --input Voltag --output speed --out o",
        "'Voltag'",
        "voltage",
    ),
    "a model's channel": ("compare gate-drive drive.csv --map sped=speed", "'sped'", "speed"),
    "a record's column": (
        "compare gate-drive drive.csv --map voltage=voltag",
        "'voltag'",
        "voltage",
    ),
    "a structure": ("control design a --structure pidm --out o", "structure 'pidm'", "pid"),
    "a parameter to free": ("improve gate-drive drive.csv --auto --free RR --out o", "'RR'", None),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    place = tmp_path_factory.mktemp("names")
    drive = {"voltage": [0.0, 1.0] * 40, "speed": [0.0, 2.0] * 40}
    rs.from_arrays(drive, units={"voltage": "V", "speed": "rad/s"}, sample_time=0.01).save(
        place / "drive.csv"
    )
    (place / "settings.yaml").write_text(SETTINGS, encoding="utf-8")
    return place


@pytest.mark.parametrize("what", MISTYPED)
def test_the_nearest_name_is_asked_for(what, folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    line, says, meant = MISTYPED[what]
    assert run(line.split()) == BAD_INPUT
    (told,) = capsys.readouterr().err.splitlines()
    assert says in told
    assert meant is None or f"did you mean {meant!r}?" in told


def test_a_name_like_no_other_is_met_with_the_names_alone(capsys):
    assert run(["simulate", "zzz", "--out", "a.csv"]) == BAD_INPUT
    told = capsys.readouterr().err
    assert "known are" in told and "did you mean" not in told
