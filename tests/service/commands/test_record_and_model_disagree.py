"""What a record contradicts in a model, or does not hold of it, is told by every command that holds the two together."""

import json

import numpy as np
import pytest

import residuum as rs
from residuum.identification.physics import load_model, write_model
from residuum.service.cli import ANSWER_IS_NO, DONE, run

BEGINS = 0.42


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A cart that is pushed to and fro from .42 m on, recorded with its position alone, and a model of it from a template."""
    place = tmp_path_factory.mktemp("cart")
    rng = np.random.default_rng(7)
    time = np.arange(600) * 0.01
    force = 20.0 * np.sin(2.0 * time) + 10.0 * np.sin(5.3 * time)
    speed = np.cumsum(force) * 0.01 / 95.0
    position = BEGINS + np.cumsum(speed) * 0.01 + rng.normal(0.0, 1e-4, 600)
    record = rs.from_arrays(
        {"force": force, "position": position},
        units={"force": "N", "position": "m"},
        sample_time=0.01,
    )
    record.save(place / "cart.csv")
    text = write_model(load_model("linear-axis"))
    (place / "template.yaml").write_text(text + "initial: {q: 0.0}\n", encoding="utf-8")
    (place / "right.yaml").write_text(text + f"initial: {{q: {BEGINS}}}\n", encoding="utf-8")
    return place


LINES = {
    "compare": "compare {model} cart.csv",
    "estimate": "estimate {model} cart.csv --out out.yaml",
    "improve": "improve {model} cart.csv --add viscous-friction --out out.yaml",
    "explain": "explain {model} cart.csv --effects viscous-friction",
}


@pytest.mark.parametrize("command", LINES)
def test_a_first_value_that_the_record_contradicts_is_warned_about(
    command, folder, monkeypatch, capsys
):
    monkeypatch.chdir(folder)
    # begun half a metre away, the mass runs to its bound, which is no estimate
    ends = ANSWER_IS_NO if command == "estimate" else DONE
    assert run([*LINES[command].format(model="template.yaml").split(), "--json"]) == ends
    (warning,) = json.loads(capsys.readouterr().out)["warnings"]
    assert (
        "initial: q is 0 m in the model, and cart.csv begins at 0.42 m; write initial: {q: 0.42}"
        in warning
    )


@pytest.mark.parametrize("command", ["compare", "estimate"])
def test_the_warning_is_part_of_the_report_and_absent_where_the_first_value_is_right(
    command, folder, monkeypatch, capsys
):
    monkeypatch.chdir(folder)
    for model, warned in ("template.yaml", True), ("right.yaml", False):
        assert run(LINES[command].format(model=model).split()) == (
            ANSWER_IS_NO if warned and command == "estimate" else DONE
        )
        assert ("warning: initial: q is 0 m" in capsys.readouterr().out) is warned


def test_an_output_that_the_record_lacks_is_named(folder, monkeypatch, capsys):
    monkeypatch.chdir(folder)
    assert run(["compare", "linear-axis", "cart.csv", "--json"]) == DONE
    told = json.loads(capsys.readouterr().out)
    assert list(told["not_recorded"]) == ["velocity"] and "velocity" not in told["outputs"]
    assert run(["compare", "linear-axis", "cart.csv"]) == DONE
    assert (
        "velocity: not compared, for no column holds it (map one: --map velocity=COLUMN)"
        in capsys.readouterr().out
    )
