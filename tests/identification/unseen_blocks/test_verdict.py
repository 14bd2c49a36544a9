"""From what was tried to what is said: every probability is what was counted over blocks, and one sums them up."""

from types import SimpleNamespace

import numpy as np
import pytest

from residuum.identification.physics import Key, read_model
from residuum.identification.unseen_blocks.cross_validation import ValidatedFit
from residuum.identification.unseen_blocks.policy import DOUBTED
from residuum.identification.unseen_blocks.scale import Scale
from residuum.identification.unseen_blocks.structure import Structure
from residuum.identification.unseen_blocks.tried import Search
from residuum.identification.unseen_blocks.verdict import counted, steps_of, verdict_on

CART = """
name: cart
inputs: {force: N}
states: {v: {unit: m/s}}
parameters: {M: {value: 2.0, unit: kg, fixed: true}}
balances: {body: {kind: force, storage: M * der(v), terms: {drive: force}, velocity: v}}
outputs: {speed: {value: v, unit: m/s}}
"""
FRICTION, DRAG, LOAD = (
    Key(name, "body") for name in ("coulomb-friction", "quadratic-drag", "constant-load")
)
LAG = Key("output-lag", "speed")
SCALE = Scale(np.ones(1), np.ones(1), unit=np.array([20.0]))
EVEN = 1.0 + 0.1 * np.sin(np.arange(20.0))


def validated(power, *keys):
    model = read_model(CART)
    for key in keys:
        model = model.with_effect(key.effect, key.target)
    power, parameters = np.asarray(power)[:, None], len(keys)
    rows, cost = np.zeros((20, 1)), SCALE.cost(power, parameters)
    return ValidatedFit(
        Structure(keys, model, {}, {}),
        parameters,
        power,
        rows,
        cost,
        cost,
        power,
        np.ones((20, 1)),
        rows,
    )


def said(*tried, best=0, adequate=False, sample_time=1e-3):
    """The verdict on these structures beside the model as it is, of which one joined (none: -1)."""
    base = validated(EVEN)
    every = {one.keys: one for one in (base, *tried)}
    validation = SimpleNamespace(
        doubts=lambda structure: {},
        scale=SCALE,
        data=SimpleNamespace(experiments=[SimpleNamespace(sample_time=sample_time)]),
    )
    found = Search(validation, base, base if best < 0 else tried[best], None, every)
    return verdict_on(found, steps_of(found), (), {}, adequate=adequate), counted(
        found, (), adequate=adequate
    )


def probabilities(verdict):
    return {c.key: c.probability for c in verdict.candidates}


def test_the_plain_winner_is_certain_and_what_loses_every_draw_is_not_believed():
    verdict, _ = said(validated(0.1 * EVEN, FRICTION), validated(0.5 * EVEN, DRAG))
    assert verdict.verdict == "missing-effect"
    assert probabilities(verdict) == {FRICTION: pytest.approx(1.0), DRAG: 0.0}
    assert (verdict.none, verdict.unknown) == pytest.approx((0.0, 0.0))


def test_what_cannot_be_told_apart_shares_what_it_wins():
    rng = np.random.default_rng(3)
    one, other = 0.1 + 0.15 * rng.random((2, 20))
    verdict, wins = said(
        validated(one, FRICTION), validated(other, DRAG), validated(0.9 * EVEN, LOAD)
    )
    first = verdict.candidates[0]
    assert first.indistinguishable_from == ("quadratic-drag",)
    shares = probabilities(verdict)
    assert (
        shares[FRICTION]
        == shares[DRAG]
        == pytest.approx(0.5 * (wins[FRICTION,] + wins[DRAG,]))
        == pytest.approx(0.5)
    )
    assert shares[LOAD] == 0.0


def test_what_is_told_apart_is_said_with_what_it_wins():
    """A load that is better in one block of twenty, and far worse in the others."""
    rare = np.arange(20) < 1
    verdict, wins = said(
        validated(np.where(rare, 3.0, 0.1), FRICTION), validated(np.where(rare, 0.01, 0.4), LOAD)
    )
    shares = probabilities(verdict)
    assert shares == {FRICTION: pytest.approx(wins[FRICTION,]), LOAD: pytest.approx(wins[LOAD,])}
    assert 0.05 < shares[LOAD] < 0.95 and 0.05 < shares[FRICTION] < 0.95
    assert sum(shares.values()) + verdict.none + verdict.unknown == pytest.approx(1.0)


def test_two_effects_of_one_structure_do_not_take_belief_from_each_other():
    """The structure of both wins every draw: neither stood in the other's place."""
    both = validated(0.05 * EVEN, FRICTION, DRAG)
    verdict, wins = said(
        both,
        validated(0.5 * EVEN, FRICTION),
        validated(0.7 * EVEN, DRAG),
        validated(0.9 * EVEN, LOAD),
    )
    assert wins == {both.keys: pytest.approx(1.0)}
    accepted = [(c.key, c.step) for c in verdict.candidates if c.probability > 0.0]
    assert accepted == [(FRICTION, 0), (DRAG, 1)]
    assert [c.probability for c in verdict.candidates if c.probability] == pytest.approx([1.0, 1.0])
    assert (verdict.none, verdict.unknown) == pytest.approx((0.0, 0.0))


@pytest.mark.parametrize(
    ("left", "adequate", "doubt"), [(0.5, False, DOUBTED), (0.5, True, 0.0), (0.2, False, 0.0)]
)
def test_a_name_for_a_part_of_what_is_structured_leaves_room_for_one_that_nobody_has(
    left, adequate, doubt
):
    verdict, _ = said(
        validated(left * EVEN, FRICTION), validated(0.9 * EVEN, DRAG), adequate=adequate
    )
    assert probabilities(verdict)[FRICTION] == pytest.approx(1.0 - doubt)
    assert (verdict.verdict, verdict.unknown) == ("missing-effect", pytest.approx(doubt))


@pytest.mark.parametrize(("adequate", "says"), [(True, "adequate"), (False, "unknown-effect")])
def test_how_the_record_was_taken_is_no_candidate_and_takes_no_belief(adequate, says):
    """A lag of less than a sample joined, and nothing else: what is left says whether something is missing."""
    verdict, wins = said(
        validated(0.1 * EVEN, LAG), validated(0.9 * EVEN, LOAD), sample_time=10.0, adequate=adequate
    )
    assert wins == {(LAG,): pytest.approx(1.0)}
    assert verdict.verdict == says
    assert (verdict.none, verdict.unknown) == pytest.approx((1.0, 0.0) if adequate else (0.0, 1.0))
    assert [(c.key, c.probability) for c in verdict.candidates] == [(LOAD, 0.0)]


@pytest.mark.parametrize(("adequate", "says"), [(True, "adequate"), (False, "unknown-effect")])
def test_where_nothing_takes_anything_away_nothing_or_something_unknown_is_certain(adequate, says):
    verdict, _ = said(validated(0.99 * EVEN, FRICTION), best=-1, adequate=adequate)
    assert verdict.verdict == says
    assert (verdict.none, verdict.unknown) == pytest.approx((1.0, 0.0) if adequate else (0.0, 1.0))
    assert all(c.probability == 0.0 for c in verdict.candidates)
