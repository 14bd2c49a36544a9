"""A name for what the catalogue does not hold, or holds twice, is not given as if it were certain."""

from pathlib import Path

import numpy as np

from residuum.identification.discrepancy.explain import explain
from residuum.identification.physics import read_model
from residuum.identification.record import Record

PLATE = """name: plate
inputs: {heater: W, ambient: K}
states: {T: {unit: K}}
parameters: {C: {value: 45, unit: J/K, lower: 1}, h: {value: 0.8, unit: W/K, lower: 0.01}}
balances:
  plate: {kind: heat, storage: C * der(T), terms: {heating: heater, loss: -h * (T - ambient)}, temperature: T, ambient: ambient}
outputs: {temperature: {value: T, unit: K}}
"""
FAN = Path(__file__).with_name("fan.yaml").read_text()
STAGE = """name: stage
inputs: {force: N}
states: {q: {unit: m, rate: v}, v: {unit: m/s}}
parameters: {M: {value: 8.5, unit: kg, lower: 0.1}, d: {value: 58, unit: N*s/m, lower: 1}}
balances: {axis: {kind: force, storage: M * der(v), terms: {drive: force, guide: -d * v}, position: q, velocity: v}}
outputs: {position: {value: q, unit: m}, velocity: {value: v, unit: m/s}}
"""


def steps(rng, n, length, low, high):
    return np.concatenate(
        [np.full(length, rng.uniform(low, high)) for _ in range(n // length + 1)]
    )[:n]


def test_heat_that_went_somewhere_for_a_while_need_not_have_gone_through_a_door():
    rng, n = np.random.default_rng(4), 2000
    heater, T, temperature = steps(rng, n, 200, 10.0, 40.0), 290.0, np.empty(n)
    for k in range(n):
        temperature[k] = T
        for _ in range(10):
            T += 0.05 / 48.0 * (heater[k] - 0.85 * (T - 290.0) - 6.0 * (900 <= k < 1100))
    channels = {
        "heater": heater,
        "ambient": np.full(n, 290.0),
        "temperature": temperature + 0.05 * rng.normal(size=n),
    }
    record = Record(channels, {"heater": "W", "ambient": "K", "temperature": "K"}, 0.5)
    found = explain(
        read_model(PLATE), [record], effects=["door-opening", "radiation", "input-offset"]
    )
    assert list(found.accepted) == [("door-opening", "plate")]
    assert found.candidates[0].probability < 0.75 and found.probability_unknown > 0.25


def test_a_lag_that_takes_half_of_what_a_swinging_actuator_leaves_is_not_certain():
    rng, n, h = np.random.default_rng(6), 4000, 0.01
    torque, speed = steps(rng, n, 40, -1.0, 1.0), np.empty(n)
    w, m, rate = 0.0, 0.0, 0.0
    for k in range(n):
        speed[k] = w
        for _ in range(10):
            rate += h / 10 * (9.2**2 * (torque[k] - m) - 2.0 * 0.22 * 9.2 * rate)
            m += h / 10 * rate
            w += h / 10 * (m - 0.0265 * w) / 0.057
    record = Record(
        {"torque": torque, "speed": speed + 0.4 * rng.normal(size=n)},
        {"torque": "N*m", "speed": "rad/s"},
        h,
    )
    found = explain(
        read_model(FAN), [record], effects=["output-lag", "input-delay", "quadratic-drag"]
    )
    assert found.verdict != "missing-effect" or found.candidates[0].probability < 0.75


def test_a_wave_of_some_periods_may_be_a_ripple_or_a_load_that_depends_on_the_position():
    rng, n, h = np.random.default_rng(7), 6000, 2e-3
    course = np.cumsum(steps(rng, n, 400, -0.25, 0.25)) * h
    q, v, force, position, velocity = 0.0, 0.0, np.empty(n), np.empty(n), np.empty(n)
    for k in range(n):
        position[k], velocity[k] = q + 2e-5 * rng.normal(), v + 2e-4 * rng.normal()
        force[k] = 9000.0 * (course[k] - position[k]) - 400.0 * velocity[k]
        for _ in range(20):
            v += h / 20 * (force[k] - 60.0 * v - 3.0 * np.sin(24.0 * 2.0 * np.pi * q)) / 8.9
            q += h / 20 * v
    channels = {"force": force, "position": position, "velocity": velocity}
    record = Record(channels, {"force": "N", "position": "m", "velocity": "m/s"}, h)
    found = explain(
        read_model(STAGE), [record], effects=["tooth-ripple", "position-load", "coulomb-friction"]
    )
    assert 5.0 < 24.0 * np.ptp(position) < 12.0
    first = found.candidates[0]
    assert {first.effect, *first.indistinguishable_from} == {"tooth-ripple", "position-load"}
