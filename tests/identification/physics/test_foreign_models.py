"""Transfer functions, state spaces and SymPy equations as models, held against SciPy."""

import json

import numpy as np
import pytest
import scipy.io
import scipy.signal
import sympy

import residuum as rs
from residuum.identification.physics import Experiment, Simulator, load_model
from residuum.service.cli import BAD_INPUT, DONE, run

TOP, BELOW = [3.0, 40.0], [0.02, 1.3, 9.0, 55.0]
DT, N = 0.01, 400


def steps(inputs=1):
    return np.repeat(np.random.default_rng(2).uniform(-1.0, 1.0, (N // 20, inputs)), 20, axis=0)


def moved(physical, U):
    experiment = Experiment(
        U, np.full((N, len(physical.outputs)), np.nan), np.zeros(U.shape[1]), DT
    )
    return Simulator(physical).run(experiment, substeps=20).Y


def truth(system, U):
    A, B, C, D, _ = scipy.signal.cont2discrete(system, DT)
    x, found = np.zeros(len(A)), []
    for u in U:
        found.append(C @ x + D @ u)
        x = A @ x + B @ u
    return np.array(found)


SPACE = (
    np.array([[-1.0, 2.0], [-3.0, -0.5]]),
    np.array([[1.0, 0.0], [0.5, 2.0]]),
    np.array([[1.0, 0.0], [1.0, -1.0]]),
    np.array([[0.0, 0.0], [0.25, 0.0]]),
)


@pytest.mark.parametrize("way", ["json", "mat", "object"])
def test_a_transfer_function_moves_as_scipy_says(tmp_path, way):
    if way == "object":
        physical = rs.linear_model(scipy.signal.TransferFunction(TOP, BELOW)).physical
    else:
        file = tmp_path / f"plant.{way}"
        if way == "json":
            file.write_text(json.dumps({"numerator": TOP, "denominator": BELOW}))
        else:
            scipy.io.savemat(file, {"plant": {"num": TOP, "den": BELOW}})
        physical = load_model(file)
    U = steps()
    expected = truth(scipy.signal.tf2ss(TOP, BELOW), U)
    np.testing.assert_allclose(moved(physical, U), expected, atol=1e-6 * np.ptp(expected))
    assert {"alpha_0", "beta_0"} <= set(physical.free)


@pytest.mark.parametrize("discrete", [False, True])
def test_a_state_space_of_several_signals_moves_as_scipy_says(discrete):
    system = scipy.signal.StateSpace(*SPACE)
    given = system.to_discrete(DT) if discrete else system
    model = rs.linear_model(
        given, inputs=["a", "b"], outputs=["p", "q"], units={"a": "V", "q": "m"}
    )
    U = steps(2)
    expected = truth(SPACE, U)
    np.testing.assert_allclose(moved(model.physical, U), expected, atol=1e-6 * np.ptp(expected))
    assert model.inputs == {"a": "V", "b": ""} and model.outputs["q"] == "m"


def test_python_controls_objects_are_taken():
    control = pytest.importorskip("control")
    U = steps()
    expected = moved(rs.linear_model(scipy.signal.TransferFunction(TOP, BELOW)).physical, U)
    for system in (control.tf(TOP, BELOW), control.ss(control.tf(TOP, BELOW))):
        np.testing.assert_allclose(moved(rs.linear_model(system).physical, U), expected, atol=1e-6)


def test_equations_of_sympy_are_a_model_in_which_effects_act():
    q, v, F, M, d = sympy.symbols("q v F M d", real=True)
    made = rs.equations_model(
        {q: v, v: (F - d * v) / M},
        {"position": q, "speed": v},
        states={"q": "m", "v": "m/s"},
        inputs={"F": "N"},
        parameters={"M": (3.7, "kg"), "d": (2.3, "N*s/m")},
        kinds={"v": "force"},
    )
    axis = (
        load_model("linear-axis")
        .with_values({"M": 3.7})
        .with_effect("viscous-friction", "axis", {"d": 2.3})
    )
    U = steps()
    np.testing.assert_allclose(moved(made.physical, U), moved(axis, U), atol=1e-10)
    assert made.with_effect("coulomb-friction", "v", tau_c=0.2).effects == ("coulomb-friction@v",)
    cases = sympy.Piecewise((v, (v > 0) & ~(v > 2)), (0, True))
    one_way = rs.equations_model({q: cases}, {"y": q}, states={"q": "m"}, inputs={"v": "m/s"})
    assert one_way.physical.balances["q"].terms["rate"].text == "where((v <= 2) and (v > 0), v, 0)"
    with pytest.raises(rs.BadModel, match="last case"):
        rs.equations_model(
            {q: sympy.Piecewise((v, v > 0))}, {"y": q}, states={"q": "m"}, inputs={"v": "m/s"}
        )
    with pytest.raises(rs.BadModel, match="besselj is not known"):
        rs.equations_model(
            {q: sympy.besselj(0, v)}, {"y": q}, states={"q": "m"}, inputs={"v": "m/s"}
        )


def test_a_dead_zone_before_a_transfer_function_is_named(tmp_path, capsys):
    file, record = tmp_path / "plant.json", tmp_path / "record.csv"
    file.write_text(
        json.dumps({"numerator": [2.0], "denominator": [0.3, 1.0], "units": {"u": "V", "y": "m"}})
    )
    rng = np.random.default_rng(5)
    u = np.repeat(rng.uniform(-1.0, 1.0, 30), 20)
    seen = moved_long(np.sign(u) * np.maximum(np.abs(u) - 0.3, 0.0)) + rng.normal(
        scale=2e-3, size=u.size
    )
    rows = "\n".join(
        f"{DT * k:.2f},{a:.6f},{b:.6f}" for k, (a, b) in enumerate(zip(u, seen, strict=True))
    )
    record.write_text(f"time [s],u [V],y [m]\n{rows}\n")
    effects = "input-dead-zone,output-offset"
    assert run(["explain", str(file), str(record), "--effects", effects, "--json"]) == DONE
    assert json.loads(capsys.readouterr().out)["candidates"][0]["effect"] == "input-dead-zone"


def moved_long(u):
    A, B, C, _, _ = scipy.signal.cont2discrete(scipy.signal.tf2ss([2.0], [0.3, 1.0]), DT)
    x, found = np.zeros(1), []
    for each in u:
        found.append(float((C @ x)[0]))
        x = A @ x + B[:, 0] * each
    return np.array(found)


@pytest.mark.parametrize(
    ("content", "says"),
    [
        ({"numerator": [1, 2, 3], "denominator": [1, 2]}, "at most the denominator's degree"),
        ({"numerator": [1]}, "needs numerator and denominator"),
        ({"A": [[1, 2]], "B": [[1]], "C": [[1]]}, "do not fit"),
        (
            {"numerator": [1], "denominator": [1, 1], "gain": 3},
            "'gain' is not part of a linear model",
        ),
        (
            {"numerator": [1], "denominator": [1, 0.5, 0], "sample_time": 0.1},
            "a pole at or left of zero",
        ),
        (
            {"numerator": [1], "denominator": [1, 1], "units": {"x": "m"}},
            "no signal 'x'; there are u, y",
        ),
        ([1], "no transfer function"),
    ],
)
def test_what_is_no_linear_model_is_refused(tmp_path, capsys, content, says):
    file = tmp_path / "plant.json"
    file.write_text(json.dumps(content))
    assert run(["effects", str(file)]) == BAD_INPUT
    error = capsys.readouterr().err
    assert says in error and error.count("\n") == 1
