"""Curves of terms over signals: means of known functions, the signal that tells, and an effect's own law."""

import numpy as np
import pytest

from residuum.identification.physics import Key, load_model, match
from residuum.identification.record import Record
from residuum.identification.residual_analysis.locate import Axis
from residuum.identification.residual_analysis.term_curves import binned, effect_curves, telling
from residuum.simulation import MACHINES

RNG = np.random.default_rng(5)


def test_the_mean_of_a_bin_is_the_function_there():
    x = RNG.uniform(-2.0, 3.0, 20_000)
    curve = binned(x, x**3 + RNG.normal(0.0, 0.1, len(x)), 40)
    assert np.allclose(curve.mean, curve.at**3, atol=0.05 + 0.02 * np.abs(curve.at**3).max())
    assert np.all(np.diff(curve.at) > 0.0)


def test_what_is_unknown_is_in_no_bin():
    x, y = np.arange(100.0), np.where(np.arange(100) < 50, np.nan, 1.0)
    curve = binned(x, y, 10)
    assert curve.at.min() >= 50.0 and np.all(curve.mean == 1.0)
    assert len(binned(np.full(9, np.nan), np.ones(9), 10).at) == 0


def test_the_signal_that_a_term_is_a_function_of_tells_most():
    speed, position = RNG.normal(size=(2, 5000))
    term = np.sign(speed) + RNG.normal(0.0, 0.2, 5000)
    axes = [Axis("position", "m", "position", position), Axis("speed", "m/s", "velocity", speed)]
    assert telling(axes, term, 40).name == "speed"
    assert telling(axes[::-1], np.cos(2.0 * position), 40).name == "position"


def test_an_effect_is_drawn_by_its_own_law():
    signals = MACHINES["gate-drive"](3, {}, {}, 0).simulate(10.0)
    record = Record(signals.channels, signals.units, signals.sample_time)
    model, experiments = match(load_model("gate-drive"), [record], None)
    every = {
        axis.name: curve
        for axis, curve in effect_curves(
            model, experiments, Key("coulomb-friction", "shaft"), {"tau_c": 0.05}
        )
    }
    speed = every["speed"]
    fast = np.abs(speed.at) > 0.2 * np.abs(speed.at).max()
    assert fast.sum() > 10
    assert speed.mean[fast] == pytest.approx(-0.05 * np.sign(speed.at[fast]), rel=0.05)
    assert not list(
        effect_curves(model, experiments, Key("input-offset", "voltage"), {"offset": 0.1})
    )
