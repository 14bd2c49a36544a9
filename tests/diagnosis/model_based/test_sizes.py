"""Sizes in their bands: where values move with a temperature, where the scatter is large, and where the model lacks an effect."""

import numpy as np
import pytest

from residuum.diagnosis.diagnosers.model_based import ModelBased, _axis
from residuum.identification.physics import read_model
from residuum.identification.record import Record

MOTOR = """
name: motor
inputs: {voltage: V}
states: {omega: {unit: rad/s}}
parameters:
  K: {value: 0.05, unit: V*s/rad, lower: 0.001}
  R: {value: 1.1, unit: ohm, lower: 0.01}
  J: {value: 6.0e-4, unit: kg*m**2, lower: 1.0e-6}
  d: {value: 2.0e-4, unit: N*m*s/rad, lower: 0}
balances:
  shaft: {kind: torque, storage: J * der(omega), terms: {motor: K * i, air: -d * omega}, velocity: omega}
  winding: {kind: voltage, storage: 0, terms: {supply: voltage, resistance: -R * i, back_emf: -K * omega}, current: i}
outputs:
  speed: {value: omega, unit: rad/s}
  current: {value: i, unit: A}
"""


def warm_motor(seed, fault=1.0):
    """A motor whose resistance follows the winding's temperature, 0 to 60 °C, its resistance times `fault`."""
    rng = np.random.default_rng([seed, 3])
    T = rng.uniform(0.0, 60.0)
    K, R, J, d = 0.05, 1.05 * (1.0 + 0.0039 * (T - 20.0)) * fault, 6e-4, 2e-4
    u = np.repeat(rng.uniform(5.0, 22.0, 12), 100)
    speed, current = np.empty(len(u)), np.empty(len(u))
    omega, h = 100.0, 1e-3
    for k in range(len(u)):
        speed[k], current[k] = omega, (u[k] - K * omega) / R
        for _ in range(10):
            omega += h * (K * (u[k] - K * omega) / R - d * omega) / J
    channels = {
        "voltage": u,
        "speed": speed + 0.5 * rng.standard_normal(len(u)),
        "current": current + 0.03 * rng.standard_normal(len(u)),
        "temperature": T + 0.2 * rng.standard_normal(len(u)),
    }
    units = {"voltage": "V", "speed": "rad/s", "current": "A", "temperature": "degC"}
    return Record(channels, units, 0.01, source=f"motor {seed}"), R


def train_motor(file):
    ModelBased(model=read_model(MOTOR, "motor")).fit(
        [warm_motor(seed)[0] for seed in range(20)]
    ).save(file)


@pytest.fixture(scope="session")
def motor(made_once):
    return ModelBased.load(made_once("motor.base", train_motor))


def size_of(finding, name):
    return next(c for c in finding.evidence["causes"] if c["name"] == name)["value"]


def test_values_that_move_with_a_temperature_scatter_less_than_they_move(motor):
    b = motor.baseline
    at = b.free.index("R")
    # over all temperatures they move by a twelfth on either side
    assert np.sqrt(b.values.S[at, at]) < 0.01 * b.model.values["R"]


def test_a_changed_resistance_lies_in_its_band_at_any_temperature(motor):
    inside = []
    for seed in range(50, 62):
        for fault in (0.8, 1.2):
            record, R = warm_motor(seed, fault)
            size = size_of(motor.score(record), "R")
            inside.append(size["band_95"][0] <= R <= size["band_95"][1])
            assert size["std"] < 2e-2 * R
    assert sum(inside) >= 21


def test_values_far_from_the_usual_are_told_where_they_are(motor):
    for seed in (70, 71):
        record, R = warm_motor(seed, 1.3)
        told = motor.score(record).evidence["parameters"]["R"]
        # to first order a tenth of the change would be missing
        assert abs(told["value"] - R) < 2e-3 * R


CART = """
name: cart
inputs: {force: N}
states: {q: {unit: m, rate: v}, v: {unit: m/s}}
parameters:
  M: {value: 80, unit: kg, lower: 1}
  g: {value: 1, unit: 1, lower: 0.01}
balances:
  axis: {kind: force, storage: M * der(v), terms: {drive: g * force}, position: q, velocity: v}
outputs:
  position: {value: q, unit: m}
  velocity: {value: v, unit: m/s}
"""


def test_where_only_a_ratio_is_determined_one_value_is_held_and_either_may_have_changed():
    judge = ModelBased(model=read_model(CART, "cart"), fix_undetermined=True).fit(
        [_axis(seed) for seed in range(6)]
    )
    assert len(judge.baseline.free) == 1 and set(judge.baseline.asked.free) == {"M", "g"}
    first = judge.score(_axis(51, mass=120.0)).evidence["causes"][0]
    assert {"M", "g"} <= {first["name"], *first["indistinguishable_from"]}
