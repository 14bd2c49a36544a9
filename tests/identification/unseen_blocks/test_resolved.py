"""A winner whose own modes are faster than the integration steps of the search is judged with finer ones."""

from dataclasses import replace

import numpy as np
import pytest

from residuum.identification.physics import Key, read_model
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.data import matched
from residuum.identification.unseen_blocks.multiple_shooting import first_fit
from residuum.identification.unseen_blocks.search import begun, joins
from residuum.identification.unseen_blocks.structure import Structure
from residuum.identification.unseen_blocks.tried import resolved

CART = """
name: cart
inputs: {force: N}
states: {v: {unit: m/s}}
parameters: {M: {value: 2.0, unit: kg, fixed: true}, b: {value: 4.0, unit: N*s/m, lower: 0, upper: 100}}
balances: {body: {kind: force, storage: M * der(v), terms: {drive: force, loss: -b * v}, velocity: v}}
outputs: {speed: {value: v, unit: m/s}}
"""
LAG, H = 0.025, 0.1
ASKED = 5
"""Steps a sample of a decay of 25 ms: h / .8 τ, and as many whole ones."""


@pytest.fixture(scope="module")
def lagging():
    """A search for the lag of a cart's speedometer; the structure with it as it is, and as with one step a sample."""
    n, m = 2000, 100
    force = np.repeat(np.random.default_rng(1).uniform(-6.0, 6.0, n // 10), 10)
    v, told, seen = 0.0, 0.0, []
    for u in force:
        seen.append(told)
        for _ in range(m):
            v += H / m * (u - 4.0 * v) / 2.0
            told += H / m * (v - told) / LAG
    noise = 1e-3 * np.random.default_rng(2).standard_normal(n)
    record = Record(
        {"force": force, "speed": np.array(seen) + noise}, {"force": "N", "speed": "m/s"}, H
    )
    outcome = begun(first_fit(matched(read_model(CART), [record], None)))
    key, base = Key("output-lag", "speed"), outcome.base.structure
    model = outcome.validation.data.model.with_effect(*key, {"tau": LAG})
    fine = outcome.validation.validate(
        Structure((key,), model, base.states, base.steps), steps=30, tolerance=1e-6
    )
    windows = outcome.validation.last.windows
    steps = {**fine.structure.steps, windows: [1] * len(fine.structure.steps[windows])}
    return outcome, fine, replace(fine, structure=replace(fine.structure, steps=steps))


def _steps(outcome, fit):
    return min(fit.structure.steps[outcome.validation.last.windows])


def test_what_its_steps_follow_stays(lagging):
    outcome, fine, _ = lagging
    assert _steps(outcome, fine) >= ASKED
    assert resolved(fine, outcome.base, outcome.validation) is fine


def test_what_its_steps_do_not_follow_is_fitted_with_finer_ones(lagging):
    outcome, _, coarse = lagging
    finer = resolved(coarse, outcome.base, outcome.validation)
    assert _steps(outcome, finer) >= ASKED
    (use,) = finer.model.effects
    assert use.parameters["tau"].value == pytest.approx(LAG, rel=0.05)


def test_a_machine_that_is_as_stiff_by_itself_is_judged_as_it_was(lagging):
    outcome, fine, coarse = lagging
    assert resolved(coarse, fine, outcome.validation) is coarse


def test_what_joins_was_judged_with_its_own_steps(lagging):
    outcome, _, coarse = lagging
    ranked = [coarse]
    assert joins(outcome, ranked)
    assert ranked == [outcome.best] and _steps(outcome, outcome.best) >= ASKED
    assert outcome.every[coarse.keys] is outcome.best
