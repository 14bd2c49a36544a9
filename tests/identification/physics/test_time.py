"""A clock in a model: Duffing's oscillator, driven by what no column records; beside SciPy, whole and in windows."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import residuum as rs
from residuum.identification.errors import BadModel
from residuum.identification.physics import Simulator, estimate, match, read_model, windows
from residuum.identification.physics.export import EXPORTS, explicit
from residuum.identification.physics.files.model_file import write_model
from residuum.identification.residual_analysis.feedback import turned_timing
from residuum.identification.residual_analysis.lower_rate import at_every

DUFFING = """
name: duffing
inputs: {push: N}
states: {q: {unit: m, rate: v}, v: {unit: m/s}}
parameters:
  d: {value: 0.3, unit: N*s/m, lower: 0}
  k: {value: 1.0, unit: N/m}
  F: {value: 0.5, unit: N}
  w: {value: 1.2, unit: rad/s, lower: 0.1}
constants: {m: 1 kg}
balances:
  mass: {kind: force, storage: m * der(v), terms: {spring: -k * q, damper: -d * v, drive: F * cos(w * time), push: push}}
outputs: {position: {value: q, unit: m}}
"""
STEP = 0.05


def swung(cubic=0.0, n=1200, noise=0.0):
    """By SciPy, the push held over each sample."""
    rng = np.random.default_rng(0)
    push, x, seen = np.repeat(rng.uniform(-0.4, 0.4, n // 30), 30), [0.2, 0.0], []
    for k, u in enumerate(push):
        seen.append(x[0])

        def rate(t, x, u=u):
            return [x[1], 0.5 * np.cos(1.2 * t) + u - 0.3 * x[1] - x[0] - cubic * x[0] ** 3]

        x = solve_ivp(rate, (k * STEP, (k + 1) * STEP), x, rtol=1e-9, atol=1e-11).y[:, -1]
    y = np.array(seen) + noise * rng.standard_normal(n)
    return rs.Record({"push": push, "position": y}, {"push": "N", "position": "m"}, STEP, 100.0)


def test_time_goes_on_in_windows_and_is_exact_at_either_timing_and_at_a_lower_rate():
    model, (e,) = match(read_model(DUFFING), [swung()], hold="zero-order")
    simulator = Simulator(model)
    whole = simulator.run(e, {"q": 0.2}, substeps=4)
    assert np.abs(whole.Y - e.Y).max() < 1e-6
    late = e.window(700, 1200)
    again = simulator.run(late, {"q": whole.X[700, 0], "v": whole.X[700, 1]}, substeps=4)
    assert np.abs(again.Y - whole.Y[700:]).max() < 1e-12
    (other,) = turned_timing([e])
    assert other.hold.tolist() == [1.0, 1.0] and e.hold.tolist() == [0.0, 1.0]
    assert at_every(late, 2).U[:, 1] == pytest.approx(STEP * (700 + 2 * np.arange(250)))


def test_what_the_clock_drives_is_estimated_in_windows():
    model, (e,) = match(
        read_model(DUFFING).with_values({"F": 0.3, "w": 1.17}),
        [swung(noise=0.002)],
        hold="zero-order",
    )
    found = estimate(model, windows(e, 200)).model.values
    assert found["w"] == pytest.approx(1.2, rel=0.005) and found["F"] == pytest.approx(
        0.5, rel=0.02
    )


def test_a_written_model_and_its_exports_have_the_clock():
    model = read_model(write_model(read_model(DUFFING)))
    assert model.inputs["time"].is_clock
    written = explicit(model)
    assert written.inputs == ("push",)
    assert "cos(time*w)" in EXPORTS["modelica"](written).replace(" ", "") and "= t;" in EXPORTS[
        "c"
    ](written)


def test_a_name_that_the_file_declares_is_its_own():
    model = read_model(DUFFING.replace("inputs: {push: N}", "inputs: {push: N, time: s}"))
    assert not model.inputs["time"].is_clock
    with pytest.raises(
        BadModel, match=r"line 3, column \d+: input 'time': a clock is in s, not 'm'"
    ):
        read_model(
            DUFFING.replace(
                "inputs: {push: N}", "inputs: {push: N, time: {unit: m, default: clock}}"
            )
        )
