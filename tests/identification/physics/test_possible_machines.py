"""Bounds across parameters: no estimate is a machine that cannot be."""

import numpy as np
import pytest

from residuum.identification.errors import BadModel
from residuum.identification.physics import (
    Experiment,
    Simulator,
    candidates,
    estimate,
    read_model,
)
from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.effects.base import Conditions

SLED = """name: sled
inputs: {force: N}
states: {q: {unit: m, rate: v}, v: {unit: m/s}}
parameters: {M: {value: 2, unit: kg}, d: {value: 1, unit: N*s/m}}
balances: {axis: {kind: force, storage: M * der(v), terms: {drive: force, guide: -d * v}, position: q, velocity: v}}
outputs: {position: {value: q, unit: m}}
"""


def push(n=400, outputs=1):
    force = np.sign(np.sin(np.arange(n) * 0.03))[:, None]
    return Experiment(force, np.full((n, outputs), np.nan), np.zeros(1), 0.01)


def test_every_ordered_pair_is_of_the_effects_own_parameters():
    model = read_model(SLED)
    ordered = {}
    for key in candidates(model):
        declared = model.with_effect(*key).effects[-1].parameters
        pairs = [(p.name, p.below) for p in declared.values() if p.below]
        assert all(high in declared for _, high in pairs), key
        ordered[key.effect] = pairs
    assert ordered["end-stop"] == [("q_min", "q_max")]


def test_a_stop_whose_lower_end_is_above_its_upper_is_refused_where_it_is_said():
    with pytest.raises(
        BadModel, match="'q_min' is 1 and 'q_max' is -1; 'q_min' must be below 'q_max'"
    ):
        read_model(SLED).with_effect("end-stop", "axis", {"k": 10.0, "q_max": -1.0, "q_min": 1.0})
    text = (
        SLED
        + "effects:\n  - {id: end-stop, balance: axis, parameters: {k: 10, q_max: -1, q_min: 1}}\n"
    )
    with pytest.raises(BadModel, match=r"line 8.*must be below"):
        read_model(text)


def test_no_parameters_of_an_impossible_machine_are_simulated():
    model = read_model(SLED).with_effect("end-stop", "axis", {"k": 10.0})
    simulator, e = Simulator(model), push()
    assert simulator.run(e).finite
    assert not simulator.run(e, values={"end-stop@axis.q_min": 2.0}).finite
    assert not simulator.run(e, values={"M": -2.0}, slopes=["d"]).finite


def test_an_estimate_does_not_cross_the_ends_of_a_travel():
    """A machine on a plain spring: two stops that overlap everywhere would be it, and are no machine."""
    spring = read_model(SLED).with_effect("linear-spring", "axis", {"k": 4.0})
    e = push(800)
    y = Simulator(spring).run(e).Y
    e = Experiment(
        e.U, y + 1e-4 * np.random.default_rng(0).normal(size=y.shape), e.hold, e.sample_time
    )
    near = {"k": 4.0, "q_max": 0.01, "q_min": -0.01}
    found = estimate(read_model(SLED).with_effect("end-stop", "axis", near), [e])
    assert found.model.values["end-stop@axis.q_min"] < found.model.values["end-stop@axis.q_max"]


def test_a_mass_does_not_become_negative():
    """Data of a machine that answers the other way round: the least error would be at a negative mass."""
    e = push()
    y = -Simulator(read_model(SLED)).run(e).Y
    e = Experiment(e.U, y, e.hold, e.sample_time)
    assert estimate(read_model(SLED), [e]).model.values["M"] > 0.0


def test_a_start_with_a_negative_mass_keeps_its_sign():
    """A storage that a model counts the other way round is the model's own affair."""
    text = SLED.replace("M * der(v)", "-M * der(v)").replace("force, guide: -d", "-force, guide: d")
    assert Simulator(read_model(text)).run(push()).finite


def test_starts_of_a_stop_keep_the_order():
    q = np.zeros(50)
    q[-1] = 1.0
    conditions = Conditions(
        0.1, 5.0, 1.0, 1.0, {"position": q, "velocity": np.zeros(50)}, np.where(q > 0, -1.0, 1.0)
    )
    starts = EFFECTS["end-stop"].starts(conditions)
    assert starts and all(s["q_min"] < s["q_max"] for s in starts)
