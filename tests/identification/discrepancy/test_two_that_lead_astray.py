"""Two effects that each change a machine's course are found, though simulations go astray without either."""

import numpy as np
import pytest
from numba import njit

from residuum.identification.discrepancy.explain import explain
from residuum.identification.physics import read_model
from residuum.identification.record import Record

MIXER = """name: mixer
inputs: {torque: N*m}
states: {phi: {unit: rad, rate: omega}, omega: {unit: rad/s}}
parameters: {J: {value: 0.0281, unit: kg*m**2, lower: 0}, b: {value: 0.158, unit: N*m*s/rad, lower: 0}}
balances:
  shaft: {kind: torque, storage: J * der(omega), terms: {motor: torque, bearing: -b * omega}, position: phi, velocity: omega}
outputs: {speed: {value: omega, unit: rad/s}}
"""
J, B, FRICTION, COG, TEETH = 0.0295, 0.15, 0.37, 0.16, 20.0


@njit
def turned(u, h, steps):
    """Speed of a shaft with friction that holds and a cog, in explicit steps; a reversal passes through standstill."""
    speed, w, angle, dt = np.empty(u.size), 0.0, 0.0, h / steps
    for k in range(u.size):
        speed[k] = w
        for _ in range(steps):
            drive = u[k] - B * w - COG * np.sin(TEETH * angle + 2.0)
            if w == 0.0 and abs(drive) <= FRICTION:
                continue
            after = w + dt / J * (drive - FRICTION * np.sign(w if w != 0.0 else drive))
            after = 0.0 if after * w < 0.0 else after
            angle += 0.5 * dt * (w + after)
            w = after
    return speed


@pytest.fixture(scope="module")
def record():
    rng = np.random.default_rng(21)
    u = np.concatenate([np.full(n, rng.uniform(-1.8, 1.8)) for n in rng.integers(30, 250, 60)])[
        :6000
    ]
    speed = turned(u, 0.01, 200)
    return Record(
        {"torque": u, "speed": speed + 0.02 * rng.standard_normal(u.size)},
        {"torque": "N*m", "speed": "rad/s"},
        0.01,
    )


def test_explain_names_both_with_their_sizes(record):
    beside = "coulomb-friction tooth-ripple quadratic-drag position-load input-dead-zone hysteresis"
    found = explain(read_model(MIXER), [record], effects=beside.split())
    assert found.verdict == "missing-effect"
    assert {id for id, _ in found.accepted} >= {"coulomb-friction", "tooth-ripple"}
    values = found.found.best.model.values
    assert values["tooth-ripple@shaft.n"] == pytest.approx(TEETH, rel=0.01)
    assert values["coulomb-friction@shaft.tau_c"] == pytest.approx(FRICTION, rel=0.1)
    assert (values["J"], values["b"]) == (pytest.approx(J, rel=0.02), pytest.approx(B, rel=0.02))
