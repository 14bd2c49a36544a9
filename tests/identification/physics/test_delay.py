"""An input that acts late: beside the exact solution, estimated, or refused."""

import numpy as np
import pytest

import residuum as rs
from residuum.identification.errors import BadModel
from residuum.identification.physics import Experiment, Simulator, read_model
from residuum.identification.physics.export import explicit
from residuum.identification.physics.files.model_file import write_model

OVEN = """
name: oven
inputs: {power: W, fan: ""}
states: {T: {unit: K}}
parameters: {C: {value: 500, unit: J/K, lower: 1}, h: {value: 8, unit: W/K, lower: 0}, L: {value: 2.6, unit: s, lower: 0}}
constants: {loss: 0.9}
balances:
  oven:
    kind: heat
    storage: C * der(T)
    terms: {heater: "delay(loss * power, L)", cooling: -h * T * (1 + fan)}
    temperature: T
outputs: {temperature: {value: T, unit: K}}
initial: {T: 0}
"""
STEP = 1.0


def heated(delay=2.6, n=600, noise=0.0):
    """K. J. Åström's first order with dead time, solved exactly between the instants where the late power changes."""
    rng = np.random.default_rng(0)
    power, temperature, seen = np.repeat(rng.uniform(0.0, 2000.0, n // 30), 30), 0.0, []
    for k in range(n):
        seen.append(temperature)
        whole, part = divmod(delay, STEP)
        before, after = (power[max(k - int(whole) - i, 0)] for i in (1, 0))
        for late, length in ((before, part), (after, STEP - part)):
            decay = np.exp(-8.0 / 500.0 * length)
            temperature = temperature * decay + 0.9 * late / 8.0 * (1.0 - decay)
    return power, np.array(seen) + noise * rng.standard_normal(n)


def test_a_delay_of_parts_of_a_sample_is_simulated_and_has_exact_slopes():
    power, y = heated()
    model, e = (
        read_model(OVEN),
        Experiment(np.column_stack([power, 0 * power]), y[:, None], np.zeros(2), STEP),
    )
    run = Simulator(model).run(e, slopes=("L",))
    # of some 120 K; within a sample the mean of a held power acts
    assert np.abs(run.Y[:, 0] - y).max() < 0.02
    up, down = (Simulator(model).run(e, values={"L": 2.6 + s * 1e-6}).Y for s in (1, -1))
    assert np.abs(run.dY[:, :, 0] - (up - down) / 2e-6).max() < 1e-4
    assert np.abs(run.dY).max() > 1.0


def test_a_delay_is_estimated_and_written():
    power, y = heated(delay=3.7, noise=0.05)
    record = rs.Record(
        {"power": power, "fan": 0 * power, "temperature": y},
        {"power": "W", "fan": "1", "temperature": "K"},
        STEP,
    )
    found = rs.model(OVEN).estimate(record, hold="zero-order")
    assert found.parameters["L"]["value"] == pytest.approx(3.7, abs=0.03)
    assert read_model(write_model(found.model.physical)).values == found.model.physical.values


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        (
            "delay(loss * power, L)",
            "delay(T, L)",
            "delay.. of 'T': what is delayed is made of inputs",
        ),
        ("delay(loss * power, L)", "delay(loss * power, 2)", "by a parameter or a constant"),
        ("delay(loss * power, L)", "delay(loss * power, h)", "unit clash: delay"),
        (
            "delay(loss * power, L)",
            "delay(power, L) + power",
            "more than one delay; declare a second input",
        ),
        ("delay(loss * power, L)", "delay(delay(power, L), L)", "one is enough"),
        ("unit: s, lower: 0", "unit: s", "must not be negative"),
    ],
)
def test_refusals_say_what_and_where(old, new, says):
    with pytest.raises(BadModel, match=r"line 11, column \d+: .*" + says):
        read_model(OVEN.replace(old, new))


def test_no_export_holds_a_delay():
    with pytest.raises(BadModel, match="input 'power' is delayed, which no exported text can hold"):
        explicit(read_model(OVEN))
