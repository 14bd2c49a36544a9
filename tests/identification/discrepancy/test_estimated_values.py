"""A machine whose structure is the model's and whose values are not: told by the values, and as no missing physics."""

import numpy as np
import pytest

from residuum.identification.discrepancy.explain import explain
from residuum.identification.physics import read_model
from residuum.identification.record import Record
from residuum.identification.work import Work
from residuum.library.answers.explanation import explanation_json, explanation_text, work_text

TRUTH = 120.0


@pytest.fixture(scope="module")
def model():
    text = """
name: axis
inputs: {force: N}
states: {v: {unit: m/s}}
parameters:
  M: {value: 95, unit: kg, lower: 1, upper: 1000}
balances:
  axis: {kind: force, storage: M * der(v), terms: {drive: force}, velocity: v}
outputs: {velocity: {value: v, unit: m/s}}
"""
    return read_model(text)


def record(mass, n=1500, Ts=0.005):
    rng = np.random.default_rng(8)
    force = np.repeat(rng.uniform(30.0, 120.0, n // 50) * np.resize([1.0, -1.0], n // 50), 50)
    velocity = np.concatenate([[0.0], np.cumsum(force[:-1]) * Ts / mass])
    return Record(
        {"force": force, "velocity": velocity + 2e-3 * rng.standard_normal(n)},
        {"force": "N", "velocity": "m/s"},
        Ts,
    )


def test_the_value_that_the_machine_has_now_is_told_beside_the_file_s(model):
    found = explain(model, [record(TRUTH)])
    (mass,) = found.values
    assert found.verdict == "adequate"
    assert (mass.name, mass.file, mass.unit) == ("M", 95.0, "kg") and mass.differs
    assert abs(mass.value - TRUTH) < 4.0 * mass.std and mass.std < 0.01 * TRUTH
    told = explanation_json(found)["estimated_values"][0]
    assert told["file"] == 95.0 and told["differs"]
    assert "estimated from the records: M = 1" in explanation_text(found)


def test_a_value_that_is_the_file_s_is_not_told_as_another(model):
    found = explain(model, [record(95.0)])
    assert not found.values[0].differs
    assert "estimated from the records" not in explanation_text(found)


def test_what_was_not_tried_is_counted_where_it_is_much():
    few, many = Work(), Work()
    few.not_tried[:] = ["a", "b"]
    many.not_tried[:] = [str(k) for k in range(40)]
    assert work_text(few)[0].endswith("done: a, b")
    assert work_text(many)[0].endswith("0, 1, 2, 3, 4, 5 and 34 more (the JSON object names them)")
