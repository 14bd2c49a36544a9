"""Stages of an input path do not commute; the search adds one after the other, the machine may have them the other way round."""

import numpy as np
import pytest

from residuum.identification.discrepancy.fitting.structure_fits import base_structure, fit_structure, in_likelier_order
from residuum.identification.physics import match, read_model
from residuum.identification.record import Record

MASS = """name: mass
inputs: {force: N}
states: {v: {unit: m/s}}
parameters: {M: {value: 2.0, unit: kg, fixed: true}, d: {value: 2.8, unit: N*s/m, lower: 0}}
balances: {body: {kind: force, storage: M * der(v), terms: {drive: force, friction: -d * v}, velocity: v}}
outputs: {speed: {value: v, unit: m/s}}
"""


def test_an_offset_before_a_limit_is_put_there():
    n, h, rng = 2000, 0.02, np.random.default_rng(5)
    force = np.repeat(rng.uniform(-4.0, 4.0, n // 40), 40)
    acting = np.clip(force + 0.5, -3.0, 3.0)
    v, decay = np.zeros(n), np.exp(-3.0 / 2.0 * h)
    for k in range(n - 1):
        v[k + 1] = decay * v[k] + (1.0 - decay) * acting[k] / 3.0
    record = Record({"force": force, "speed": v + 2e-3 * rng.normal(size=n)}, {"force": "N", "speed": "m/s"}, h)
    model, experiments = match(read_model(MASS), [record], hold="zero-order")
    base = base_structure(model, experiments)
    limited = base.model.with_effect("input-saturation", "force", {"u_max": 3.1})
    found = fit_structure(limited.with_effect("input-offset", "force", {"u_0": 0.3}), experiments, base.initial)
    ordered = in_likelier_order(found, ("input-offset", "force"), experiments)
    assert [use.id for use in ordered.model.effects] == ["input-offset", "input-saturation"]
    assert ordered.model.values["input-offset@force.u_0"] == pytest.approx(0.5, abs=0.01)
    assert ordered.log_likelihood > found.log_likelihood + 100.0
    assert in_likelier_order(ordered, ("input-offset", "force"), experiments) is ordered
