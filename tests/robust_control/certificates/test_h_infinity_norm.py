"""Norms of random systems against a fine search, a closed form and another package."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.state_space import StateSpace
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.certificates import h_infinity_norm
from residuum.robust_control.loop import Loop, weighted_loop


def random_system(rng, n=6, outputs=2):
    A = rng.normal(size=(n, n))
    A *= rng.uniform(0.7, 0.999) / np.abs(np.linalg.eigvals(A)).max()
    return StateSpace(
        A,
        rng.normal(size=(n, 1)),
        rng.normal(size=(outputs, n)),
        rng.normal(size=(outputs, 1)),
        1.0,
    )


def norm_by_search(system):
    """A dense grid about every pole, then a bounded search about the best point."""

    def gain(theta):
        return np.linalg.norm(system.response(np.exp(1j * np.atleast_1d(theta)))[:, :, 0], axis=1)

    poles = np.linalg.eigvals(system.A)
    near = [abs(np.angle(p)) + (1 - abs(p)) * np.linspace(-5, 5, 41) for p in poles]
    grid = np.unique(np.clip(np.concatenate([np.linspace(0, np.pi, 2000), *near]), 0, np.pi))
    k = int(np.argmax(gain(grid)))
    bounds = (grid[max(k - 1, 0)], grid[min(k + 1, len(grid) - 1)])
    found = minimize_scalar(
        lambda t: -gain(t)[0], bounds=bounds, method="bounded", options={"xatol": 1e-13}
    )
    return max(gain(grid)[k], -found.fun)


def test_random_systems_agree_with_a_fine_search():
    rng = np.random.default_rng(0)
    for _ in range(40):
        system = random_system(rng, n=int(rng.integers(1, 9)), outputs=int(rng.integers(1, 4)))
        assert h_infinity_norm(system)[0] == pytest.approx(norm_by_search(system), rel=1e-6)


def test_random_systems_agree_with_python_control():
    control = pytest.importorskip("control")
    rng = np.random.default_rng(1)
    for _ in range(5):
        system = random_system(rng, n=4, outputs=1)
        theirs = control.system_norm(
            control.ss(system.A, system.B, system.C, system.D, 1.0), p="inf", tol=1e-8
        )
        assert h_infinity_norm(system)[0] == pytest.approx(theirs, rel=1e-6)


def test_a_needle_that_a_grid_misses_is_found():
    pole = (1 - 1e-7) * np.exp(0.7j)
    needle = TransferFunction([1.0], np.real(np.poly([pole, pole.conj()])), 1.0)
    norm, theta = h_infinity_norm(StateSpace.from_transfer_function(needle))
    expected = np.abs(1 / ((np.exp(0.7j) - pole) * (np.exp(0.7j) - pole.conj())))
    assert norm == pytest.approx(expected, rel=1e-4) and theta == pytest.approx(0.7, abs=1e-6)


def test_the_weighted_loop_is_the_loop_of_transfer_functions():
    rng, omega = np.random.default_rng(2), np.geomspace(1e-3, np.pi, 50)
    plant = TransferFunction(
        rng.normal(size=60) * 0.9 ** np.arange(60), np.r_[1.0, np.zeros(60)], 1.0
    )
    controller = TransferFunction([0.02, -0.015], [1.0, -1.0], 1.0)
    W_S, W_T = (
        TransferFunction([0.6, -0.5], [1.0, -0.99], 1.0),
        TransferFunction([0.8, -0.3], [1.0, -0.2], 1.0),
    )
    L = plant.frequency_response(omega) * controller.frequency_response(omega)
    S, K = 1 / (1 + L), controller.frequency_response(omega)
    expected = np.stack(
        [W_S.frequency_response(omega) * S, W_T.frequency_response(omega) * L * S, K * S], axis=1
    )
    system = weighted_loop(plant, controller, W_S, W_T, TransferFunction([1.0], [1.0], 1.0))
    np.testing.assert_allclose(
        system.response(np.exp(1j * omega))[:, :, 0], expected, rtol=1e-7, atol=1e-9
    )
    assert system.is_stable == Loop([plant], omega).is_certainly_stable(controller)


def test_unstable_and_ill_posed_loops_are_refused():
    with pytest.raises(BadInput, match="not stable"):
        h_infinity_norm(
            StateSpace.from_transfer_function(TransferFunction([1.0], [1.0, -1.1], 1.0))
        )
    unit = TransferFunction([1.0], [1.0], 1.0)
    with pytest.raises(BadInput, match="not well posed"):
        weighted_loop(TransferFunction([-1.0], [1.0], 1.0), unit, unit)
