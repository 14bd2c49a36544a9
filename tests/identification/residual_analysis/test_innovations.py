"""Coloured, heavy-tailed noise: coefficients recovered beside outliers, memory limited, likelihood in its right place."""

import numpy as np
import pytest
from scipy.linalg import toeplitz
from scipy.signal import lfilter
from scipy.stats import t

from residuum.identification.residual_analysis.noise import (
    ColouredNoise,
    fit_noises,
    log_density,
    squared_scale,
)
from residuum.identification.residual_analysis.policy import FREEDOM


def coloured(n, rho, seed=0):
    return lfilter([1.0], [1.0, -rho], np.random.default_rng(seed).standard_normal(n))


def test_coefficient_survives_outliers_that_ruin_the_variance():
    e = np.random.default_rng(0).standard_normal(5000)
    e[::250] += 40.0
    (noise,) = fit_noises([lfilter([1.0], [1.0, -0.8], e)[:, None]], order=1)
    assert noise.a[0] == pytest.approx(-0.8, abs=0.03)
    assert noise.innovation_variance < 2.0 < np.var(e)


def test_density_is_that_of_the_t_distribution():
    e = np.linspace(-8.0, 8.0, 41)
    np.testing.assert_allclose(log_density(e, 1.7), t.logpdf(e, FREEDOM, scale=1.7), rtol=1e-12)


def test_scale_maximises_the_likelihood():
    e = 3.0 * np.random.default_rng(1).standard_t(FREEDOM, 20_000)
    s = np.sqrt(squared_scale(e, 0.0, 0.0))
    assert s == pytest.approx(3.0, rel=0.03)
    assert log_density(e, s).sum() > max(
        log_density(e, 0.97 * s).sum(), log_density(e, 1.03 * s).sum()
    )


def test_innovations_that_are_mostly_zero_keep_a_scale():
    """A reading in steps that the model follows: without it nothing would be left between noise and no noise at all."""
    e = np.zeros(6000)
    e[::20] = np.random.default_rng(3).choice([-4.0, 4.0], 300)
    (noise,) = fit_noises([e[:, None]])
    assert 0.1 < np.std(e) / np.sqrt(noise.innovation_variance) < 6.0


def test_an_unmeasured_output_has_no_noise_and_a_gap_is_left_out():
    v = coloured(400, 0.5)[:, None]
    v[100:110] = np.nan
    both = np.column_stack([v, np.full(400, np.nan)])
    noises = fit_noises([both], order=2)
    assert noises[1] is None
    assert np.all(np.isfinite(noises[0].a))


def test_a_slow_error_is_not_called_noise():
    """A drift over the whole record may not be whitened away by poles at one."""
    drift = np.cumsum(np.cumsum(np.random.default_rng(2).standard_normal(3000)))[:, None]
    (noise,) = fit_noises([drift])
    assert np.abs(np.roots(np.r_[1.0, noise.a])).max() <= np.exp(-1.0 / 100.0) + 1e-9


def test_the_first_samples_have_the_density_of_the_noise_itself():
    """Innovations and their spreads are those of a Cholesky factor of the covariance, got here from the impulse response."""
    A = np.poly([0.95, 0.5, -0.3 + 0.4j, -0.3 - 0.4j]).real
    noise, n = ColouredNoise(A[1:], 2.0), 12
    h = lfilter([1.0], A, np.r_[1.0, np.zeros(4000)])
    covariance = 2.0 * toeplitz([np.sum(h[: len(h) - k] * h[k:]) for k in range(n)])
    factor = np.linalg.cholesky(covariance) / np.sqrt(2.0)
    x = np.random.default_rng(3).standard_normal(n)
    np.testing.assert_allclose(
        noise.innovations(x), np.linalg.solve(factor, x), rtol=1e-9, atol=1e-12
    )
    np.testing.assert_allclose(
        np.pad(noise.first[1], (0, n - noise.order)), np.log(np.diag(factor)), atol=1e-12
    )
    np.testing.assert_allclose(noise.innovations(x[:2]), noise.innovations(x)[:2], rtol=1e-12)


def test_a_noise_that_is_near_leads_to_the_same():
    rng = np.random.default_rng(5)
    v = lfilter([1.0], [1.0, -1.2, 0.4], rng.standard_t(5, size=6000))[:, None]
    (cold,), (warm,) = fit_noises([v]), fit_noises([v + 0.01], near=fit_noises([0.9 * v]))
    np.testing.assert_allclose(warm.a, cold.a, atol=0.005)
    assert warm.innovation_variance == pytest.approx(cold.innovation_variance, rel=0.01)


def test_no_innovation_of_a_coarse_reading_is_known_better_than_its_steps_allow():
    """A model that follows the stairs nearly always leaves next to nothing; without a floor its likelihood has no end."""
    rng = np.random.default_rng(2)
    residual = np.where(rng.random(4000) < 0.1, 2.0 * rng.choice([-1.0, 1.0], 4000), 1e-5)[:, None]
    reading = np.array([4.0 / 12.0])
    free, floored = (fit_noises([residual], 0, reading=r) for r in (None, reading))
    assert free[0].innovation_variance < 1e-6
    assert floored[0].innovation_variance == pytest.approx(reading[0] / 30.0)
