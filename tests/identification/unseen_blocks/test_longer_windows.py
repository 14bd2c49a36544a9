"""What was judged in short windows goes on to longer ones together with what stood beside it there."""

import numpy as np

from residuum.identification.physics import Key, read_model
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.data import matched
from residuum.identification.unseen_blocks.multiple_shooting import FirstFit, first_fit
from residuum.identification.unseen_blocks.search import begun, lengthened
from residuum.identification.unseen_blocks.structure import Structure

CART = """
name: cart
inputs: {force: N}
states: {q: {unit: m, rate: v}, v: {unit: m/s}}
parameters: {M: {value: 2.0, unit: kg, fixed: true}, b: {value: 1.0, unit: N*s/m, lower: 0, upper: 100}}
balances: {body: {kind: force, storage: M * der(v), terms: {drive: force, loss: -b * v}, position: q, velocity: v}}
outputs: {place: {value: q, unit: m}}
"""


def _pulled_by_a_spring(n=2000, h=0.02):
    """A cart on a soft spring, pushed to and fro."""
    force = np.repeat(np.random.default_rng(1).uniform(-3.0, 3.0, n // 50), 50)
    q, v, seen = 0.0, 0.0, []
    for u in force:
        seen.append(q)
        for _ in range(10):
            v += h / 10 * (u - 1.5 * v - 2.0 * q) / 2.0
            q += h / 10 * v
    noise = 1e-3 * np.random.default_rng(2).standard_normal(n)
    return Record(
        {"force": force, "place": np.array(seen) + noise}, {"force": "N", "place": "m"}, h
    )


def test_the_better_of_two_on_longer_windows_is_the_best_from_then_on():
    data = matched(read_model(CART), [_pulled_by_a_spring()], None)
    shortest = data.horizons[0]
    short = first_fit(
        type(data)(data.model, data.experiments, data.measured, data.spread, (shortest,), data.fold)
    )
    found = begun(
        FirstFit(
            data, short.structure, short.found, shortest, shortest, short.scale, short.window_errors
        )
    )
    start = found.base.structure
    for id in ("constant-load", "linear-spring"):
        key = Key(id, "body")
        model = data.model.with_effect(*key)
        one = found.validation.validate(
            Structure((key,), model, start.states, start.steps), steps=15, tolerance=1e-6
        )
        found.every[key,] = one
    found.best = found.every[Key("constant-load", "body"),]  # as if short windows had preferred it
    beam = lengthened(found)
    assert found.validation.last.windows < shortest.windows
    assert [key.effect for key in found.best.keys] == ["linear-spring"] and beam[0] is found.best
    assert found.base.cost > 10.0 * found.best.cost
