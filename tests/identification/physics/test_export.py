"""Exported models behave as the original does: compiled C and plain Python against the product's own integration."""

import ctypes
import importlib.util
import json
import re
import subprocess

import numpy as np
import pytest

from residuum.identification.errors import BadModel
from residuum.identification.physics import Experiment, Simulator, load_model, read_model
from residuum.identification.physics.export import EXPORTS, explicit
from residuum.service.cli import BAD_INPUT, DONE, run

AXIS = """
name: soft axis
inputs: {force: N}
states: {q: {unit: m, rate: v}, v: {unit: m/s}}
parameters: {M: {value: 3.7, unit: kg, lower: 1, upper: 100}}
balances: {axis: {kind: force, storage: M * der(v), terms: {drive: force}, position: q, velocity: v}}
outputs: {position: {value: q, unit: m}, velocity: {value: v, unit: m/s}}
effects:
  - {id: viscous-friction, balance: axis, parameters: {d: 2.3}}
  - {id: cubic-spring, balance: axis, parameters: {k_2: 11.0, k_3: 40.0}}
  - {id: hysteresis, balance: axis, parameters: {f_c: 1.4, x_0: 0.02}}
  - {id: input-saturation, input: force, parameters: {u_max: 5.5}}
  - {id: output-lag, output: position, parameters: {tau: 0.05}}
"""
DT, SUBSTEPS = 0.01, 10


def models():
    drive = (
        load_model("gate-drive")
        .with_effect("viscous-friction", "shaft", {"d": 3e-5})
        .with_effect("inductance", "winding", {"L": 1e-3})
    )
    return [read_model(AXIS), drive, load_model("two-tanks")]


def movement(model, n=400):
    rng = np.random.default_rng(6)
    return np.repeat(rng.uniform(-6.0, 6.0, (n // 40, len(model.inputs))), 40, axis=0)


def expected(model, U):
    experiment = Experiment(U, np.full((len(U), len(model.outputs)), np.nan), np.zeros(U.shape[1]), DT)
    return Simulator(model).run(experiment, substeps=4 * SUBSTEPS).Y


def from_c(model, U, tmp_path):
    made = explicit(model)
    source, library = tmp_path / "model.c", tmp_path / "model.so"
    source.write_text(EXPORTS["c"](made))
    subprocess.run(["gcc", "-std=c99", "-Wall", "-Werror", "-O1", "-shared", "-fPIC", "-o", library, source, "-lm"], check=True)
    code, double = ctypes.CDLL(str(library)), ctypes.POINTER(ctypes.c_double)
    p = (ctypes.c_double * max(len(made.parameters), 1)).in_dll(code, f"{made.name}_parameters")
    x, y, u = np.zeros(max(len(made.states), 1)), np.zeros(len(made.outputs)), np.ascontiguousarray(U)
    at = [v.ctypes.data_as(double) for v in (x, y)]
    seen = np.empty((len(U), len(made.outputs)))
    getattr(code, f"{made.name}_initial")(ctypes.c_double(0.0), u[0].ctypes.data_as(double), p, at[0])
    for k in range(len(U)):
        held = u[k].ctypes.data_as(double)
        getattr(code, f"{made.name}_outputs")(ctypes.c_double(k * DT), at[0], held, p, at[1])
        seen[k] = y
        for i in range(SUBSTEPS):
            h = DT / SUBSTEPS
            getattr(code, f"{made.name}_step")(ctypes.c_double(k * DT + i * h), ctypes.c_double(h), at[0], held, p)
    return seen


def from_python(model, U, tmp_path):
    file = tmp_path / "exported_model.py"
    file.write_text(EXPORTS["python"](explicit(model)))
    specification = importlib.util.spec_from_file_location("exported_model", file)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module.simulate(DT * np.arange(len(U)), U, substeps=SUBSTEPS)


@pytest.mark.parametrize("run_exported", [from_c, from_python])
@pytest.mark.parametrize("model", models(), ids=lambda model: model.name)
def test_the_exported_text_moves_as_the_model_does(model, run_exported, tmp_path):
    U = movement(model)
    truth, seen = expected(model, U), run_exported(model, U, tmp_path)
    assert np.ptp(truth, axis=0).min() > 0.0
    np.testing.assert_allclose(seen, truth, atol=2e-4 * np.ptp(truth, axis=0).max())


def test_modelica_and_matlab_name_every_equation():
    made = explicit(read_model(AXIS))
    modelica, matlab = EXPORTS["modelica"](made), EXPORTS["matlab"](made)
    assert modelica.count("der(") == len(made.states) == 4
    assert modelica.rstrip().endswith("end soft_axis;")
    assert "Piecewise" not in modelica + matlab and "Max(" not in modelica and "Min(" not in modelica
    assert all(re.search(rf"\b{name}\b", modelica) and re.search(rf"q\.{name}\b", matlab) for name in made.parameters)
    assert modelica.count("(") == modelica.count(")") and matlab.count("(") == matlab.count(")")


def test_dry_friction_says_what_the_text_cannot_do():
    rubbing = explicit(load_model("linear-axis").with_effect("coulomb-friction", "axis", {"tau_c": 20.0}))
    assert all("Standstill" in text(rubbing) for text in EXPORTS.values())


def test_a_delay_is_refused():
    late = load_model("linear-axis").with_effect("input-delay", "force", {"delay": 0.01})
    with pytest.raises(BadModel, match="input 'force' is delayed"):
        explicit(late)


def test_the_command(tmp_path, capsys):
    out = tmp_path / "axis.c"
    assert run(["export", "linear-axis", "--to", "c", "--out", str(out), "--json"]) == DONE
    told = json.loads(capsys.readouterr().out)
    assert (told["to"], told["inputs"], told["parameters"]["M"] > 0) == ("c", ["force"], True)
    assert "linear_axis_rates" in out.read_text()
    assert run(["export", "linear-axis", "--to", "cobol", "--out", str(out)]) == BAD_INPUT
    assert "known are c, python, matlab, modelica" in capsys.readouterr().err
