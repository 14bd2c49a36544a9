"""`residuum control design` with parameters held, limits and one wish alone; bad settings are one line and status 2."""

import json

import numpy as np
import pytest
from scipy.signal import lfilter
from typer.testing import CliRunner

from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.identified_model_file import save_identified
from residuum.identification.record import Record
from residuum.service.commands.control import app


@pytest.fixture(scope="module")
def model(tmp_path_factory):
    rng = np.random.default_rng(0)
    u = rng.normal(size=800)
    y = lfilter([0, 0.3], [1, -0.8], u) + 0.05 * rng.normal(size=800)
    record = Record({"u": u, "y": y}, {"u": "", "y": ""}, 0.1, source="test")
    path = tmp_path_factory.mktemp("control") / "model.json"
    save_identified(identify_impulse_response(record, "u", "y", order=30), path)
    return path


def test_held_and_limited_parameters_reach_the_controller(model, tmp_path):
    command = ["design", str(model), "--out", str(tmp_path / "k.json"), "--json", "--fix", "k_d=0", "--fix", "N_d=1"]
    done = CliRunner().invoke(app, [*command, "--within", "k_i=0:0.3", "--only", "settling-time"])
    assert done.exit_code == 0, done.output
    found = json.loads(done.stdout)
    assert set(found["parameters"]) == {"k_p", "k_i"} and 0 <= found["parameters"]["k_i"] <= 0.3 and found["stable"]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        (["--fix", "k_d"], "NAME=VALUE"),
        (["--fix", "k_d=x"], "not a number"),
        (["--within", "k_i=1"], "NAME=LOW:HIGH"),
        (["--fix", "gain=1"], "has no parameter"),
        (["--only", "speed"], "must be one of"),
    ],
)
def test_bad_settings_are_refused(model, tmp_path, options, says):
    done = CliRunner().invoke(app, ["design", str(model), "--out", str(tmp_path / "k.json"), *options])
    assert isinstance(done.exception, BadInput) and says in str(done.exception)
