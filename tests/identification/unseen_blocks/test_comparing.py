"""Which of two structures: the one whose errors on unseen blocks are smaller, and by how much."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from residuum.identification.physics import Key, load_model
from residuum.identification.unseen_blocks.comparing import (
    ahead,
    block_by_block,
    evidence,
    is_alike,
    is_real,
    paired,
    simpler_ones,
    simplest,
)
from residuum.identification.unseen_blocks.policy import RARE
from residuum.identification.unseen_blocks.scale import Scale
from residuum.identification.unseen_blocks.structure import rarity

POWER = Scale(np.ones(1), np.ones(1), unit=np.array([20.0]))
NATS = replace(POWER, nats=True, price=3.0)
EVEN = 1.0 + 0.1 * np.sin(np.arange(20.0))


@dataclass(frozen=True)
class One:
    """A structure by its power on blocks."""

    power: np.ndarray
    parameters: int = 1
    scale: Scale = POWER
    rarity: float = 0.0
    keys: tuple[Key, ...] = ()

    @property
    def cost(self):
        return self.scale.cost(self.power, self.parameters)

    @property
    def seen_cost(self):
        return self.cost


def one(power, parameters=1, scale=POWER):
    return One(np.broadcast_to(power, 20)[:, None], parameters, scale)


def test_the_smaller_error_is_ahead_and_by_its_logarithm():
    better, worse = one(EVEN * np.where(np.arange(20) % 2, 0.20, 0.25)), one(EVEN)
    gain, doubt = paired(better, worse, POWER)
    assert (
        gain == pytest.approx(0.25 * (np.log(5.0) + np.log(4.0)), rel=0.05)
        and 0.0 < doubt < 0.1 * gain
    )
    assert paired(worse, better, POWER) == pytest.approx((-gain, doubt), rel=0.05)
    assert ahead(better, worse, POWER) > 10.0 and ahead(worse, better, POWER) < -10.0
    assert evidence(better, worse, POWER) > 50.0 and evidence(worse, better, POWER) < -50.0


def test_an_error_that_a_few_blocks_hold_is_told_by_the_ratio_of_totals():
    """A machine that stands still in the other blocks: there chance decides, and the mean of logarithms with it."""
    moving, chance = np.arange(20) % 4 == 0, np.exp(2.0 * np.cos(7.0 * np.arange(20.0)))
    worse, better = one(np.where(moving, 30.0, 0.1)), one(np.where(moving, 3.0, 0.1 * chance))
    gain, doubt = paired(better, worse, POWER)
    assert gain < 2.5 * doubt
    assert ahead(better, worse, POWER) > 2.5 and ahead(worse, better, POWER) < 0.0


def test_block_by_block_no_block_counts_for_more_than_another():
    worse = one(np.where(np.arange(20) == 0, 400.0, 10.0) * EVEN)
    everywhere, at_one_place = one(3.0 * EVEN), one(np.where(np.arange(20) == 0, 10.0, 10.0) * EVEN)
    assert block_by_block(everywhere, worse, POWER) > 5.0
    assert block_by_block(at_one_place, worse, POWER) < 1.5


def test_nats_are_what_the_errors_gain_less_the_price_of_parameters():
    better, worse = one(0.5 * EVEN, 2, NATS), one(EVEN, 1, NATS)
    assert evidence(better, worse, NATS) == pytest.approx(0.25 * EVEN.sum() - 3.0)


def test_what_takes_away_nothing_is_not_real_and_what_takes_half_is():
    base = one(EVEN, 0)
    assert is_real(one(0.5 * EVEN), base, base, POWER, 30)
    assert not is_real(one(0.95 * EVEN), base, base, POWER, 30)  # under a tenth
    chance = np.where(np.arange(20) % 2, 0.45, 1.3)
    # an eighth, that half of the blocks deny
    assert not is_real(one(chance), base, base, POWER, 30)
    assert not is_real(one(2.0 * EVEN), base, base, POWER, 30)


def test_the_fewest_parameters_among_those_that_the_best_does_not_stand_before():
    plain, rich, poor = one(0.30 * EVEN, 1), one(0.29 * EVEN, 3), one(0.8 * EVEN, 0)
    assert simplest([rich, plain, poor], POWER) is plain
    assert simplest([rich, one(0.6 * EVEN, 1), poor], POWER) is rich


@pytest.mark.parametrize(
    ("more", "rare", "told"), [(0.0, 0.0, "balance"), (0.5, 0.0, "input"), (0.0, 0.5, "input")]
)
def test_of_one_equation_at_two_places_the_balance_is_told_and_not_what_costs_a_parameter_less(
    more, rare, told
):
    """Unless noise tells them apart, or the balance's effect is rarer."""
    path = replace(one(EVEN, 4, NATS), keys=(Key("input-power", "duty"),))
    balance = replace(
        one((1.0 + more) * EVEN, 5, NATS),
        keys=(Key("heater-nonlinearity", "chamber"),),
        rarity=rare,
    )
    assert simplest([path, balance], NATS) is {"input": path, "balance": balance}[told]


def test_alike_is_what_no_pairs_of_blocks_tell_apart():
    rng = np.random.default_rng(4)
    chosen, other = (
        one(0.3 * np.exp(0.3 * rng.normal(size=20))),
        one(0.3 * np.exp(0.3 * rng.normal(size=20))),
    )
    assert is_alike(other, chosen, None, POWER)
    assert not is_alike(one(0.6 * EVEN), one(0.3 * EVEN), None, POWER)


def test_a_rare_effect_has_to_earn_more_than_one_that_is_often_missing():
    """With the same errors the usual one stands first; and a tenth of what is left is too little for what was never seen."""
    base, less = one(EVEN, 0), 0.85 * EVEN
    assert is_real(one(less), base, base, POWER, 30)
    assert not is_real(replace(one(less), rarity=RARE), base, base, POWER, 30)
    assert is_real(replace(one(0.7 * EVEN), rarity=RARE), base, base, POWER, 30)
    drive = load_model("gate-drive")
    shaft = next(name for name, balance in drive.balances.items() if balance.kind == "torque")
    output = next(iter(drive.outputs))
    assert (
        rarity(drive, Key("coulomb-friction", shaft))
        == 0.0
        < rarity(drive, Key("elastic-transmission", shaft))
        < RARE
    )
    assert rarity(drive, Key("output-drift", output)) == RARE
    assert rarity(drive, Key("held", "J")) == 0.0


def test_what_leaves_less_with_fewer_parameters_takes_the_place_of_the_best():
    best = one(EVEN, parameters=6)
    simpler, dearer, worse = one(0.99 * EVEN, 5), one(0.99 * EVEN, 6), one(1.01 * EVEN, 5)
    rare = replace(simpler, rarity=RARE)
    assert simpler_ones([dearer, worse, rare, simpler], best) == [simpler]
