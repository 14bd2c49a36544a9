"""An improvement does not make worse what none of it was estimated on."""

import numpy as np

from residuum.identification.discrepancy.explain import leaves_something
from residuum.identification.discrepancy.kept_aside import _kept_aside, first_that_holds
from residuum.identification.physics import read_model
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.data import matched
from residuum.identification.unseen_blocks.multiple_shooting import first_fit
from residuum.identification.unseen_blocks.tried import begun

CART = """
name: cart
inputs: {force: N}
states: {v: {unit: m/s}}
parameters: {M: {value: 2.0, unit: kg, lower: 0.1}, d: {value: 1.0, unit: N*s/m, lower: 0.01}}
balances: {body: {kind: force, storage: M * der(v), terms: {drive: force, drag: -d * v}, velocity: v}}
outputs: {speed: {value: v, unit: m/s}}
"""


def cart_record(load, n=1500, strength=6.0, seed=4):
    """A cart under a load (n,) [N], by small Euler steps."""
    rng, h = np.random.default_rng(seed), 0.02
    force, v, speed = np.repeat(rng.uniform(-strength, strength, n // 50), 50), 0.0, np.empty(n)
    for i in range(n):
        speed[i] = v
        for _ in range(10):
            v += h / 10 * (force[i] - 3.0 * v + load[i]) / 2.5
    return Record(
        {"force": force, "speed": speed + 0.01 * rng.normal(size=n)},
        {"force": "N", "speed": "m/s"},
        h,
    )


def kept(load):
    model, record = read_model(CART), cart_record(load)
    found = begun(first_fit(matched(model, [record], None)))
    models = [
        found.base.model,
        found.base.model.with_effect("constant-load", "body", {"tau_0": 1.0}),
    ]
    return first_that_holds(models[0], models[1:], found, [record], None)


def test_a_load_that_stays_is_kept():
    assert kept(np.full(1500, 1.5)) == 0


def test_a_load_that_is_gone_at_the_end_is_not():
    assert kept(np.where(np.arange(1500) < 1000, 1.5, 0.0)) is None


def test_a_load_that_the_most_different_record_does_not_have_is_not_kept():
    """The last record, kept aside as a rule, has the load; the first, driven twice as far as any other, has
    it the other way round."""
    model, load = read_model(CART), np.full(600, 1.5)
    records = [cart_record(load if k else -load, 600, 6.0 if k else 12.0, seed=k) for k in range(4)]
    found = begun(first_fit(matched(model, records, None)))
    models = [
        found.base.model,
        found.base.model.with_effect("constant-load", "body", {"tau_0": 1.0}),
    ]
    assert first_that_holds(models[0], models[1:], found, records[1:], None) == 0
    assert first_that_holds(models[0], models[1:], found, records, None) is None


def test_a_record_longer_than_all_others_is_no_test_of_what_they_tell():
    """Left out, next to nothing would remain to learn from; one that goes as far and is no longer is one."""
    short, far = cart_record(np.zeros(500), 500), cart_record(np.zeros(1500), 1500, 12.0)
    assert [split.testing for split in _kept_aside([far, short])] == [[(short, 0)]]
    cut = far.window(0, 600)
    assert [split.testing for split in _kept_aside([cut, short])] == [[(short, 0)], [(cut, 0)]]


def test_a_model_that_diverges_from_what_was_measured_leaves_something():
    """`compare` begins at the measured states; a search may have followed the records from other ones."""
    runaway = read_model(
        CART.replace("-d * v}", "d * v**3}").replace("unit: N*s/m,", "unit: N*s**3/m**3,")
    )
    assert leaves_something(runaway, [cart_record(np.zeros(500), 500, 60.0)], None)
