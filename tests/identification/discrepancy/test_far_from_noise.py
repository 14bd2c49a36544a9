"""What effects take away is told where they leave more than noise."""

import numpy as np

from residuum.identification.discrepancy.explain import explain
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


def test_two_frictions_of_which_one_is_asked_for_are_told_by_the_share_that_it_takes_away():
    found = explain(read_model(CART), [let_go(1e-7)], effects=("coulomb-friction",))
    assert found.by_share and found.candidates[0].effect == "coulomb-friction"
