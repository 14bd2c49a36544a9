"""What joined first is exchanged for what gains only beside the others."""

import numpy as np

from residuum.identification.physics import Key, read_model
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.data import matched
from residuum.identification.unseen_blocks.multiple_shooting import first_fit
from residuum.identification.unseen_blocks.search import begun, exchanged
from residuum.identification.unseen_blocks.structure import Structure
from residuum.identification.unseen_blocks.tried import Wanted

CART = """
name: cart
inputs: {force: N}
states: {q: {unit: m, rate: v}, v: {unit: m/s}}
parameters: {M: {value: 2.0, unit: kg, fixed: true}, b: {value: 1.0, unit: N*s/m, lower: 0, upper: 100}}
balances: {body: {kind: force, storage: M * der(v), terms: {drive: force, loss: -b * v}, position: q, velocity: v}}
outputs: {place: {value: q, unit: m}}
"""
THREE = ("coulomb-friction", "linear-spring", "quadratic-drag")


def _cart(n=2000, h=0.02):
    """A cart on a spring with dry friction and air drag, pushed to and fro."""
    force = np.repeat(np.random.default_rng(1).uniform(-6.0, 6.0, n // 50), 50)
    q, v, seen = 0.0, 0.0, []
    for u in force:
        seen.append(q)
        for _ in range(10):
            v += h / 10 * (u - 0.5 * v - 0.8 * v * abs(v) - 0.5 * np.sign(v) - 2.0 * q) / 2.0
            q += h / 10 * v
    noise = 1e-3 * np.random.default_rng(2).standard_normal(n)
    return Record(
        {"force": force, "place": np.array(seen) + noise}, {"force": "N", "place": "m"}, h
    )


def _with(found, ids):
    keys = tuple(sorted(Key(id, "body") for id in ids))
    model = found.validation.data.model
    for key in keys:
        model = model.with_effect(*key)
    start = found.base.structure
    one = found.validation.validate(
        Structure(keys, model, start.states, start.steps), steps=30, tolerance=1e-6
    )
    found.every[keys] = one
    return one


def test_an_effect_that_stands_for_another_goes_and_those_that_are_there_stay():
    found = begun(first_fit(matched(read_model(CART), [_cart()], None)))
    found.best = _with(found, ("constant-load", "coulomb-friction", "linear-spring"))
    beam = exchanged(found, [found.best], Wanted((*THREE, "constant-load"), held=False), None)
    assert {key.effect for key in found.best.keys} == set(THREE) and beam[0] is found.best
    again = exchanged(found, beam, Wanted((*THREE, "constant-load"), held=False), None)
    assert again == beam and {key.effect for key in found.best.keys} == set(THREE)
