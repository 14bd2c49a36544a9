"""Probabilities are counted: how often a structure wins when blocks are drawn again."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from residuum.identification.physics import Key
from residuum.identification.unseen_blocks.scale import Scale
from residuum.identification.unseen_blocks.verdict import counted

ONE, OTHER = (Key("coulomb-friction", "shaft"),), (Key("quadratic-drag", "shaft"),)


def structure(keys, power, parameters):
    scale = Scale(np.ones(1), np.ones(1), unit=np.array([20.0]))
    cost = scale.cost(power[:, None], parameters)
    return SimpleNamespace(
        keys=keys, power=power[:, None], parameters=parameters, cost=cost, seen_cost=cost
    )


def wins(one, other, base=None, adequate=False):
    powers = [np.ones(20) if base is None else base, one, other]
    known = {
        k: structure(k, p, n) for k, p, n in zip([(), ONE, OTHER], powers, [0, 1, 1], strict=True)
    }
    scale = Scale(np.ones(1), np.ones(1), unit=np.array([20.0]))
    found = SimpleNamespace(
        validation=SimpleNamespace(scale=scale), base=known[()], every=known, tried=3
    )
    return counted(found, [], adequate=adequate)


def test_what_is_better_in_every_block_wins_every_draw():
    assert wins(np.full(20, 0.1), np.full(20, 0.5)) == {ONE: pytest.approx(1.0)}
    assert wins(np.full(20, 0.5), np.full(20, 0.1)) == {OTHER: pytest.approx(1.0)}


def test_what_is_better_in_some_blocks_shares_the_draws():
    rng = np.random.default_rng(3)
    one, other = 0.2 + 0.3 * rng.random(20), 0.2 + 0.3 * rng.random(20)
    found = wins(one, other)
    assert sum(found.values()) == pytest.approx(1.0)
    assert 0.05 < found[ONE] < 0.95 and 0.05 < found[OTHER] < 0.95
    assert wins(other, one)[ONE] == pytest.approx(found[OTHER], abs=0.1)


def test_what_fits_all_blocks_no_better_wins_no_draw():
    """One block alone tells a value: left out with it, the value lies anywhere, and another structure ahead of it by chance."""
    base = np.where(np.arange(20) == 3, 30.0, 0.1)
    known = {(): structure((), base, 0), ONE: structure(ONE, np.full(20, 0.1), 1)}
    found = SimpleNamespace(
        validation=SimpleNamespace(scale=Scale(np.ones(1), np.ones(1), unit=np.array([20.0]))),
        base=known[()],
    )
    found.every, found.tried = known, 2
    assert counted(found, [], adequate=True)[ONE] > 0.5
    known[()].seen_cost = known[ONE].seen_cost = 2.0
    assert counted(found, [], adequate=True) == {"none": pytest.approx(1.0)}


@pytest.mark.parametrize(("adequate", "says"), [(True, "none"), (False, "unknown")])
def test_where_nothing_helps_none_or_unknown_wins(adequate, says):
    assert wins(np.full(20, 0.99), np.full(20, 0.98), adequate=adequate) == {
        says: pytest.approx(1.0)
    }


def test_a_free_term_that_does_plainly_more_wins_as_unknown():
    scale = Scale(np.ones(1), np.ones(1), unit=np.array([20.0]))
    known = {(): structure((), np.ones(20), 0), ONE: structure(ONE, np.full(20, 0.6), 1)}
    found = SimpleNamespace(
        validation=SimpleNamespace(scale=scale), base=known[()], every=known, tried=2
    )
    free = replace(_term(), power=np.full((20, 1), 0.1), parameters=9)
    assert counted(found, [free], adequate=False) == {"unknown": pytest.approx(1.0)}


def _term():
    from residuum.identification.unseen_blocks.free_term import BlockTerm

    return BlockTerm(
        "shaft", "velocity", "N*m", np.zeros(3), np.zeros(3), np.zeros((20, 1)), 3, 0.0, 0.0
    )
