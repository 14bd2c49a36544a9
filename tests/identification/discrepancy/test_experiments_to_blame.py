"""Where windows are too long or forget, or inputs were taken for moving evenly, no structure is right until that is mended."""

import numpy as np
from numba import njit

from residuum.identification.discrepancy.explain import explain
from residuum.identification.physics import load_model, read_model
from residuum.identification.record import Record
from residuum.simulation import MACHINES

SERVO = """name: servo
inputs: {torque: N*m}
states: {q: {unit: rad, rate: w}, w: {unit: rad/s}}
parameters: {J: {value: 0.0215, unit: kg*m**2, lower: 1e-5}, d: {value: 0.055, unit: N*m*s/rad, lower: 0}}
balances:
  axis: {kind: torque, storage: J * der(w), terms: {drive: torque, damping: -d * w}, position: q, velocity: w}
outputs: {angle: {value: q, unit: rad}, speed: {value: w, unit: rad/s}}
"""
WOOFER = """name: woofer
inputs: {voltage: V}
states: {x: {unit: m, rate: v}, v: {unit: m/s}}
parameters:
  M: {value: 0.0162, unit: kg, fixed: true}
  Bl: {value: 6.3, unit: N/A, lower: 0.1}
  R: {value: 6.2, unit: ohm, lower: 0.1}
  k: {value: 1650, unit: N/m, lower: 0}
  d: {value: 1.2, unit: N*s/m, lower: 0}
balances:
  cone: {kind: force, storage: M * der(v), terms: {motor: Bl * i, suspension: -k * x, damping: -d * v}, position: x, velocity: v}
  coil: {kind: voltage, storage: 0, terms: {supply: voltage, resistance: -R * i, back_emf: -Bl * v}, current: i}
outputs: {excursion: {value: x, unit: m}, current: {value: i, unit: A}}
"""


@njit
def held_in_its_loop(course, h, steps, stiffness, damping, weight, strain, friction, rise, cog):
    """A servo axis in its position loop: a weight on its arm, a strained bearing, friction that holds, a cog; explicit steps."""
    torque, angle, speed = np.empty(course.size), np.empty(course.size), np.empty(course.size)
    q, w, z, dt = 0.0, 0.0, 0.0, h / steps
    for t in range(course.size):
        u = stiffness * (course[t] - q) - damping * w
        torque[t], angle[t], speed[t] = u, q, w
        for _ in range(steps):
            drive = u - 0.052 * w - weight * np.sin(q + 0.5) - strain * z - cog * np.sin(12.0 * q)
            held = friction + rise * np.exp(-((w / 0.48) ** 2))
            if w == 0.0 and abs(drive) <= held:
                continue
            after = w + dt / 0.0225 * (drive - held * np.sign(w if w != 0.0 else drive))
            w = 0.0 if friction > 0.0 and after * w < 0.0 else after
            z += dt * (w - abs(w) * z) / 0.1
            q += dt * w
    return torque, angle, speed


def record_of_the_axis(stiffness, damping, **effects):
    rng = np.random.default_rng(3)
    course = (
        np.cumsum(
            np.concatenate(
                [np.full(n, rng.uniform(-5.0, 5.0)) for n in rng.integers(100, 700, 40)]
            )[:6000]
        )
        * 2e-3
    )
    course -= np.linspace(0.0, course[-1], 6000)
    names = ("weight", "strain", "friction", "rise", "cog")
    torque, angle, speed = held_in_its_loop(
        course, 2e-3, 60, stiffness, damping, *(effects.get(n, 0.0) for n in names)
    )
    channels = {
        "torque": torque,
        "angle": angle + 2e-4 * rng.normal(size=6000),
        "speed": speed + 0.01 * rng.normal(size=6000),
    }
    return Record(channels, {"torque": "N*m", "angle": "rad", "speed": "rad/s"}, 2e-3)


@njit
def moved(voltage, h, steps):
    """A loudspeaker with inductance and friction in its suspension."""
    excursion, current = np.empty(voltage.size), np.empty(voltage.size)
    x, v, i, dt = 0.0, 0.0, 0.0, h / steps
    for t in range(voltage.size):
        excursion[t], current[t] = x, i
        for _ in range(steps):
            i += dt / 1.09e-3 * (voltage[t] - 5.94 * i - 6.71 * v)
            force = 6.71 * i - 1718.0 * x - 1.29 * v
            after = v + dt / 0.0162 * (force - 0.594 * np.sign(v if v != 0.0 else force))
            v = 0.0 if after * v < 0.0 or (v == 0.0 and abs(force) <= 0.594) else after
            x += dt * v
    return excursion, current


def test_strain_goes_on_from_window_to_window_and_through_those_kept_aside():
    effects = ["position-load", "hysteresis", "linear-spring", "constant-load"]
    found = explain(
        read_model(SERVO),
        [record_of_the_axis(6.0, 0.5, weight=0.61, strain=0.375)],
        effects=effects,
    )
    assert {id for id, _ in found.accepted} == {"position-load", "hysteresis"}
    values = found.found.best.model.values
    assert (
        abs(values["hysteresis@axis.f_c"] - 0.375) < 0.01
        and abs(values["hysteresis@axis.x_0"] - 0.1) < 0.005
    )


def test_friction_and_the_cog_of_an_axis_that_holds_on_it_are_named():
    """It goes astray over its windows: what is left beside both is told."""
    effects = ["coulomb-friction", "stribeck-friction", "tooth-ripple"]
    found = explain(
        read_model(SERVO),
        [record_of_the_axis(2.0, 0.1, friction=0.24, rise=0.31, cog=0.22)],
        effects=effects,
    )
    named = {id for id, _ in found.accepted}
    assert "tooth-ripple" in named and named & {"coulomb-friction", "stribeck-friction"}
    assert max(times for _, _, times in found.left.values()) > 2.0


def test_a_delay_of_half_a_sample_that_the_timing_of_the_inputs_feigned_goes_with_it():
    rng = np.random.default_rng(1)
    t = np.arange(12_000) / 2000.0
    swept = sum(
        np.sin(2 * np.pi * f * t + p)
        for f, p in zip(np.geomspace(2.0, 60.0, 12), rng.uniform(0, 6, 12), strict=True)
    )
    voltage = (
        1.6 * swept
        + 3.0
        * np.concatenate([np.full(n, rng.uniform(-1.0, 1.0)) for n in rng.integers(40, 600, 60)])[
            :12_000
        ]
    )
    excursion, current = moved(voltage, 1 / 2000.0, 100)
    channels = {
        "voltage": voltage,
        "excursion": excursion + 2.3e-6 * rng.normal(size=t.size),
        "current": current + 2.3e-3 * rng.normal(size=t.size),
    }
    record = Record(channels, {"voltage": "V", "excursion": "m", "current": "A"}, 1 / 2000.0)
    effects = [
        "coulomb-friction",
        "directional-friction",
        "inductance",
        "input-delay",
        "output-lag",
    ]
    found = explain(read_model(WOOFER), [record], effects=effects)
    assert {id for id, _ in found.accepted} == {"coulomb-friction", "inductance"}
    assert not any(e.hold.any() for e in found.found.validation.data.experiments)
    # a lag of 9 µs takes a part
    assert abs(found.found.best.model.values["inductance@coil.L"] - 1.09e-3) < 7e-5


def test_two_bodies_on_a_spring_are_not_half_a_sample_late_because_the_timing_was_chosen_without_them():
    """The rigid drive is likelier with a voltage that moves evenly; with the spring four times the noise stayed there."""
    signals = MACHINES["gate-drive"](
        seed=61, effects={"elastic-transmission": "medium"}, profile="rich"
    ).simulate(15.0)
    record = Record(signals.channels, signals.units, signals.sample_time)
    found = explain(
        load_model("gate-drive"),
        [record],
        effects=["elastic-transmission", "backlash", "coulomb-friction"],
    )
    assert (
        list(found.accepted) == [("elastic-transmission", "shaft")]
        and found.candidates[0].probability > 0.9
    )
    assert not any(e.hold.any() for e in found.found.validation.data.experiments)
    assert max(times for _, _, times in found.left.values()) < 1.3
    assert abs(found.candidates[0].parameters["share"].value - 2.46e-4 / 2.812e-4) < 2e-3
