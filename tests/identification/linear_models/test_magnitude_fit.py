from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import optimize

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.error_bounds.magnitude_fit import (
    between_samples,
    fit_magnitude,
    worst_distance_db,
)
from residuum.identification.linear_models.transfer_function import TransferFunction

OMEGA = np.geomspace(1e-2, 1e2, 80)
TRUTH = TransferFunction([3.0, 0.6, 40.0], [1.0, 2.0, 5.0, 0.4])


def bump(omega):
    """Magnitudes that no rational function of low order meets."""
    return 0.02 + 2 * np.exp(-(np.log(omega / 3) ** 2)) + 0.5 * (omega > 20)


@pytest.mark.parametrize("sample_time", [None, 0.03])
def test_a_system_of_the_same_order_comes_back(sample_time):
    truth = TRUTH if sample_time is None else TRUTH.discretise(sample_time)
    fit = fit_magnitude(
        OMEGA, np.abs(truth.frequency_response(OMEGA)), order=3, bound="at", sample_time=sample_time
    )
    assert worst_distance_db(fit, OMEGA, np.abs(truth.frequency_response(OMEGA))) < 0.01
    np.testing.assert_allclose(np.sort_complex(fit.poles), np.sort_complex(truth.poles), rtol=1e-2)


@pytest.mark.parametrize("order", [1, 2])
def test_the_optimum_is_global(order):
    """A search over poles, zeros and gain by differential evolution finds nothing better."""

    def spread(x):
        pairs = x.reshape(order, 2)
        ratio = (
            np.prod(
                [np.abs((1j * OMEGA + np.exp(z)) / (1j * OMEGA + np.exp(p))) for z, p in pairs],
                axis=0,
            )
            if order == 1
            else None
        )
        if order == 2:
            (z, p), (dz, dp) = pairs
            s = 1j * OMEGA
            ratio = np.abs(
                (s**2 + 2 * np.exp(dz + z) * s + np.exp(2 * z))
                / (s**2 + 2 * np.exp(dp + p) * s + np.exp(2 * p))
            )
        decibel = 20 * np.log10(ratio / bump(OMEGA))
        return np.ptp(decibel)

    best = optimize.differential_evolution(
        spread, [(-6, 8), (-6, 8), (-4, 4), (-4, 4)][: 2 * order], seed=0, maxiter=150, tol=1e-10
    )
    fit = fit_magnitude(OMEGA, bump(OMEGA), order=order, bound="at")
    assert 2 * worst_distance_db(fit, OMEGA, bump(OMEGA)) <= best.fun + 0.02


@pytest.mark.parametrize("bound", ["above", "below"])
@pytest.mark.parametrize("sample_time", [None, 0.03])
@pytest.mark.parametrize("order", [0, 1, 2, 5, None])
def test_the_bound_holds_between_the_samples(bound, sample_time, order):
    fit = fit_magnitude(OMEGA, bump(OMEGA), order=order, bound=bound, sample_time=sample_time)
    dense, level = between_samples(OMEGA, bump(OMEGA), 4)
    excess = np.log(np.abs(fit.frequency_response(dense)) / level) * (1 if bound == "above" else -1)
    assert excess.min() >= 0
    assert excess.min() < 1e-7  # it touches
    assert fit.is_stable
    assert fit.is_proper


def test_a_bound_that_all_but_touches_nought_has_a_real_minimum_phase_factor():
    """Rounding gave its double zero on the unit circle as two of the same half: the product of the factors was not real."""
    rng = np.random.default_rng(352100)
    omega = np.cumsum(rng.uniform(0.01, 1.0, 9))
    spread = 4.199957191062478
    fit = fit_magnitude(
        omega, np.exp(rng.uniform(-spread, spread, 9)), order=3, sample_time=np.pi / omega[-1]
    )
    assert fit.is_stable
    assert np.all(np.abs(fit.zeros) < 1)


@settings(max_examples=15, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    size=st.integers(2, 60),
    spread=st.floats(0, 8),
    order=st.integers(0, 6),
)
def test_any_positive_samples_give_a_stable_minimum_phase_bound(seed, size, spread, order):
    rng = np.random.default_rng(seed)
    omega = np.cumsum(rng.uniform(0.01, 1.0, size))
    magnitude = np.exp(rng.uniform(-spread, spread, size))
    fit = fit_magnitude(omega, magnitude, order=order, sample_time=np.pi / omega[-1])
    assert fit.is_stable
    assert fit.is_proper
    assert np.all(np.abs(fit.zeros) < 1)
    assert np.all(np.abs(fit.frequency_response(omega)) >= magnitude * (1 - 1e-9))


def test_more_order_is_never_worse():
    distances = [
        worst_distance_db(fit_magnitude(OMEGA, bump(OMEGA), order=order), OMEGA, bump(OMEGA))
        for order in range(7)
    ]
    assert all(later <= earlier + 1e-6 for earlier, later in pairwise(distances))
    assert distances[6] < 0.5 * distances[1]


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"omega": [1.0, 1.0]}, "increasing"),
        ({"magnitude": [1.0, 0.0]}, "is 0 at 2 rad/s; must be positive"),
        ({"magnitude": [1.0]}, "equally many"),
        ({"sample_time": 3.0}, "Nyquist"),
        ({"order": 99}, "order: is 99"),
        ({"bound": "near"}, "must be above, at or below"),
    ],
)
def test_bad_samples_are_refused(changes, match):
    arguments = {"omega": [1.0, 2.0], "magnitude": [1.0, 2.0]} | changes
    with pytest.raises(BadInput, match=match):
        fit_magnitude(arguments.pop("omega"), arguments.pop("magnitude"), **arguments)
