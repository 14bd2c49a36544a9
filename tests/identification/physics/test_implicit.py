"""Flows that meet in a node without volume, and a diode: solved inside the step, beside SciPy's root finder."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq, fsolve

import residuum as rs
from residuum.identification.errors import BadModel
from residuum.identification.physics import Experiment, Simulator, read_model
from residuum.identification.physics.export import explicit
from residuum.identification.physics.files.model_file import write_model

NODE = """
name: two valves in a row
inputs: {inflow: m**3/s}
states: {h: {unit: m}}
parameters:
  A: {value: 0.5, unit: m**2}
  a: {value: 0.02, unit: m**2.5/s}
  b: {value: 0.03, unit: m**2.5/s}
  f: {value: 0.004, unit: m**2/s}
balances:
  tank: {kind: volume, storage: A * der(h), terms: {in: inflow, out: "-a * sqrt(max(h - n, 0))"}, level: h}
  node:
    kind: volume
    storage: 0
    terms: {in: "a * sqrt(max(h - n, 0))", out: "-b * sqrt(max(n, 0)) - f * n"}
    level: n
    start: 0.5
outputs: {level: {value: h, unit: m}, middle: {value: n, unit: m}}
initial: {h: 1.0}
"""
DIODE = """
name: clipped filter
inputs: {u: V}
states: {q: {unit: A}}
parameters:
  R: {value: 2.0, unit: ohm}
  L: {value: 0.1, unit: V*s/A}
  I: {value: 0.001, unit: A, lower: 0}
  V: {value: 0.3, unit: V}
constants: {ohm: 1 ohm}
balances:
  source:
    kind: voltage
    storage: 0
    terms: {drive: u, resistor: -R * i, diode: -V * log(1 + max(d / I, -0.9))}
    current: i
    start: 0.1
  branch: {kind: voltage, storage: 0, terms: {total: ohm * (i - q - d)}, current: d, start: 0.1}
  coil: {kind: voltage, storage: L * der(q), terms: {drive: u, resistor: -R * i}, current: q}
outputs: {current: {value: i, unit: A}}
initial: {q: 0}
"""


def given(columns, outputs):
    U = np.repeat(np.random.default_rng(0).uniform(0.002, 0.03, (20, columns)), 20, axis=0)
    return Experiment(U, np.full((400, outputs), np.nan), np.zeros(columns), 0.5)


def test_a_node_between_two_valves_is_solved_as_scipy_solves_it():
    e, model = given(1, 2), read_model(NODE)

    def middle(h):
        return brentq(
            lambda n: 0.02 * np.sqrt(max(h - n, 0)) - 0.03 * np.sqrt(n) - 0.004 * n,
            0.0,
            h,
            xtol=1e-14,
        )

    h, seen = 1.0, []
    for (u,) in e.U:
        seen.append((h, middle(h)))
        rate = lambda t, x, u=u: [(u - 0.02 * np.sqrt(max(x[0] - middle(x[0]), 0))) / 0.5]  # noqa: E731
        h = solve_ivp(rate, (0.0, 0.5), [h], rtol=1e-9, atol=1e-11).y[0, -1]
    assert np.abs(Simulator(model).run(e, substeps=2).Y - seen).max() < 1e-6


def test_two_balances_that_define_each_other_are_solved_together():
    model, e = read_model(DIODE), given(1, 1)
    e.U[:] *= 60.0
    y = Simulator(model).run(e, substeps=40).Y[:, 0]
    q = Simulator(model).run(e, substeps=40).X[:, 0]
    for k in range(0, 400, 37):
        i = fsolve(
            lambda i, k=k: e.U[k, 0] - 2.0 * i - 0.3 * np.log(1 + max((i[0] - q[k]) / 0.001, -0.9)),
            [q[k] + 0.01],
        )[0]
        assert y[k] == pytest.approx(i, rel=1e-7)


@pytest.mark.parametrize(("text", "names"), [(NODE, ("a", "b", "A")), (DIODE, ("R", "V", "L"))])
def test_slopes_are_exact(text, names):
    model, e = read_model(text), given(1, text.count("value: n") + 1)
    run = Simulator(model).run(e, slopes=names, substeps=40)
    for k, name in enumerate(names):
        h = 1e-6 * model.values[name]
        up, down = (
            Simulator(model).run(e, values={name: model.values[name] + s * h}, substeps=40).Y
            for s in (1, -1)
        )
        change = (up - down) / (2 * h)
        assert np.abs(run.dY[:, :, k] - change).max() < 1e-4 * np.abs(change).max()


def test_a_written_model_keeps_its_start_values_and_no_export_holds_it():
    model = read_model(write_model(read_model(NODE)))
    assert model.balances["node"].start == 0.5
    with pytest.raises(BadModel, match=r"solves node by Newton.s method"):
        explicit(model)


def test_what_cannot_be_solved_is_refused():
    with pytest.raises(
        BadModel, match=r"line 15, column \d+: algebraic loop: balance 'node'.*start: 1.0"
    ):
        read_model(NODE.replace("    start: 0.5\n", ""))
    index_2 = DIODE.replace("ohm * (i - q - d)", "ohm * (i - q) + 0 * ohm * d").replace(
        ", diode: -V * log(1 + max(d / I, -0.9))", ""
    )
    with pytest.raises(BadModel, match="index 2: balances branch do not determine"):
        Simulator(read_model(index_2))
    assert rs.model(NODE).outputs == {"level": "m", "middle": "m"}
