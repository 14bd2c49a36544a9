"""The search on unseen blocks names what is missing, in a world that has a little more than its catalogue."""

from dataclasses import replace

import numpy as np
import pytest

from residuum.identification.physics import find_effect, read_model
from residuum.identification.physics.effects.base import Conditions
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.record_search import searched
from residuum.identification.unseen_blocks.tried import Wanted
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
    return searched(
        read_model(MOTOR.replace("rad/V/s", "rad/s/V")), [_record(**how)], None, Wanted(tuple(ids))
    )


def test_a_sensor_that_does_not_see_the_sign_is_named_though_a_filter_is_misled():
    """Beside a small drag that the model lacks too: the world is not one of the catalogue's structures."""
    found = _searched(
        ["output-absolute", "output-offset", "constant-load", "coulomb-friction"],
        seed=4,
        folded=True,
        drag=0.002,
    )
    assert ("output-absolute", "speed") in found.best.keys
    assert share_of(found.base, found.best).value > 0.5


@pytest.mark.parametrize("seed", [5, 6])
def test_dry_friction_is_named_and_sized_in_a_world_with_a_small_drag_besides(seed):
    ids = ["coulomb-friction", "output-offset", "constant-load", "input-power", "output-gain-curve"]
    found = _searched(ids, seed=seed, friction=6.0, drag=0.002)
    assert found.best.keys[0] == ("coulomb-friction", "shaft")
    assert found.best.model.values["coulomb-friction@shaft.tau_c"] == pytest.approx(6.0, rel=0.15)


def test_a_complete_model_is_given_nothing():
    found = _searched(
        ["coulomb-friction", "quadratic-drag", "constant-load", "output-absolute"], seed=7
    )
    assert found.best is found.base


CELL = """
name: cell
inputs: {current: A, room: degC}
states: {T: {unit: degC}}
parameters: {C: {value: 800, unit: J/K, fixed: true}, R: {value: 0.002, unit: ohm, lower: 1e-4, upper: 0.05}}
balances:
  cell: {kind: heat, storage: C * der(T), terms: {joule: R * current**2}, temperature: T, ambient: room}
outputs: {temperature: {value: T, unit: degC}}
"""


def _warm_cell(loss, n=1200, h=15.0):
    """Discharged and at rest in turn; it loses heat to a room of 20 °C, and a little of its heat as the cube of the current."""
    current = np.where(
        np.arange(n) // 150 % 2,
        0.0,
        np.repeat(np.random.default_rng(4).uniform(20.0, 60.0, n // 150), 150),
    )
    T, seen = 20.0, []
    for i in current:
        seen.append(T)
        T += h * (0.004 * i**2 * (1.0 + 0.004 * i) - loss * (T - 20.0)) / 800.0
    noise = 0.02 * np.random.default_rng(5).standard_normal(n)
    channels = {"current": current, "room": np.full(n, 20.0), "temperature": np.array(seen) + noise}
    return Record(channels, {"current": "A", "room": "degC", "temperature": "degC"}, h)


def test_a_loss_is_not_taken_for_a_store_that_never_fills():
    found = searched(
        read_model(CELL),
        [_warm_cell(0.6)],
        None,
        Wanted(("ambient-loss", "second-heat-store", "constant-heat")),
    )
    assert found.best.keys[0].effect == "ambient-loss"
    loss = next(use for use in found.best.model.effects if use.id == "ambient-loss").parameters["h"]
    assert loss.value == pytest.approx(0.6, rel=0.1)
    filled, far = {"C_2": 300.0, "G": 0.4}, {"C_2": 1.2e5, "G": 0.4}
    store, window = find_effect("second-heat-store"), Conditions(15.0, 2800.0, 1.0)
    assert store.shows(filled, window) and not store.shows(far, window)


def test_a_ripple_of_which_each_sample_sees_another_phase_is_none():
    """A pendulum of 1 Hz, sampled at 100 Hz, was said to cog 888 times a radian: half a period passed in a third
    of a millisecond."""
    t = np.arange(0.0, 10.0, 0.01)
    position, velocity = np.sin(2 * np.pi * t), 2 * np.pi * np.cos(2 * np.pi * t)
    swing = Conditions(0.01, 10.0, 1.0, variables={"position": position, "velocity": velocity})
    for name in ("tooth-ripple", "cogging"):
        ripple = find_effect(name)
        assert ripple.shows({"n": 30.0}, swing) and not ripple.shows({"n": 888.0}, swing)
        # at rest nothing passes, and where no speed is known nothing is refused
        assert ripple.shows({"n": 888.0}, replace(swing, variables={"position": position}))
        assert ripple.shows({"n": 888.0}, replace(swing, variables={"velocity": 0.0 * velocity}))
