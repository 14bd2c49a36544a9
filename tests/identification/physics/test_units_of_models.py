"""Models in any unit: a level in volts, a textbook's normalised motor, ticks of an encoder; models without inputs or states."""

import numpy as np
import pytest

from residuum.identification.errors import BadModel
from residuum.identification.physics import Simulator, estimate, match, read_model
from residuum.identification.record import Record

TANK = """
name: tank
inputs: {pump: V}
states: {x: {unit: V}}
parameters:
  k: {value: 0.05, unit: 1, lower: 0.001, upper: 1}
  c: {value: 0.03, unit: 1, lower: 0.001, upper: 1}
balances:
  tank: {kind: volume, storage: der(x), terms: {pump: k * pump, out: -c * sqrt(max(x, 0))}, level: x}
outputs: {level: {value: x, unit: V}}
"""
MOTOR = """
name: motor
inputs: {voltage: V}
states: {n: {unit: rpm}}
parameters: {T: {value: 0.3, unit: s, lower: 0.01}, G: {value: 30, unit: rpm/V, lower: 1}}
balances:
  shaft: {kind: torque, storage: T * der(n), terms: {motor: G * voltage, loss: -n}, velocity: n}
outputs: {speed: {value: n, unit: rpm}}
"""
ENCODER = MOTOR.replace("rpm", "ticks/s")
COIL = """
name: coil
inputs: {voltage: V}
states: {}
parameters: {R: {value: 2, unit: ohm, fixed: true}}
balances:
  winding: {kind: voltage, storage: 0, terms: {supply: voltage, resistance: -R * i}, current: i}
outputs: {current: {value: i, unit: A}}
"""
FREE = """
name: cooling
inputs: {}
states: {x: {unit: K}}
parameters: {a: {value: 0.5, unit: 1/s, lower: 0}}
balances:
  body: {kind: heat, storage: der(x), terms: {loss: -a * x}, temperature: x}
outputs: {temperature: {value: x, unit: K}}
"""


@pytest.mark.parametrize(("text", "unit"), [(TANK, "V/s"), (MOTOR, "rpm"), (ENCODER, "ticks/s")])
def test_a_balance_may_be_in_any_unit(text, unit):
    assert next(iter(read_model(text).balances.values())).unit == unit


def test_a_normalised_motor_is_estimated_in_its_own_units():
    model = read_model(ENCODER)
    rng = np.random.default_rng(1)
    u = np.repeat(rng.uniform(-5, 5, 40), 10)
    shell = Record(
        {"voltage": u, "speed": np.zeros(400)}, {"voltage": "V", "speed": "ticks/s"}, 0.02
    )
    matched, (experiment,) = match(model, [shell])
    truth = Simulator(matched.with_values({"T": 0.2, "G": 45.0})).run(experiment).Y[:, 0]
    record = Record({"voltage": u, "speed": truth}, {"voltage": "V", "speed": "ticks/s"}, 0.02)
    found = estimate(*match(model, [record]))
    assert found.model.values == pytest.approx({"T": 0.2, "G": 45.0}, rel=1e-3)


def test_a_word_that_nobody_knows_counts_as_a_radian_does_but_is_not_another_word():
    turning = """
name: belt
inputs: {voltage: V}
states: {phi: {unit: rad, rate: w}, w: {unit: rad/s}}
parameters: {J: {value: 1, unit: kg*m**2}, b: {value: 2, unit: N*m/V}, a: {value: 1, unit: N*m*s/rad}, c: {value: 1, unit: rad}}
balances:
  shaft: {kind: torque, storage: J * der(w), terms: {drive: b * voltage, loss: -a * w}, position: phi, velocity: w}
outputs: {angle: {value: phi + c, unit: rad}}
"""
    assert read_model(turning.replace("rad", "ticks")).balances["shaft"].kind == "torque"
    with pytest.raises(BadModel, match=r"unit clash"):
        read_model(
            turning.replace("rad", "ticks").replace(
                "c: {value: 1, unit: ticks}", "c: {value: 1, unit: counts}"
            )
        )
    with pytest.raises(BadModel, match=r"unit clash"):
        read_model(
            turning.replace("rad", "ticks").replace(
                "c: {value: 1, unit: ticks}", "c: {value: 1, unit: V}"
            )
        )


def test_a_model_without_states_and_free_values_is_held_against_its_record():
    u = np.linspace(-4.0, 4.0, 50)
    record = Record({"voltage": u, "current": u / 2.0 + 0.1}, {"voltage": "V", "current": "A"}, 0.1)
    found = estimate(*match(read_model(COIL), [record]))
    assert found.rmse == pytest.approx([0.1])


def test_a_model_without_inputs_is_estimated():
    t = 0.05 * np.arange(100)
    record = Record({"temperature": 3.0 * np.exp(-0.8 * t)}, {"temperature": "K"}, 0.05)
    found = estimate(*match(read_model(FREE), [record]))
    assert found.model.values["a"] == pytest.approx(0.8, rel=1e-3)
