"""Exported models behave as the original does: compiled C, plain Python and FMUs against the product's own integration."""

import ctypes
import importlib.util
import io
import json
import re
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

from residuum.identification.errors import BadModel
from residuum.identification.physics import Experiment, Simulator, load_model, read_model
from residuum.identification.physics.export import EXPORTS, explicit
from residuum.identification.physics.export.fmu_file import fmu
from residuum.service.cli import BAD_INPUT, DONE, run

fmpy = pytest.importorskip("fmpy")

_reader = importlib.util.spec_from_file_location(
    "modelica_reader", Path(__file__).with_name("modelica_reader.py")
)
modelica_reader = importlib.util.module_from_spec(_reader)
_reader.loader.exec_module(modelica_reader)
validate_fmu = pytest.importorskip("fmpy.validation").validate_fmu

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
PUMP = """
name: pump with a curve
inputs: {n: 1/s}
states: {h: {unit: m}, x: {unit: m}}
parameters:
  A: {value: 2.0, unit: m**2}
  b: {value: 0.1, unit: m*s}
  top: {value: 3.0, unit: m**3/s}
  k: {value: 0.4, unit: 1/s}
  T: {value: 2.0, unit: s}
constants: {most: 5, R: 0.5 m}
let: {s: n * T / most, open: "where((n > 1 or n < -3) and not n == 2, 0.8, 0.1)"}
balances:
  tank:
    kind: volume
    storage: A * der(h)
    terms:
      curve: "table(n, [-2, 0, 1, 2, 5], [-1, 0, 1, top, 2.5])"
      smooth: "table(n, [-2, 0, 1, 5], [0, 0.1 * top, 0.4, -0.1], cubic)"
      map: "table(h, n, [0, 1, 2], [-2, 3], [[0.1, 0.3], [0, 0.2], [-0.1, 0.1]])"
      out: -k * A * h * open
  lag:
    kind: signal
    storage: T * der(x)
    terms:
      a: hypot(h, R) - x + b * floor(n) + 0.1 * h * atan2(h, x) + 0.01 * h * mod(n * T, 3)
      b: 0.02 * h * (atan(s) + cosh(s) - sinh(s) + asin(s / 9) + acos(s / 9) + tan(s / 9))
outputs: {level: {value: h, unit: m}, angle: {value: "where(n != 1 and n <= 4, atan2(h, R), 1)"}}
"""
SHARED = """
name: equations that name each other
inputs: {n: 1/s}
states: {h: {unit: m}, x: {unit: m}}
parameters: {A: {value: 2.0, unit: m**2}, k: {value: 0.4, unit: 1/s}, T: {value: 2.0, unit: s}, top: {value: 0.35}}
constants: {R: 0.5 m}
let:
  s: n * T / 5
  a: "table(h / R, s, [0, 1, 2, 3], [-2, 0, 1], [[0.1, 0.3, 0.2], [0, 0.2, 0.4], [-0.1, 0.1, 0.3], [0.2, 0, 0.1]])"
  b: "where(a > 0.15, a * sqrt(abs(a)), a**2 * (1 + a)) + table(s, [-2, 0, 1, 5], [0, top, 0.4, -0.1], cubic)"
  c: max(a, b, 0.2 * a * b) + hypot(a, b) / 3 - min(a * b, 0.1)
balances:
  tank: {kind: volume, storage: A * der(h), terms: {in: k * A * R * (b + c), out: -k * A * h * (1 + a * b)}, level: h}
  lag: {kind: signal, storage: T * der(x), terms: {itself: -x, level: h * c * b}}
outputs: {level: {value: h * (1 + a), unit: m}, open: {value: b}}
effects: [{id: output-lag, output: open, parameters: {tau: 0.05}}]
"""
DT, SUBSTEPS, CLOSE = 0.01, 500, 1e-6
BUILT_IN = ("gate-drive", "oven", "linear-axis", "oscillator", "two-tanks", "process")


def models():
    drive, axis = load_model("gate-drive"), load_model("linear-axis")
    mended = [
        read_model(AXIS),
        read_model(PUMP),
        read_model(SHARED),
        drive.with_effect("viscous-friction", "shaft", {"d": 3e-5}).with_effect(
            "inductance", "winding", {"L": 1e-3}
        ),
        drive.with_effect("coulomb-friction", "shaft", {"tau_c": 0.05}).with_effect(
            "brush-drop", "winding", {"V_b": 1.0}
        ),
        axis.with_effect("coulomb-friction", "axis", {"tau_c": 0.5}).with_effect(
            "output-quantisation", "position", {"q": 1e-3}
        ),
    ]
    return [*map(load_model, BUILT_IN), *mended]


def name_of(model):
    return "+".join([model.name, *(use.id for use in model.effects)])


def movement(model, n=120):
    rng = np.random.default_rng(6)
    return np.repeat(rng.uniform(-6.0, 6.0, (n // 40, len(model.inputs))), 40, axis=0)


def expected(model, U):
    experiment = Experiment(
        U, np.full((len(U), len(model.outputs)), np.nan), np.zeros(U.shape[1]), DT
    )
    return Simulator(model).run(experiment, substeps=SUBSTEPS).Y


def from_c(model, U, tmp_path):
    made = explicit(model)
    source, library = tmp_path / "model.c", tmp_path / "model.so"
    source.write_text(EXPORTS["c"](made))
    subprocess.run(
        [
            "gcc",
            "-std=c99",
            "-Wall",
            "-Werror",
            "-O1",
            "-shared",
            "-fPIC",
            "-o",
            library,
            source,
            "-lm",
        ],
        check=True,
    )
    code, double = ctypes.CDLL(str(library)), ctypes.POINTER(ctypes.c_double)
    p = (ctypes.c_double * max(len(made.parameters), 1)).in_dll(code, f"{made.name}_parameters")
    x, y, u = (
        np.zeros(max(len(made.states), 1)),
        np.zeros(len(made.outputs)),
        np.ascontiguousarray(U),
    )
    at = [v.ctypes.data_as(double) for v in (x, y)]
    seen = np.empty((len(U), len(made.outputs)))
    getattr(code, f"{made.name}_initial")(
        ctypes.c_double(0.0), u[0].ctypes.data_as(double), p, at[0]
    )
    for k in range(len(U)):
        held = u[k].ctypes.data_as(double)
        getattr(code, f"{made.name}_outputs")(ctypes.c_double(k * DT), at[0], held, p, at[1])
        seen[k] = y
        at_time, h, tolerance = map(ctypes.c_double, (k * DT, DT, 1e-9))
        getattr(code, f"{made.name}_advance")(at_time, h, at[0], held, p, tolerance)
    return seen


def from_python(model, U, tmp_path):
    file = tmp_path / "exported_model.py"
    file.write_text(EXPORTS["python"](explicit(model)))
    specification = importlib.util.spec_from_file_location("exported_model", file)
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return module.simulate(DT * np.arange(len(U)), U)


def unpacked(model, tmp_path):
    file = tmp_path / "model.fmu"
    found = fmu(explicit(model))
    assert (found.library, found.why) == ("linux64", "")
    file.write_bytes(found.content)
    assert validate_fmu(str(file)) == []
    description = fmpy.read_model_description(str(file))
    return description, {
        "guid": description.guid,
        "unzipDirectory": fmpy.extract(str(file), str(tmp_path / "unpacked")),
        "modelIdentifier": description.coSimulation.modelIdentifier,
        "instanceName": "one",
    }


def from_fmu(model, U, tmp_path):
    description, arguments = unpacked(model, tmp_path)
    slave = fmpy.fmi2.FMU2Slave(**arguments)
    ins, outs = (
        [v.valueReference for v in description.modelVariables if v.causality == kind]
        for kind in ("input", "output")
    )
    slave.instantiate()
    slave.setupExperiment(startTime=0.0)
    slave.enterInitializationMode()
    slave.setReal(ins, list(U[0]))
    slave.exitInitializationMode()
    seen = []
    for k, u in enumerate(U):
        slave.setReal(ins, list(u))
        seen.append(slave.getReal(outs))
        slave.doStep(k * DT, DT)
    slave.terminate()
    slave.freeInstance()
    return np.array(seen)


def from_modelica(model, U, tmp_path):
    return modelica_reader.ModelicaModel(EXPORTS["modelica"](explicit(model))).run(U, DT)


WAYS = [
    *((model, way) for model in models() for way in (from_python, from_fmu)),
    *((model, from_c) for model in (models()[-1], read_model(SHARED))),
]
WAYS += [(model, from_modelica) for model in models()[: len(BUILT_IN) + 3]]
"""The library of an FMU is the exported C, compiled; Modelica is read back where no dry friction needs its tool's events."""


@pytest.mark.parametrize(
    ("model", "run_exported"), WAYS, ids=[f"{name_of(m)}-{way.__name__}" for m, way in WAYS]
)
def test_the_export_moves_as_the_model_does(model, run_exported, tmp_path):
    U = movement(model)
    truth, seen = expected(model, U), run_exported(model, U, tmp_path)
    assert np.ptp(truth, axis=0).min() > 0.0
    np.testing.assert_allclose(seen, truth, rtol=0, atol=CLOSE * np.ptp(truth, axis=0).max())


@pytest.mark.parametrize("to", EXPORTS)
def test_what_is_large_and_named_in_several_places_is_written_once_a_function(to):
    """Written out each time, an engine of 94 equations would be a text of many megabytes."""
    made = explicit(read_model(SHARED))
    text = EXPORTS[to](made)
    assert len(made.defined) >= 2
    for name in made.defined:
        assert 1 <= len(re.findall(rf"\b{name} = ", text)) <= 3
    assert len(text) < 40_000


def held(U, names):
    """A signal for fmpy whose values are held from each time to the next."""
    signal = np.zeros(2 * len(U) - 1, dtype=[("time", float), *((name, float) for name in names)])
    signal["time"][::2], signal["time"][1::2] = DT * np.arange(len(U)), DT * np.arange(1, len(U))
    for k, name in enumerate(names):
        signal[name][::2], signal[name][1::2] = U[:, k], U[:-1, k]
    return signal


@pytest.mark.parametrize("model", [models()[-2], models()[-1]], ids=name_of)
def test_model_exchange_rests_and_breaks_away_as_the_model_does(model, tmp_path):
    U = movement(model)
    unpacked(model, tmp_path)
    names = list(explicit(model).inputs)
    found = fmpy.simulate_fmu(
        str(tmp_path / "model.fmu"),
        fmi_type="ModelExchange",
        start_time=0.0,
        stop_time=DT * (len(U) - 1),
        output_interval=DT,
        relative_tolerance=1e-10,
        input=held(U, names),
    )
    truth, outputs = expected(model, U), found.dtype.names[1:]
    last = [np.flatnonzero(np.abs(found["time"] - DT * k) < 1e-9)[-1] for k in range(len(U))]
    seen = np.column_stack([found[name][last] for name in outputs])
    np.testing.assert_allclose(seen, truth, rtol=0, atol=CLOSE * np.ptp(truth, axis=0).max())


def test_an_effect_is_a_component_of_the_fmu(tmp_path):
    model = models()[-1]
    description, _ = unpacked(model, tmp_path)
    variables = {v.name: v for v in description.modelVariables}
    assert variables["coulomb_friction_axis.tau_c"].start == "0.5"
    assert variables["coulomb_friction_axis.term"].unit == "N"
    assert "linear_axis_coulomb_friction_axis(" in EXPORTS["c"](explicit(model))
    assert "def coulomb_friction_axis(" in EXPORTS["python"](explicit(model))
    assert "coulomb_friction_axis = " in EXPORTS["modelica"](explicit(model))
    assert "coulomb_friction_axis_of(" in EXPORTS["matlab"](explicit(model))


def test_without_a_compiler_the_fmu_holds_its_sources(monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    found = fmu(explicit(load_model("linear-axis")))
    assert found.library is None and "no C compiler" in found.why
    names = zipfile.ZipFile(io.BytesIO(found.content)).namelist()
    assert sorted(names) == ["modelDescription.xml", "sources/fmi2.c", "sources/linear_axis.c"]


def test_modelica_and_matlab_name_every_equation():
    made = explicit(read_model(AXIS))
    modelica, matlab = EXPORTS["modelica"](made), EXPORTS["matlab"](made)
    assert modelica.count("der(") == len(made.states) == 4
    assert modelica.rstrip().endswith("end soft_axis;")
    assert (
        "Piecewise" not in modelica + matlab and "Max(" not in modelica and "Min(" not in modelica
    )
    assert all(
        re.search(rf"\b{name}\b", modelica) and re.search(rf"q\.{name}\b", matlab)
        for name in made.parameters
    )
    assert modelica.count("(") == modelica.count(")") and matlab.count("(") == matlab.count(")")


def test_dry_friction_says_what_the_text_does_at_rest():
    rubbing = explicit(
        load_model("linear-axis").with_effect("coulomb-friction", "axis", {"tau_c": 20.0})
    )
    assert all("Standstill is exact" in EXPORTS[to](rubbing) for to in ("c", "python"))
    assert all("Standstill: where" in EXPORTS[to](rubbing) for to in ("modelica", "matlab"))


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
    package = tmp_path / "axis.fmu"
    assert run(["export", "linear-axis", "--to", "fmu", "--out", str(package), "--json"]) == DONE
    assert json.loads(capsys.readouterr().out)["library"] == "linux64"
    assert fmpy.read_model_description(str(package)).modelName == "linear-axis"
    assert run(["export", "linear-axis", "--to", "cobol", "--out", str(out)]) == BAD_INPUT
    assert "known are c, python, matlab, modelica, fmu" in capsys.readouterr().err
