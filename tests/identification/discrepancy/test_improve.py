"""What improve keeps in the user's model, and which part of a record it keeps aside."""

import numpy as np
import pytest
from numba import njit

from residuum.identification.discrepancy.explain import explain
from residuum.identification.discrepancy.improve import improve
from residuum.identification.discrepancy.improvement import quantities_of
from residuum.identification.physics import read_model
from residuum.identification.record import Record
from residuum.library.answers.improvement import improvement_json, improvement_text

VESSEL = """name: vessel
inputs: {pump: V}
states: {level: {unit: m}}
parameters: {A: {value: 0.2, unit: m**2, fixed: true}, k: {value: 7.5e-5, unit: m**3/s/V, lower: 0},
  c: {value: 5.1e-4, unit: m**2.5/s, lower: 0}}
balances: {vessel: {kind: volume, storage: A * der(level), terms: {in: k * pump, out: -c * sqrt(level)}, level: level}}
outputs: {height: {value: level, unit: m}}
"""


VAN = """name: van
inputs: {throttle: '%'}
states: {v: {unit: m/s}}
parameters: {M: {value: 2600, unit: kg, fixed: true}, G: {value: 56, unit: N, lower: 0},
  B: {value: 9.5, unit: N*s/m, lower: 0}}
balances: {body: {kind: force, storage: M * der(v), terms: {engine: G * throttle, losses: -B * v}, velocity: v}}
outputs: {speed: {value: v, unit: m/s}}
"""


def van(throttle, v, rng):
    """A van with drag up a slope, in Euler steps of 10 ms, read every .2 s."""
    speed = np.empty(throttle.size)
    for k in range(throttle.size):
        speed[k] = v
        for _ in range(20):
            v += 0.01 * (60.0 * throttle[k] - 0.75 * v * abs(v) - 420.0 - 9.0 * v) / 2600.0
    noisy = speed + 0.1 * rng.standard_normal(throttle.size)
    return Record({"throttle": throttle, "speed": noisy}, {"throttle": "%", "speed": "m/s"}, 0.2)


def driving_and_coasting(seed):
    rng = np.random.default_rng(seed)
    throttle = np.concatenate(
        [np.full(n, rng.uniform(8.0, 60.0)) for n in rng.integers(40, 220, 60)]
    )[:4500]
    return [van(throttle, 12.0, rng), van(np.zeros(450), 25.0, rng)]


def test_two_effects_that_only_together_lower_the_error_of_a_van_that_coasts():
    """Under way either makes up for the other, with the losses; where the engine drives nothing each alone is wrong. A dead zone
    of the throttle, which the drive cannot tell from a load, does not slow a van that coasts.
    """
    found = improve(read_model(VAN), driving_and_coasting(7))
    assert found.history[-1].error < 0.12
    assert found.history[0].error > 0.5
    assert found.model.values["quadratic-drag@body.c"] == pytest.approx(0.75, rel=0.05)
    assert found.verdict == "adequate"


def test_the_slope_and_the_drag_of_a_van_are_found():
    """A van that never rolls backwards does not tell a slope from dry friction."""
    found = improve(read_model(VAN), driving_and_coasting(9))
    load, drag = sorted(found.added, key=lambda use: use.id)
    assert load.id in ("constant-load", "coulomb-friction") and drag.id == "quadratic-drag"
    assert found.model.values["quadratic-drag@body.c"] == pytest.approx(0.75, rel=0.05)
    assert next(iter(load.parameters.values())).value == pytest.approx(420.0, rel=0.1)
    assert found.history[-1].error < 0.12


@njit
def levels(u, c_weir, rim):
    """Explicit Euler, twenty steps a second, of a vessel of .2 m² with a weir."""
    found, h = np.empty(u.size), 0.2
    for k in range(u.size):
        found[k] = h
        for _ in range(20):
            over = c_weir * max(h - rim, 0.0) ** 1.5
            h = max(h + 0.05 * (7e-5 * u[k] - 5.5e-4 * np.sqrt(h) - over) / 0.2, 0.0)
    return found


def test_a_tank_that_runs_over_at_the_end_of_its_record_is_learnt_from_there():
    """Kept aside, that end would refuse whatever the rest explains, and the overflow would never be found."""
    rng = np.random.default_rng(16)
    u = np.repeat(rng.uniform(1.0, 5.5, 10), 200)
    u[1500:1700] = 9.0
    height = levels(u, 0.02, 0.45)
    assert np.max(height[:1400]) < 0.44 < np.max(height)
    record = Record(
        {"pump": u, "height": height + 1e-3 * rng.normal(size=u.size)},
        {"pump": "V", "height": "m"},
        1.0,
    )
    found = improve(read_model(VESSEL), [record])
    assert [use.id for use in found.model.effects] == ["overflow"]
    # one answer at both doors
    assert found.explanation.candidates == explain(read_model(VESSEL), [record]).candidates
    (use,) = found.added
    rim = quantities_of(use)["h_max"]
    assert 0.0 < rim.std < 0.005 and abs(rim.value - 0.45) < 4.0 * rim.std
    assert found.candidate(use).effect == "overflow"
    assert found.history[-1].error < 1.2e-3
    assert found.verdict == "adequate"


TWO_HEATERS = """name: two heaters
inputs: {Q1: W, Q2: W}
states: {T1: {unit: K}, T2: {unit: K}}
parameters: {C: {value: 50, unit: J/K, lower: 1}, U: {value: 0.3, unit: W/K, lower: 0}}
balances:
  one: {kind: heat, storage: C * der(T1), terms: {heater: Q1, loss: -U * T1}, temperature: T1}
  two: {kind: heat, storage: C * der(T2), terms: {heater: Q2, loss: -U * T2}, temperature: T2}
outputs: {first: {value: T1, unit: K}, second: {value: T2, unit: K}}
"""


def lagging(seed):
    """Two heated blocks of 60 J/K and .4 W/K, read by sensors that lag 20 and 60 s."""
    rng = np.random.default_rng(seed)
    Q = np.repeat(rng.uniform(0.0, 10.0, (30, 2)), 40, axis=0)
    T, read = np.zeros(2), np.zeros(2)
    rows = np.empty_like(Q)
    for k, q in enumerate(Q):
        rows[k] = read
        for _ in range(20):
            read = read + 0.05 * (T - read) / [20.0, 60.0]
            T = T + 0.05 * (q - 0.4 * T) / 60.0
    rows += 0.05 * rng.standard_normal(rows.shape)
    channels = {"Q1": Q[:, 0], "Q2": Q[:, 1], "first": rows[:, 0], "second": rows[:, 1]}
    return Record(channels, {"Q1": "W", "Q2": "W", "first": "K", "second": "K"}, 1.0)


def test_the_same_effect_at_two_places_is_told_with_each_place():
    asked = ["output-lag@first", "output-lag@second"]
    found = improve(read_model(TWO_HEATERS), [lagging(3)], add=asked)
    assert [(step.added, step.at) for step in found.history[1:]] == [
        ("output-lag", "first"),
        ("output-lag", "second"),
    ]
    lags = {use.target: quantities_of(use)["tau"] for use in found.added}
    assert {target: round(tau.value, -1) for target, tau in lags.items()} == {
        "first": 20,
        "second": 60,
    }
    assert all(0.0 < tau.std < 5.0 for tau in lags.values())
    errors = [use.provenance["error_after"] for use in found.added]
    assert errors == [step.error for step in found.history[1:]]
    text = improvement_text(found, None)
    assert "output-lag in first: tau" in text and "output-lag in second: tau" in text
    assert [said["at"] for said in improvement_json(found, None)["effects"]] == ["first", "second"]
