"""Inputs that the model forgot, balances that know nothing of each other, and what has no name: found, sized and written."""

from dataclasses import replace

import numpy as np
import pytest

from residuum.identification.discrepancy.explain import explain
from residuum.identification.discrepancy.improve import improve
from residuum.identification.errors import BadModel
from residuum.identification.physics import candidates, estimate, match, read_model, write_model
from residuum.identification.record import Record
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.unseen_blocks.record_search import searched
from residuum.identification.unseen_blocks.tried import Wanted

TANK = """
name: tank
inputs: {inflow: l/s}
states: {h: {unit: m}}
parameters: {A: {value: 20, unit: l/m, lower: 1, upper: 1000}}
balances: {tank: {kind: volume, storage: A * der(h), terms: {in: inflow}, level: h}}
outputs: {level: {value: h, unit: m}}
"""
ROOMS = """
name: two rooms
inputs: {heater: W}
states: {one: {unit: °C}, two: {unit: °C}}
parameters:
  C: {value: 900, unit: J/K, fixed: true}
  h: {value: 4, unit: W/K, lower: 0}
  T_a: {value: 15, unit: °C, fixed: true}
balances:
  first: {kind: heat, storage: C * der(one), terms: {heater: heater, loss: -h * (one - T_a)}, temperature: one, ambient: T_a}
  second: {kind: heat, storage: C * der(two), terms: {loss: -h * (two - T_a)}, temperature: two, ambient: T_a}
outputs: {one: {value: one, unit: °C}, two: {value: two, unit: °C}}
"""
AXIS = """
name: axis
inputs: {force: N}
states: {q: {unit: m, rate: v}, v: {unit: m/s}}
parameters: {M: {value: 8, unit: kg, lower: 1, upper: 100}}
balances: {axis: {kind: force, storage: M * der(v), terms: {drive: force}, position: q, velocity: v}}
outputs: {velocity: {value: v, unit: m/s}}
"""


def stepped(rng, n, every, low, high):
    return np.repeat(rng.uniform(low, high, n // every + 1), every)[:n]


def tank_record(gain, n=3000, dt=1.0, seed=3):
    """A tank of 31.7 l/m whose drain was recorded and acts with a gain; a colour that has nothing to do with it beside."""
    rng = np.random.default_rng(seed)
    inflow, drain = stepped(rng, n, 40, 0.2, 1.0), stepped(rng, n, 67, 0.0, 0.9)
    level = 2.0 + np.concatenate([[0.0], np.cumsum(dt * (inflow + gain * drain) / 31.7)[:-1]])
    columns = {"inflow": inflow, "drain": drain, "colour": stepped(rng, n, 31, 0.0, 5.0)}
    return Record(
        columns | {"level": level + 0.002 * rng.standard_normal(n)},
        {"inflow": "l/s", "drain": "l/s", "colour": "1", "level": "m"},
        dt,
    )


def rooms_record(k, n=4000, dt=10.0, seed=5):
    """Two rooms, one of them heated, that give each other heat through a wall of k W/K."""
    rng, steps = np.random.default_rng(seed), 20
    heater = 200.0 * (stepped(rng, n, 90, 0.0, 1.0) > 0.5)
    T, seen = np.array([15.0, 15.0]), np.empty((n, 2))
    for i in range(n):
        seen[i] = T
        for _ in range(steps):
            through = k * (T[0] - T[1])
            T = (
                T
                + dt
                / steps
                * np.array([heater[i] - 3.3 * (T[0] - 15) - through, -3.3 * (T[1] - 15) + through])
                / 900.0
            )
    seen += 0.02 * rng.standard_normal(seen.shape)
    return Record(
        {"heater": heater, "one": seen[:, 0], "two": seen[:, 1]},
        {"heater": "W", "one": "°C", "two": "°C"},
        dt,
    )


def strange_axis_record(n=6000, dt=0.01, seed=8):
    """A mass of 9.3 kg that a force holds back which no catalogue has: 6·sin(2.5·v) + 2·v."""
    rng, steps = np.random.default_rng(seed), 10
    force, v, seen = stepped(rng, n, 60, -14.0, 14.0), 0.0, np.empty(n)
    for i in range(n):
        seen[i] = v
        for _ in range(steps):
            v += dt / steps * (force[i] - 6.0 * np.sin(2.5 * v) - 2.0 * v) / 9.3
    return Record(
        {"force": force, "velocity": seen + 0.005 * rng.standard_normal(n)},
        {"force": "N", "velocity": "m/s"},
        dt,
    )


def test_a_recorded_flow_that_the_model_forgot_is_named_with_its_gain():
    model, record = read_model(TANK), tank_record(-0.87)
    found = explain(
        model, [record], effects=["forgotten-input", "leak", "input-offset", "output-lag"]
    )
    first = found.candidates[0]
    assert (first.effect, first.balance, found.verdict) == (
        "forgotten-input",
        "tank(drain)",
        "missing-effect",
    )
    gain = first.parameters["gain"]
    assert abs(gain.value + 0.87) < 5 * gain.std < 0.05


def test_improve_takes_the_forgotten_column_into_the_file_and_no_other():
    model, record = read_model(TANK), tank_record(-0.87)
    improved = improve(model, [record], effects=["forgotten-input", "leak", "input-offset"])
    again = read_model(write_model(improved.model))
    assert (list(again.inputs), improved.verdict) == (["inflow", "drain"], "adequate")
    assert [use.label for use in again.effects] == ["forgotten-input@tank(drain)"]
    assert not compare(again, [tank_record(-0.87, seed=11)]).present


def test_a_column_that_the_outputs_tell_is_no_input():
    """The rate of the level explains everything that is missing, and acts on nothing."""
    record = tank_record(0.0)
    channels = dict(record.channels)
    level = channels["level"] - np.cumsum(0.2 * np.ones(record.n)) / 31.7
    rate = np.gradient(level)
    told = Record(
        {"inflow": channels["inflow"], "rate": rate, "level": level},
        {"inflow": "l/s", "rate": "m/s", "level": "m"},
        1.0,
    )
    found = explain(read_model(TANK), [told], effects=["forgotten-input", "leak"])
    assert all(c.effect != "forgotten-input" for c in found.candidates)


def test_two_balances_that_know_nothing_of_each_other_are_coupled():
    model, record = read_model(ROOMS), rooms_record(1.7)
    assert ("coupling", "first(second)") in candidates(model)
    coupled = model.with_effect("coupling", "first(second)")
    found = estimate(coupled, match(coupled, [record])[1])
    k = list(found.parameters).index("coupling@first(second).k")
    assert (
        abs(found.model.values["coupling@first(second).k"] - 1.7)
        < 5 * np.sqrt(found.covariance[k, k])
        < 0.1
    )
    assert (
        explain(model, [record], effects=["coupling", "ambient-loss", "output-lag"])
        .candidates[0]
        .effect
        == "coupling"
    )
    assert ("coupling", "first(second)") not in candidates(coupled)


def test_a_curve_is_learned_where_no_effect_has_a_name():
    model, record, unseen = read_model(AXIS), strange_axis_record(), strange_axis_record(seed=21)
    improved = improve(model, [record], add=["learned:axis(v)"])
    use = improved.model.effects[0]
    at, value = (
        np.array([use.parameters[f"{letter}{k}"].value for k in range(1, 10)]) for letter in "av"
    )
    truth = -6.0 * np.sin(2.5 * at) - 2.0 * at
    assert np.abs(value - truth)[1:-1].max() < 0.8
    before, after = (compare(m, [unseen]).outputs["velocity"].rmse for m in (model, improved.model))
    assert after < 0.1 * before
    assert read_model(write_model(improved.model)).values == improved.model.values


def test_the_search_learns_only_when_asked():
    model = read_model(AXIS)
    record = strange_axis_record(n=3000)
    plain, learned = (
        searched(model, [record], None, Wanted(("output-offset",), yes, held=False))
        for yes in (False, True)
    )
    assert plain.best.keys == ()
    assert ("learned", "axis(v)") in learned.best.keys


@pytest.mark.parametrize(
    ("id", "target", "says"),
    [
        ("learned", "tank", "say where as balance"),
        ("learned", "tank(nothing)", "cannot be tied to 'nothing'"),
        ("coupling", "tank(tank)", "cannot be tied to 'tank'"),
        ("overflow", "tank(inflow)", "cannot be tied to 'inflow'"),
        ("outflow", "tank(inflow)", "is tied to no signal"),
    ],
)
def test_a_place_that_does_not_fit_is_refused_in_one_line(id, target, says):
    with pytest.raises(BadModel, match=says):
        read_model(TANK).with_effect(id, target)


def test_an_input_that_nothing_uses_is_proposed_as_forgotten():
    knowing = read_model(TANK.replace("{inflow: l/s}", "{inflow: l/s, drain: l/s}"))
    assert ("forgotten-input", "tank(drain)") in candidates(knowing)
    assert ("input-delay", "drain") not in candidates(knowing)
    used = replace(knowing).with_effect("forgotten-input", "tank(drain)", {"gain": -1.0})
    assert ("forgotten-input", "tank(drain)") not in candidates(used)
