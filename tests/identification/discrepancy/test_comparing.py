"""Which of two structures: each test fails where the judge is wrong (powers swapped, nothing deleted, a probability made up)."""

from types import SimpleNamespace

import numpy as np
import pytest

from residuum.identification.discrepancy.comparing import ahead, going_on, is_alike, is_real, simplest
from residuum.identification.discrepancy.judged import Judged
from residuum.identification.discrepancy.scale import Scale
from residuum.identification.discrepancy.structure import Structure
from residuum.identification.discrepancy.verdict import NONE, UNKNOWN, counted
from residuum.identification.physics import Key

POWER = Scale(np.ones(1), np.full(1, np.inf), unit=np.full(1, 20.0))
NATS = Scale(np.ones(1), np.full(1, np.inf), nats=True, price=4.0)


def structure(name, power, parameters, scale=POWER):
    """A structure with these powers of its blocks; each block has a hundred rows alike."""
    power = np.asarray(power, dtype=float)[:, None]
    keys = (Key(name, "shaft"),) if name else ()
    left = np.repeat(np.sqrt(power / 100.0), 100, axis=0) * np.tile([1.0, -1.0], 50 * len(power))[:, None]
    cost = scale.cost(power, parameters)
    none = np.zeros((len(power), 1))
    return Judged(Structure(keys, None, {}, {}), parameters, power, left, cost, cost, none, none, none)


def scattered(mean, seed, spread=0.2):
    return mean * np.exp(spread * np.random.default_rng(seed).standard_normal(20))


def test_the_one_with_the_smaller_unseen_error_leads():
    good, bad = structure("good", scattered(0.1, 1), 3), structure("bad", scattered(0.9, 2), 3)
    assert simplest([bad, good], POWER) is good
    assert ahead(good, bad, POWER) > 3.0 > -3.0 > ahead(bad, good, POWER)


def test_of_those_that_chance_may_have_parted_the_simplest_leads():
    shape = scattered(0.1, 1)
    many, few = structure("many", shape, 6), structure("few", 1.05 * shape, 2)
    assert simplest([many, few], POWER) is few
    assert is_alike(many, few, structure("", scattered(1.0, 3), 1), POWER)
    assert simplest([many, structure("few", 3.0 * shape, 2)], POWER) is many


def test_an_effect_that_fits_only_what_it_has_seen_is_not_real():
    base = structure("", scattered(1.0, 3), 1)
    assert not is_real(structure("fits", scattered(1.0, 4), 9), base, base, POWER, tried=50)
    assert is_real(structure("real", scattered(0.2, 5), 2), base, base, POWER, tried=50)


def test_in_noise_many_tried_ask_for_more():
    base = structure("", np.full(20, 100.0), 1, NATS)
    few_nats = structure("some", np.full(20, 98.8), 2, NATS)  # 12 nats, 4 of them for the size
    assert is_real(few_nats, base, base, NATS, tried=2) or few_nats.cost > base.cost - 8.1
    assert not is_real(few_nats, base, base, NATS, tried=1000)


def test_ties_go_on_and_what_is_far_behind_does_not():
    shape = scattered(0.1, 1)
    ranked = [structure("a", shape, 2), structure("b", 1.1 * shape, 2), structure("c", 9.0 * shape, 2)]
    assert going_on(ranked, POWER) == ranked[:2]


def found(base, *others, scale=POWER):
    every = {one.keys: one for one in (base, *others)}
    return SimpleNamespace(base=base, every=every, tried=10, court=SimpleNamespace(scale=scale))


def test_probabilities_are_the_draws_that_a_structure_wins():
    """Two that take turns over the blocks win about as often; a third that is worse everywhere never."""
    turns = np.tile([0.2, 1.8], 10) * 0.1
    a, b = structure("a", turns, 2), structure("b", turns[::-1], 2)
    worse = structure("worse", np.full(20, 0.9), 2)
    wins = counted(found(structure("", np.full(20, 1.0), 1), a, b, worse), [], adequate=False)
    assert wins[a.keys] == pytest.approx(0.5, abs=0.2) and wins[b.keys] == pytest.approx(0.5, abs=0.2)
    assert worse.keys not in wins
    assert sum(wins.values()) == pytest.approx(1.0)


@pytest.mark.parametrize(("adequate", "name"), [(True, NONE), (False, UNKNOWN)])
def test_where_nothing_is_worth_its_while_none_or_unknown_wins(adequate, name):
    base = structure("", scattered(1.0, 3), 1)
    wins = counted(found(base, structure("fits", 0.99 * scattered(1.0, 3), 4)), [], adequate=adequate)
    assert wins == {name: pytest.approx(1.0)}


def test_a_free_term_that_does_plainly_more_makes_it_unknown():
    base, named = structure("", scattered(1.0, 3), 1), structure("named", scattered(0.6, 4), 2)
    curve = SimpleNamespace(power=scattered(0.05, 5)[:, None], parameters=18)
    assert counted(found(base, named), [curve], adequate=False)[UNKNOWN] > 0.95
    no_better = SimpleNamespace(power=scattered(0.6, 4)[:, None], parameters=18)
    assert UNKNOWN not in counted(found(base, named), [no_better], adequate=False)
