"""Blocks are asked before an exact structure for an error that is far from noise."""

import numpy as np
import pytest

from residuum.identification.discrepancy.exact_structure import is_far_from_noise
from residuum.identification.discrepancy.explain import explain
from residuum.identification.discrepancy.fitting.judged_experiments import experiments_and_base
from residuum.identification.discrepancy.fitting.structures import times_its_innovations
from residuum.identification.discrepancy.policy.acceptance import FAR_FROM_NOISE
from residuum.identification.physics import read_model
from residuum.identification.record import Record

CART = """name: cart
inputs: {}
states: {q: {unit: m, rate: v}, v: {unit: m/s}}
parameters: {M: {value: 2, unit: kg, fixed: true}, k: {value: 30, unit: N/m, lower: 0}}
balances: {axis: {kind: force, storage: M * der(v), terms: {spring: -k * q}, position: q, velocity: v}}
outputs: {position: {value: q, unit: m}}
"""


def let_go(noise, samples=600, h=0.005):
    """A cart let go on a spring, with dry friction of 1.2 N and air drag of .4 N s²/m²."""
    q, v, place, step = 1.0, 0.0, [], h / 10
    for _ in range(samples):
        place.append(q)
        for _ in range(10):
            pushed = v - step * (30.0 * q + 0.4 * v * abs(v)) / 2.0
            v = np.sign(pushed) * max(abs(pushed) - step * 1.2 / 2.0, 0.0)
            q += step * v
    seen = np.array(place) + noise * np.random.default_rng(2).standard_normal(samples)
    return Record({"position": seen}, {"position": "m"}, h)


@pytest.mark.parametrize(("noise", "samples", "far"), [(0.03, 600, False), (1e-7, 600, True), (1e-7, 39, False)])
def test_not_near_noise_nor_where_blocks_cannot_judge(noise, samples, far):
    records = [let_go(noise, samples)]
    first = experiments_and_base(read_model(CART), records, None)
    assert is_far_from_noise(first, records) is far
    if samples == 600:
        assert (times_its_innovations(first[1]) > FAR_FROM_NOISE) is far


def test_blocks_answer_where_an_exact_structure_drifts():
    found = explain(read_model(CART), [let_go(1e-7)], effects=("coulomb-friction",))
    assert found.by_share and found.candidates[0].effect == "coulomb-friction"


def test_no_exact_structure_is_sought_where_blocks_take_away_most_and_leave_no_noise():
    told = []
    model, records = read_model(CART), [let_go(1e-7)]
    found = explain(model, records, effects=("coulomb-friction", "viscous-friction"), tell=lambda _, doing: told.append(doing))
    assert found.by_share and not any(doing.startswith("trying") for doing in told)
