"""`residuum watch`: a settings file that begins where the user is, a map from a table, and what is missing in the settings."""

import json
from pathlib import Path

import pytest
import yaml

from residuum.service.cli import run
from residuum.service.fieldbus.can.frame_layout import BadBusDescription
from residuum.service.fieldbus.modbus.register_map import RegisterMap, read_register_map
from residuum.service.fieldbus.modbus.register_table import register_map_of
from residuum.service.settings import SETTINGS_FILE, load_settings

RIG = Path(__file__).parents[3] / "docs" / "tutorials" / "fan_rig"


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv(SETTINGS_FILE, "")
    for file in ("fan.dbc", "fan.yaml", "registers.csv"):
        (tmp_path / file).write_bytes((RIG / file).read_bytes())


def doctor(capsys, file="residuum.yaml"):
    capsys.readouterr()
    run(["doctor", "--settings", file, "--json"])
    checks = json.loads(capsys.readouterr().out)["checks"]
    return next(check for check in checks if check["name"].startswith("machine"))


def test_init_guesses_the_channels_and_doctor_finds_nothing_missing(capsys):
    words = [
        "watch",
        "init",
        "--asset",
        "fan",
        "--can",
        "udp_multicast:239.1.2.3:5000/0",
        "--map",
        "fan.dbc",
        "--model",
        "fan.yaml",
    ]
    assert run(words) == 0
    settings = load_settings(Path("residuum.yaml"))
    assert settings.machines[0].channels == {
        "voltage": "u_mot",
        "current": "i_mot",
        "speed": "n_fan",
    }
    assert Path("residuum.yaml").read_text().count("#") > 8
    assert doctor(capsys)["ok"]
    assert run(words) == 2  # what is there is not written over


def test_init_without_anything_is_a_form_and_doctor_says_what_to_fill_in(capsys):
    assert run(["watch", "init"]) == 0
    assert load_settings(Path("residuum.yaml")).machines[0].asset == "my-machine"
    found = doctor(capsys)
    assert not found["ok"] and "my-machine.dbc" in found["says"]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (
            {"channels": {"speed": "n_motor"}},
            "the bus has no signal 'n_motor'; did you mean 'u_mot'? it has i_mot, n_fan, u_mot",
        ),
        ({"channels": {"speed": "n_fan"}}, "voltage: the model needs this input"),
        (
            {"channels": {"voltage": "n_fan"}},
            "voltage: the model has it in V, the bus has n_fan in rpm",
        ),
        ({"model": None}, "model: is missing"),
        ({"model": "no.yaml"}, "no.yaml"),
        ({"diagnoser": "crystal-ball", "model": None}, "known are gate-actuator"),
    ],
)
def test_doctor_says_what_a_machine_lacks(capsys, change, says):
    machine = {
        "asset": "fan",
        "diagnoser": "model-based",
        "model": "fan.yaml",
        "window": {"cut": "sliding", "length": 10, "step": 10},
        "sources": [{"kind": "can", "channel": "udp_multicast:239.1.2.3:5000/0", "map": "fan.dbc"}],
    }
    Path("residuum.yaml").write_text(yaml.safe_dump({"machines": [machine | change]}))
    found = doctor(capsys)
    assert not found["ok"] and says in found["says"]


def test_a_map_made_from_a_table_is_read_as_any_other(capsys):
    assert run(["watch", "map", "registers.csv", "--out", "fan.map.yaml", "--every", "0.05"]) == 0
    stream = read_register_map("fan.map.yaml").streams["signals"]
    assert stream.poll.address == 0 and stream.sample_time == 0.05
    assert {
        name: (c.register_, c.type, c.unit, c.scale) for name, c in stream.channels.items()
    } == {
        "u_mot": (0, "uint16", "V", 0.01),
        "i_mot": (1, "int16", "A", 0.01),
        "n_fan": (2, "uint16", "rpm", 1.0),
        "t_mot": (3, "int16", "degC", 0.1),
    }


@pytest.mark.parametrize(
    ("table", "address", "words"),
    [
        ("Tag\tRegister\tFormat\tUnits\na\t100\tREAL\tV\nb\t104\tdint\tA\n", 100, 6),
        ('name,address,type,unit,factor\na,0x10,U16,V,"0,1"\nb,17,BOOL,,\n', 16, 2),
        ("# from the manual\nsignal;address;data_type;unit\na;40011;double;m\n", 10, 4),
        ("name;register\na;3\n", 3, 1),
        ("name;register\na;0\nb;200\n", 0, 201),
        (
            "name;register;type;length;word order;missing\na;30005;real;2;little;-9999 0x7FC00000\n",
            4,
            2,
        ),
    ],
)
def test_tables_of_several_habits_are_understood(table, address, words):
    stream = RegisterMap.model_validate(register_map_of(table, 0.1)).streams["signals"]
    assert stream.poll.address == address and stream.words == words


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ("name;register\n", "needs a row of headings"),
        ("name;type\na;int16\n", "no column 'register'"),
        ("name;register\na;ten\n", "row 2: register 'ten' is not a whole number"),
        (
            "name;register;type\na;1;complex\n",
            "row 2: type 'complex' is not known; known are uint16",
        ),
        ("name;register\na;1\na;2\n", "row 3: the name 'a' is empty or stands in two rows"),
        ("name;register\na;5\nb;5\n", "channels.b: register 0 belongs to a already"),
        ("name;register;type;length\na;5;float;1\n", "float32 takes 2 registers, registers says 1"),
        ("name;register;scale\na;0;much\n", "row 2: scale 'much' is not a number"),
        ("name;register\na;0;1;2\n", "row 2: has 4 cells"),
    ],
)
def test_a_table_that_cannot_be_understood_is_refused_with_its_row(table, says):
    with pytest.raises(BadBusDescription, match=says.replace("(", "\\(")):
        register_map_of(table, 0.1)
