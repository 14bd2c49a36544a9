"""Plants known by their frequency response alone: Nyquist's criterion against roots, and designs on the data."""

import numpy as np
import pytest

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.loop import (
    Loop,
    MeasuredPlant,
    Weights,
    closed_loop_unstable_poles,
    frequency_grid,
)
from residuum.robust_control.synthesis.constrained_structure import PIDN
from residuum.robust_control.synthesis.structured_synthesis import synthesise
from residuum.robust_control.weights.performance_weight import ReferenceModel

TS = 0.05
OMEGA = np.geomspace(1e-3, np.pi / TS, 900)


def measured(plant, omega=OMEGA, **known):
    return MeasuredPlant(omega, plant.frequency_response(omega), TS, **known)


def random_plant(rng):
    poles = np.concatenate(
        [
            [r * np.exp(1j * a), r * np.exp(-1j * a)]
            for r, a in [(rng.uniform(0.3, 0.97), rng.uniform(0, 2))]
        ]
    )
    return TransferFunction(rng.normal(size=2), np.real(np.poly(poles)), TS)


def test_turns_count_the_same_poles_as_the_roots():
    rng, known = np.random.default_rng(0), 0
    for _ in range(300):
        plant, structure = random_plant(rng), PIDN(TS)
        K = structure.transfer_function(
            rng.normal(size=4) * [0.5, 0.5, 0.05, 0] + [0, 0, 0, rng.uniform(0.03, 0.5)]
        )
        roots = np.roots(np.polyadd(np.polymul(plant.den, K.den), np.polymul(plant.num, K.num)))
        outside = int(np.sum(np.abs(roots) > 1))
        L = plant.frequency_response(OMEGA) * K.frequency_response(OMEGA)
        found = closed_loop_unstable_poles(L, 0, 1)
        known += found is not None
        assert found in (None, outside)
    assert known > 250


def test_unstable_and_integrating_plants_are_counted_with_their_poles():
    unstable = TransferFunction([0.1], [1.0, -1.05], TS)
    double = TransferFunction([0.01], [1.0, -1.0], TS)
    gain = TransferFunction([1.5], [1.0], TS)
    assert Loop([measured(unstable, unstable_poles=1)], OMEGA).is_stable(gain)
    # taken for stable, the turns do not fit
    assert not Loop([measured(unstable)], OMEGA).is_stable(gain)
    assert Loop([measured(double, integrators=1)], OMEGA).is_stable(
        PIDN(TS).transfer_function(np.array([5.0, 0.5, 0.0, 0.1]))
    )


def test_a_grid_that_is_too_coarse_or_too_short_is_never_called_stable():
    plant = TransferFunction([1.0], [1.0, *np.zeros(20)], TS)
    K = PIDN(TS).transfer_function(np.array([1.2, 0.3, 0.0, 0.1]))
    assert not Loop([plant], OMEGA).is_certainly_stable(K)
    for omega in (np.geomspace(1e-3, np.pi / TS, 30), np.geomspace(3.0, 14.0, 500)):
        assert not Loop([measured(plant, omega)], omega).is_stable(K)
        assert (
            closed_loop_unstable_poles(
                plant.frequency_response(omega) * K.frequency_response(omega), 0, 1
            )
            is None
        )


def test_a_design_on_data_is_that_on_the_plant():
    plant = TransferFunction([2.0], [1.0, 1.2, 1.0]).discretise(TS)
    data = measured(plant)
    omega = frequency_grid([data])
    weights = Weights(
        ReferenceModel(0.05, 6.0).weight_magnitude(omega),
        np.abs(TransferFunction([0.3, 0.3], [0.01, 1.0]).frequency_response(omega)),
    )
    by_data, by_plant = (synthesise(Loop([one], omega), weights, PIDN(TS)) for one in (data, plant))
    assert by_data.stable and by_data.cost == pytest.approx(by_plant.cost, rel=1e-3)
    assert Loop([plant], omega).is_certainly_stable(by_data.controller)


def test_bad_data_are_refused():
    good = np.array([1.0, 2.0])
    with pytest.raises(BadInput, match="must increase"):
        MeasuredPlant(good[::-1], good, TS)
    with pytest.raises(BadInput, match="not finite"):
        MeasuredPlant(good, np.array([1.0, np.nan]), TS)
    with pytest.raises(BadInput, match="needs two or more"):
        MeasuredPlant(good, np.ones(3), TS)
    with pytest.raises(BadInput, match="measured from"):
        Loop([MeasuredPlant(good, good, TS)], np.array([0.5, 1.0]))
