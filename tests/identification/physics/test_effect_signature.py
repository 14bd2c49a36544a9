"""Pictures of effects follow their own equations, for the whole catalogue."""

import numpy as np
import pytest

from residuum.identification.physics.compile.effect_signature import SCENARIOS, signature
from residuum.identification.physics.effects import EFFECTS


@pytest.mark.parametrize("id", EFFECTS)
def test_every_effect_has_a_curve_over_an_axis_with_a_unit(id):
    drawn = signature(EFFECTS[id])
    assert drawn.kind in EFFECTS[id].acts_on and len(drawn.at) == len(drawn.value) > 100
    assert (
        np.isfinite(drawn.value).all() and np.ptp(drawn.at) > 0 and drawn.axis_unit and drawn.unit
    )
    if drawn.before is None:
        assert np.abs(drawn.value).max() > 0
    else:
        assert np.abs(drawn.value - drawn.before).max() > 0.01 * np.ptp(drawn.before)


def values(drawn):
    return {each.name: each.value for each in drawn.parameters}


def test_curves_are_the_equations():
    viscous = signature(EFFECTS["viscous-friction"])
    np.testing.assert_allclose(viscous.value, -values(viscous)["d"] * viscous.at)
    radiation, kelvin = signature(EFFECTS["radiation"]), 273.15
    p = values(radiation)
    expected = -p["c"] * ((radiation.at + kelvin) ** 4 - (p["T_a"] + kelvin) ** 4)
    np.testing.assert_allclose(radiation.value, expected, atol=1e-9 * np.abs(expected).max())
    late = signature(EFFECTS["input-delay"])
    amplitude, period = SCENARIOS["input"].magnitude, SCENARIOS["input"].period
    after = late.at > values(late)["delay"]
    shifted = amplitude * np.sin(2 * np.pi * (late.at - values(late)["delay"]) / period)
    np.testing.assert_allclose(late.value[after], shifted[after], atol=1e-3 * amplitude)


def test_a_lag_follows_its_differential_equation():
    lag = signature(EFFECTS["output-lag"])
    w, tau = 2 * np.pi / SCENARIOS["output"].period, values(lag)["tau"]
    settled = lag.at > 8 * tau
    gain, phase = 1 / np.hypot(1, w * tau), np.arctan(w * tau)
    expected = SCENARIOS["output"].magnitude * gain * np.sin(w * lag.at - phase)
    np.testing.assert_allclose(lag.value[settled], expected[settled], atol=0.02)


def test_what_remembers_draws_a_loop_and_what_does_not_a_line():
    for id, loop in (("hysteresis", True), ("coulomb-friction", False), ("linear-spring", False)):
        drawn = signature(EFFECTS[id])
        middle = np.abs(drawn.at - np.median(drawn.at) - 0.1 * np.ptp(drawn.at)) < 0.01 * np.ptp(
            drawn.at
        )
        assert (np.ptp(drawn.value[middle]) > 0.5 * np.ptp(drawn.value)) == loop, id
