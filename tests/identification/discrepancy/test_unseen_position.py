"""Of a position that no output tells each record has its own: what acts by it is no cheaper for that."""

import numpy as np
import pytest

from residuum.identification.discrepancy.explain import explain
from residuum.identification.physics import read_model
from residuum.identification.record import Record

FAN = """
name: fan
inputs: {voltage: V}
states: {theta: {unit: rad, rate: omega}, omega: {unit: rad/s}}
parameters:
  K: {value: 0.05, unit: V*s/rad, fixed: true}
  R: {value: 1.0, unit: ohm, lower: 0}
  J: {value: 5e-4, unit: kg*m**2, lower: 0}
balances:
  shaft: {kind: torque, storage: J * der(omega), terms: {motor: K * i}, position: theta, velocity: omega}
  winding: {kind: voltage, storage: 0, terms: {supply: voltage, resistance: -R * i, back_emf: -K * omega}, current: i}
outputs: {speed: {value: omega, unit: rad/s}, current: {value: i, unit: A}}
"""
STEP, FINE, WINDOW = 0.01, 20, 500


def windows(seed, count=15):
    """Windows of a fan with dry friction and drag, driven by ever new voltages, turning one way."""
    rng = np.random.default_rng(seed)
    n = count * WINDOW
    voltage = np.concatenate(
        [np.full(k, rng.uniform(3.0, 12.0)) for k in rng.integers(40, 150, n // 40)]
    )[:n]
    omega, speed, current = 0.0, np.empty(n), np.empty(n)
    for k in range(n):
        speed[k], current[k] = omega, (voltage[k] - 0.05 * omega) / 1.2
        for _ in range(FINE):
            torque = 0.05 * (voltage[k] - 0.05 * omega) / 1.2 - 1.6e-6 * omega**2
            omega += STEP / FINE * (torque - 3e-3 * np.tanh(omega / 0.5)) / 4e-4
    speed += 0.16 * rng.standard_normal(n)
    current += 0.01 * rng.standard_normal(n)
    units = {"voltage": "V", "speed": "rad/s", "current": "A"}
    channels = {"voltage": voltage, "speed": speed, "current": current}
    return [
        Record(
            {name: values[at : at + WINDOW] for name, values in channels.items()},
            units,
            STEP,
            t0=STEP * at,
        )
        for at in range(0, n, WINDOW)
    ]


@pytest.mark.parametrize("seed", [1, 4])
def test_a_spring_with_a_place_of_its_own_in_each_record_is_no_dry_friction(seed):
    found = explain(read_model(FAN), windows(seed))
    assert {id for id, _ in found.accepted} == {"quadratic-drag", "coulomb-friction"}
    # what cannot be told from one has doubts of its own, too
    for candidate in found.candidates:
        assert candidate.alike == () or all(q.std > 0.0 for q in candidate.parameters.values())
