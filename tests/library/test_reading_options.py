"""Each option by which a command reads a file is a keyword of `rs.read`, and its refusals name that keyword."""

import ast
import inspect
import re

import numpy as np
import pytest

import residuum as rs
from residuum.library.questions.compare import Compare
from residuum.service.commands import compare
from residuum.service.commands import inspect as inspection
from tests.identification.record_formats.left_open import LEFT_OPEN

SAID = {"UNIT": "V", "COLUMN": "t", "SIGN": "','"}


@pytest.mark.parametrize("kind", LEFT_OPEN)
def test_the_way_on_of_a_refusal_is_a_keyword_with_which_the_file_is_read(tmp_path, kind):
    lines, way_on, _ = LEFT_OPEN[kind]
    (tmp_path / "log.csv").write_text("\n".join(lines) + "\n")
    with pytest.raises(rs.BadInput, match=way_on) as refusal:
        rs.read(tmp_path / "log.csv")
    assert "--" not in str(refusal.value) and "residuum inspect" not in str(refusal.value)
    keyword, _, value = re.search(way_on, str(refusal.value))[0].partition("=")
    for word, meant in SAID.items():
        value = value.replace(word, meant)
    said = {keyword: ast.literal_eval(value)}
    try:
        assert rs.read(tmp_path / "log.csv", **said).n > 2
    except rs.BadInput as next_step:  # a cell that is still open: the first way on was gone
        assert not re.search(way_on, str(next_step)), next_step


def test_a_column_is_called_by_map_as_the_commands_do(tmp_path):
    (tmp_path / "log.csv").write_text("\n".join(["a;b", *(f"{k};{k}" for k in range(40))]) + "\n")
    record = rs.read(
        tmp_path / "log.csv",
        map={"time": "a", "speed": "b"},
        time="seconds",
        units={"speed": "rpm"},
    )
    assert record.units == {"speed": "rpm"} and record.sample_time == 1.0


def test_a_number_that_means_no_value_is_said_as_a_number(tmp_path):
    (tmp_path / "log.csv").write_text(
        "\n".join(["time [s],T [V]", *(f"{k},{-1 if k == 3 else k}" for k in range(40))]) + "\n"
    )
    assert np.flatnonzero(np.isnan(rs.read(tmp_path / "log.csv", missing=[-1])["T"])).tolist() == [
        3
    ]


def test_a_file_is_read_by_the_mapping_that_is_named_or_lies_beside_it(tmp_path):
    log, mapping = tmp_path / "log.csv", tmp_path / "log.csv.mapping.yaml"
    log.write_text(
        "\n".join(["Zeit;n", *(f"{k};{'off' if k == 3 else k}" for k in range(40))]) + "\n"
    )
    inspection.inspect_command(
        str(log), out=mapping, time="minutes", missing=["off"], units=["n=rpm"]
    )
    assert rs.read(log).sample_time == 60.0 and rs.read(log).units == {"n": "rpm"}
    elsewhere = mapping.rename(tmp_path / "habit.yaml")
    assert np.isnan(rs.read(log, mapping=elsewhere)["n"][3])
    assert np.isnan(rs.read(log, mapping=elsewhere, missing=[5])["n"][[3, 5]]).all()
    with pytest.raises(rs.BadInput, match=r"Zeit.*has no unit"):
        rs.read(log, missing=["off"])


def test_every_option_of_reading_that_a_command_has_is_a_keyword():
    both = {
        *inspect.signature(compare.compare_command).parameters,
        *inspect.signature(inspection.inspect_command).parameters,
    }
    elsewhere = {
        "model",
        "records",
        "file",
        "catalogue",
        "plot",
        "as_json",
        "out",
        *Compare.model_fields,
    }
    called = {"channel_map": "map", "mapped": "map", "unit": "units"}
    of_buses = {"dbc"}
    wanted = {called.get(name, name) for name in both - elsewhere - of_buses}
    assert wanted <= set(inspect.signature(rs.read).parameters)
