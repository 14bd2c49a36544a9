"""A residual generator designed in Python is the one that the command line runs."""

import json

import pytest

import residuum as rs
from residuum.service.cli import run


def test_a_saved_residual_is_run_by_the_command(tmp_path, capsys):
    healthy = rs.simulate("process-plant", seed=1)
    healthy.save(tmp_path / "healthy.csv")
    designed = rs.residual(rs.identify(healthy, input="u", output="y", order=40), healthy)
    designed.save(tmp_path / "design.json")
    here = designed.run(healthy).to_dict()
    assert run(
        ["residual", "run", str(tmp_path / "design.json"), str(tmp_path / "healthy.csv"), "--json"]
    ) in (0, 1)
    there = json.loads(capsys.readouterr().out)
    # a CSV file holds ten digits
    assert there.pop("largest") == pytest.approx(here.pop("largest"), rel=1e-8)
    assert {**there, "record": None, "design": None} == {**here, "record": None, "design": None}
