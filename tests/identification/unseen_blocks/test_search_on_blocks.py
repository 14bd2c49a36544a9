"""The search on unseen blocks names what is missing, in a world that has a little more than its catalogue."""

import numpy as np
import pytest

from residuum.identification.physics import read_model
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.at_its_timing import searched
from residuum.identification.unseen_blocks.search import Wanted
from residuum.identification.unseen_blocks.verdict import share_of

MOTOR = """
name: motor
inputs: {voltage: V}
states: {omega: {unit: rad/s}}
parameters:
  T: {value: 0.5, unit: s, lower: 0.01, upper: 5}
  G: {value: 10, unit: rad/V/s, lower: 1, upper: 300}
balances:
  shaft: {kind: torque, storage: T * der(omega), terms: {motor: G * voltage, loss: -omega}, velocity: omega}
outputs: {speed: {value: omega, unit: rad/s}}
"""


def _record(seed, n=2000, folded=False, friction=0.0, drag=0.0):
    """A motor stepped by Euler at a tenth of the sample, with noise of 0.02 rad/s."""
    rng, h = np.random.default_rng(seed), 0.002
    u = np.repeat(rng.uniform(-4.0, 4.0, n // 25), 25)
    omega, speed = 0.0, np.zeros(n)
    for k in range(n):
        speed[k] = omega
        for _ in range(10):
            push = 12.0 * u[k] - omega - drag * omega * abs(omega)
            resist = np.sign(omega) * friction if omega else np.clip(push, -friction, friction)
            after = omega + h * (push - resist) / 0.3
            omega = 0.0 if friction and omega * after < 0.0 else after
    y = (np.abs(speed) if folded else speed) + 0.02 * rng.standard_normal(n)
    return Record({"voltage": u, "speed": y}, {"voltage": "V", "speed": "rad/s"}, 0.02)


def _searched(ids, **how):
    return searched(read_model(MOTOR.replace("rad/V/s", "rad/s/V")), [_record(**how)], None, Wanted(tuple(ids)))


def test_a_sensor_that_does_not_see_the_sign_is_named_though_a_filter_is_misled():
    """Beside a small drag that the model lacks too: the world is not one of the catalogue's structures."""
    found = _searched(["output-absolute", "output-offset", "constant-load", "coulomb-friction"], seed=4, folded=True, drag=0.002)
    assert ("output-absolute", "speed") in found.best.keys
    assert share_of(found.base, found.best).value > 0.5


@pytest.mark.parametrize("seed", [5, 6])
def test_dry_friction_is_named_and_sized_in_a_world_with_a_small_drag_besides(seed):
    ids = ["coulomb-friction", "output-offset", "constant-load", "input-power", "output-gain-curve"]
    found = _searched(ids, seed=seed, friction=6.0, drag=0.002)
    assert found.best.keys[0] == ("coulomb-friction", "shaft")
    assert found.best.model.values["coulomb-friction@shaft.tau_c"] == pytest.approx(6.0, rel=0.15)


def test_a_complete_model_is_given_nothing():
    found = _searched(["coulomb-friction", "quadratic-drag", "constant-load", "output-absolute"], seed=7)
    assert found.best is found.base
