"""Coprime factors, spectral factor, norms, reduction and the AFDP post-filter, each against an independent computation."""

import numpy as np
import pytest
from scipy import signal

from residuum.diagnosis.residuals.generators.approximate_fault_detection import (
    approximate_fault_detection,
    noise_path,
)
from residuum.diagnosis.systems import (
    balanced_truncation,
    co_outer_factor,
    h_infinity_norm,
    left_coprime,
    peak_gain,
)
from residuum.identification.errors import BadModel
from residuum.identification.linear_models.state_space import StateSpace
from residuum.identification.linear_models.transfer_function import TransferFunction

TS = 0.1
OMEGA = np.linspace(1e-3, np.pi / TS, 101)
PROCESS = TransferFunction([47619.0], [1.0, 234.0136, 6857.1, 5442.2]).discretise(TS)
RESONANT = TransferFunction([0.28261, 0.50666], [1.0, -1.41833, 1.58939, -1.31608, 0.88642], TS)
UNSTABLE = TransferFunction([1.0, -0.5], [1.0, -2.1, 1.1], TS)
WEIGHT = TransferFunction([0.5, -0.45], [1.0, -0.3], TS)
PLANTS = {"process": PROCESS, "resonant": RESONANT, "unstable": UNSTABLE}


def state_space(system):
    return StateSpace.from_transfer_function(system)


def finite_impulse_response(system, m):
    g = system.simulate(np.eye(1, m + 1)[0])[1:]
    return TransferFunction(g, np.eye(1, m + 1)[0], TS)


@pytest.mark.parametrize("name", PLANTS)
@pytest.mark.parametrize("normalised", [False, True])
def test_coprime_factors_are_stable_and_give_the_plant_back(name, normalised):
    factors = left_coprime(state_space(PLANTS[name]), normalised=normalised)
    M, N = (part.frequency_response(OMEGA)[:, 0, 0] for part in (factors.M, factors.N))
    assert factors.M.is_stable and factors.N.is_stable
    assert np.allclose(N / M, PLANTS[name].frequency_response(OMEGA), rtol=1e-6, atol=1e-9)
    if normalised:
        assert np.allclose(np.abs(M) ** 2 + np.abs(N) ** 2, 1.0, atol=1e-9)


def test_an_undetectable_plant_is_refused():
    hidden = StateSpace(
        np.diag([2.0, 0.5]), np.ones((2, 1)), np.array([[0.0, 1.0]]), np.zeros((1, 1)), TS
    )
    with pytest.raises(BadModel, match="not detectable"):
        left_coprime(hidden)


def test_co_outer_factor_has_the_spectrum_and_a_stable_inverse():
    rng = np.random.default_rng(1)
    A = rng.standard_normal((5, 5))
    wide = StateSpace(0.9 * A / np.abs(np.linalg.eigvals(A)).max(), rng.standard_normal((5, 3)), rng.standard_normal((2, 5)),
                      rng.standard_normal((2, 3)), TS)  # fmt: skip
    factor = co_outer_factor(wide)
    G, Go = (system.frequency_response(OMEGA[::10]) for system in (wide, factor))
    assert np.allclose(
        G @ G.conj().transpose(0, 2, 1), Go @ Go.conj().transpose(0, 2, 1), atol=1e-8
    )
    assert factor.is_stable and factor.inverse().is_stable


@pytest.mark.parametrize("name", ["process", "resonant"])
def test_h_infinity_norm_is_the_peak_of_a_very_fine_grid(name):
    norm, at = h_infinity_norm(state_space(PLANTS[name]))
    fine = np.abs(PLANTS[name].frequency_response(np.linspace(0, np.pi / TS, 400_001)))
    assert norm >= fine.max() * (1 - 1e-9)
    assert norm == pytest.approx(fine.max(), rel=1e-5)
    assert abs(PLANTS[name].frequency_response([at])[0]) == pytest.approx(norm, rel=1e-9)


def test_peak_gain_is_reached_by_the_worst_input():
    lag = state_space(RESONANT)
    g = RESONANT.simulate(np.eye(1, 4000)[0])
    assert peak_gain(lag)[0, 0] == pytest.approx(np.abs(g).sum(), rel=1e-6)
    worst = np.sign(g[::-1])
    assert RESONANT.simulate(worst)[-1] == pytest.approx(peak_gain(lag)[0, 0], rel=1e-6)


def test_balanced_truncation_keeps_its_error_bound():
    full = state_space(finite_impulse_response(PROCESS, 120))
    reduced = balanced_truncation(full, 0.05)
    error = h_infinity_norm(
        full.beside(reduced.system * -1.0) @ StateSpace.gain([[1.0], [1.0]], TS)
    )[0]
    assert reduced.system.order < 10 and error <= reduced.error_bound <= 0.05


@pytest.mark.parametrize("fault", ["sensor", "actuator"])
@pytest.mark.parametrize("name", [*PLANTS, "impulse response"])
def test_post_filter_keeps_the_budget_decouples_u_and_is_optimal(name, fault):
    plant = finite_impulse_response(PROCESS, 60) if name == "impulse response" else PLANTS[name]
    factors = left_coprime(state_space(plant))
    found = approximate_fault_detection(factors, WEIGHT, fault=fault, gamma=0.1)
    budget = np.linalg.norm(
        (found.Q @ noise_path(factors, WEIGHT)).frequency_response(OMEGA), axis=(1, 2)
    )
    assert (
        found.Q.is_stable
        and budget.max() <= 0.1 * (1 + 1e-9)
        and found.gamma == pytest.approx(0.1, rel=1e-9)
    )
    through = found.Q @ factors.observer
    G = np.stack([plant.frequency_response(OMEGA), np.ones(len(OMEGA))], axis=1)[:, :, None]
    assert np.abs(through.frequency_response(OMEGA) @ G).max() < 1e-9
    # Bound no filter can beat: γ times the largest ratio of fault gain to everything else.
    M, N = (part.frequency_response(OMEGA)[:, 0, 0] for part in (factors.M, factors.N))
    other = np.sqrt(np.abs(N * WEIGHT.frequency_response(OMEGA)) ** 2 + np.abs(M) ** 2)
    limit = 0.1 * np.max(np.abs(M if fault == "sensor" else N) / other)
    assert 0.95 * limit <= found.beta <= limit * (1 + 1e-6)


@pytest.mark.parametrize(
    ("weight", "says"),
    [
        (TransferFunction([1.0], [1.0, -1.2], TS), "stable and proper"),
        (TransferFunction([1.0, 0.0, 0.0], [1.0, -0.2], TS), "stable and proper"),
        (TransferFunction([1.0], [1.0, -0.2], 2 * TS), "sample time"),
    ],
)
def test_a_weight_that_cannot_serve_is_refused(weight, says):
    with pytest.raises(BadModel, match=says):
        approximate_fault_detection(left_coprime(state_space(PROCESS)), weight)


def test_sample_times_that_differ_by_rounding_are_the_same():
    read = TransferFunction(
        [0.5, -0.45], [1.0, -0.3], float(np.median(np.diff(TS * np.arange(4000)))) * (1.0 - 1e-15)
    )
    assert read.sample_time != TS
    assert approximate_fault_detection(
        left_coprime(state_space(PROCESS)), read, gamma=0.1
    ).gamma == pytest.approx(0.1)


def test_improper_and_continuous_models_are_refused():
    with pytest.raises(BadModel, match="not proper"):
        state_space(TransferFunction([1.0, 0.0, 0.0], [1.0, 0.5], TS))
    with pytest.raises(BadModel, match="continuous"):
        state_space(TransferFunction([1.0], [1.0, 1.0]))


def test_state_space_filter_equals_the_difference_equation_and_is_blind_to_blocks():
    u = np.random.default_rng(3).standard_normal(500)
    system = state_space(RESONANT)
    whole, _ = system.simulate(u[:, None])
    first, state = system.simulate(u[:123, None])
    second, _ = system.simulate(u[123:, None], state)
    assert np.array_equal(np.concatenate([first, second]), whole)
    delayed = np.concatenate([np.zeros(3), RESONANT.num])
    assert np.allclose(whole[:, 0], signal.lfilter(delayed, RESONANT.den, u), atol=1e-9)
