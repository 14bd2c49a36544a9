"""Parameters that are held stay where they are, limits hold, and freedom that is taken away costs."""

import numpy as np
import pytest

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.loop import Loop, Weights, frequency_grid
from residuum.robust_control.synthesis.constrained_structure import (
    PI,
    PID,
    PIDN,
    Constrained,
    Rational,
)
from residuum.robust_control.synthesis.structured_synthesis import synthesise
from residuum.robust_control.weights.performance_weight import ReferenceModel

TS = 0.05
PLANT = TransferFunction([2.0], [1.0, 1.2, 1.0]).discretise(TS)
OMEGA = frequency_grid([PLANT], points=300, lowest=1e-3)
LOOP = Loop([PLANT], OMEGA)
WEIGHTS = Weights(
    ReferenceModel(0.05, 6.0).weight_magnitude(OMEGA),
    np.abs(TransferFunction([0.3, 0.3], [0.01, 1.0]).frequency_response(OMEGA)),
)


def test_without_derivative_action_it_is_the_pi_controller():
    held = synthesise(LOOP, WEIGHTS, Constrained(PIDN(TS), fixed={"k_d": 0.0, "N_d": 1.0}))
    assert held.structure.names == ("k_p", "k_i")
    assert held.cost == pytest.approx(synthesise(LOOP, WEIGHTS, PI(TS)).cost, rel=1e-4)


def test_a_limit_that_bites_is_reached_and_costs():
    free = synthesise(LOOP, WEIGHTS, PIDN(TS))
    limit = 0.6 * free.rho[1]
    held = synthesise(LOOP, WEIGHTS, Constrained(PIDN(TS), within={"k_i": (0.0, limit)}))
    assert held.rho[1] <= limit and held.cost > free.cost and held.stable


def test_an_unfiltered_derivative_and_more_orders_are_between_pi_and_more_freedom():
    pi, pid = synthesise(LOOP, WEIGHTS, PI(TS)), synthesise(LOOP, WEIGHTS, PID(TS))
    rational = synthesise(LOOP, WEIGHTS, Rational(TS, order=2, numerator=2))
    assert pid.cost <= pi.cost * (1 + 1e-6) and rational.cost <= pid.cost * (1 + 1e-2)
    only = Rational(TS, order=2, numerator=0)
    assert only.names == ("b_0", "a_1") and synthesise(LOOP, WEIGHTS, only).stable


@pytest.mark.parametrize(
    "structure",
    [PID(TS), Rational(TS, order=3, numerator=1), Constrained(PIDN(TS), fixed={"k_p": 0.1})],
)
def test_responses_are_those_of_the_polynomials_and_their_slopes(structure):
    rho = structure.starts(2.0, 1.0)[1] * 1.3 + 0.01
    K, slope = structure.response(rho, LOOP.z)
    np.testing.assert_allclose(
        K, structure.transfer_function(rho).frequency_response(OMEGA), rtol=1e-8
    )
    for j in range(len(rho)):
        moved = structure.response(rho + 1e-7 * (np.arange(len(rho)) == j), LOOP.z)[0]
        np.testing.assert_allclose(slope[:, j], (moved - K) / 1e-7, rtol=1e-4, atol=1e-4)


def test_bad_constraints_are_refused():
    with pytest.raises(BadInput, match="has no parameter 'gain'"):
        Constrained(PI(TS), fixed={"gain": 1.0})
    with pytest.raises(BadInput, match="every parameter is fixed"):
        Constrained(PI(TS), fixed={"k_p": 1.0, "k_i": 1.0})
    with pytest.raises(BadInput, match="lower must be below"):
        Constrained(PI(TS), within={"k_i": (2.0, 1.0)})
    with pytest.raises(BadInput, match="must lie within"):
        Constrained(PIDN(TS), fixed={"N_d": 0.0})
    with pytest.raises(BadInput, match="from 0 to the order"):
        Rational(TS, order=1, numerator=2)
