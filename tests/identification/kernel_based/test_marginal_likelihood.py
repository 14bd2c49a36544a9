"""The m × m forms against the textbook's n × n form (A.16)–(A.20), written out here on its own."""

import math

import numpy as np
import pytest
from scipy import linalg, optimize

from residuum.identification.kernel_based.gram import regression_sums
from residuum.identification.kernel_based.kernels import KERNELS
from residuum.identification.kernel_based.marginal_likelihood import marginal_likelihood

ETA = {"tc": [0.8], "dc": [0.85, 0.6], "ss": [0.9], "di": [0.7]}


@pytest.fixture(scope="module")
def regression():
    """Sums, Φ and y of a decaying response in noise."""
    rng = np.random.default_rng(3)
    u = rng.standard_normal(79)
    y = np.convolve(u, 0.8 ** np.arange(9))[:79] + 0.5 * rng.standard_normal(79)
    Phi = np.array([[u[t - 1 - i] for i in range(9)] for t in range(9, 79)])
    return regression_sums([u], y, 9), Phi, y[9:]


def textbook_value(Phi, y, K, scale, variance):
    """(yᵀ Z⁻¹ y + log|2π Z|)/2 by the Cholesky factor of Z = λ Φ K Φᵀ + σ² I, shape (n, n)."""
    T = np.linalg.cholesky(scale * Phi @ K @ Phi.T + variance * np.eye(len(y)))
    a = linalg.solve_triangular(T, y, lower=True)
    return 0.5 * a @ a + np.log(np.diag(T)).sum() + 0.5 * len(y) * math.log(2 * math.pi)


def search_variables(name, kappa):
    return np.array(
        [
            *(
                item.free(value)
                for item, value in zip(KERNELS[name].parameters, ETA[name], strict=True)
            ),
            math.log(kappa),
        ]
    )


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("variance", [0.03, 2.0])
def test_value_equals_the_textbook_form(name, variance, regression):
    sums, Phi, y = regression
    likelihood = marginal_likelihood(sums, KERNELS[name], 1, variance)
    K = KERNELS[name].matrix(9, ETA[name])
    expected = textbook_value(Phi, y, K, 5.0 * variance, variance)
    assert likelihood.value(search_variables(name, 5.0)) == pytest.approx(expected, rel=1e-8)


@pytest.mark.parametrize("name", KERNELS)
def test_profiled_value_is_the_textbook_form_at_its_best_variance(name, regression):
    sums, Phi, y = regression
    likelihood, x = marginal_likelihood(sums, KERNELS[name]), search_variables(name, 3.0)
    K = KERNELS[name].matrix(9, ETA[name])
    best = optimize.minimize_scalar(
        lambda log: textbook_value(Phi, y, K, 3.0 * math.exp(log), math.exp(log)),
        bounds=(-8, 5),
        method="bounded",
    )
    assert likelihood.value(x) == pytest.approx(best.fun, rel=1e-8)
    assert likelihood.posterior(x).noise_variance == pytest.approx(math.exp(best.x), rel=1e-3)


@pytest.mark.parametrize("name", KERNELS)
@pytest.mark.parametrize("variance", [None, 0.5])
def test_gradient_equals_differences_of_the_value(name, variance, regression):
    likelihood, x = (
        marginal_likelihood(regression[0], KERNELS[name], 1, variance),
        search_variables(name, 3.0),
    )
    value, gradient = likelihood.value_and_gradient(x)
    numeric = [
        (likelihood.value(x + h) - likelihood.value(x - h)) / 2e-5 for h in 1e-5 * np.eye(len(x))
    ]
    assert value == pytest.approx(likelihood.value(x), rel=1e-12)
    np.testing.assert_allclose(gradient, numeric, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("name", KERNELS)
def test_posterior_equals_the_textbook_form(name, regression):
    sums, Phi, y = regression
    posterior = marginal_likelihood(sums, KERNELS[name], 1, 0.3).posterior(
        search_variables(name, 4.0)
    )
    P = 4.0 * 0.3 * KERNELS[name].matrix(9, ETA[name])
    gain = P @ Phi.T @ np.linalg.inv(Phi @ P @ Phi.T + 0.3 * np.eye(len(y)))  # (A.17a), (A.17c)
    np.testing.assert_allclose(posterior.mean, gain @ y, rtol=1e-8, atol=1e-10)
    np.testing.assert_allclose(posterior.covariance, P - gain @ Phi @ P, rtol=1e-7, atol=1e-10)


def test_tc_and_dc_agree_on_their_common_line(regression):
    tc, dc = (marginal_likelihood(regression[0], KERNELS[name]) for name in ("tc", "dc"))
    for alpha in (0.3, 0.8, 0.99):
        tc_x = np.array([KERNELS["tc"].parameters[0].free(alpha), 1.0])
        dc_x = np.array([tc_x[0], KERNELS["dc"].parameters[1].free(math.sqrt(alpha)), 1.0])
        assert dc.value(dc_x) == pytest.approx(tc.value(tc_x), rel=1e-10)


@pytest.mark.parametrize("name", ["tc", "dc"])
def test_two_inputs_have_hyper_parameters_of_their_own(name):
    rng = np.random.default_rng(8)
    inputs, y = [rng.standard_normal(60), 3 * rng.standard_normal(60)], rng.standard_normal(60)
    sums = regression_sums(inputs, y, 4)
    Phi = np.array([[inputs[j][t - 1 - i] for j in (0, 1) for i in range(4)] for t in range(4, 60)])
    first, second = search_variables(name, 2.0), search_variables(name, 0.1)
    first[0] -= 0.5
    likelihood = marginal_likelihood(sums, KERNELS[name], 2, 0.7)
    (eta_1, _), (eta_2, _) = likelihood.hyper_parameters([*first, *second])
    P = 0.7 * linalg.block_diag(
        2.0 * KERNELS[name].matrix(4, eta_1), 0.1 * KERNELS[name].matrix(4, eta_2)
    )
    x = np.concatenate([first, second])
    assert likelihood.value(x) == pytest.approx(textbook_value(Phi, y[4:], P, 1.0, 0.7), rel=1e-8)
    numeric = [
        (likelihood.value(x + h) - likelihood.value(x - h)) / 2e-5 for h in 1e-5 * np.eye(len(x))
    ]
    np.testing.assert_allclose(likelihood.value_and_gradient(x)[1], numeric, rtol=1e-6, atol=1e-6)
