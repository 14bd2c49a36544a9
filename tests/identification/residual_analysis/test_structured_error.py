"""The structured-error test: quiet on noise of any colour, awake on structure."""

import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.identification.errors import BadInput
from residuum.identification.residual_analysis.noise import ColouredNoise, fit_coloured_noise
from residuum.identification.residual_analysis.structured_error import lasting_noise
from residuum.identification.residual_analysis.structured_error import (
    test_structured_error as structured_error,
)


def features(n, rng):
    u = np.repeat(rng.choice([-1, -0.5, 0, 0.5, 1], size=n // 100 + 1), 100)[:n]
    x = lfilter([0.05], [1, -0.95], u)
    shapes = [u, x, np.tanh(x / 0.05), x * np.abs(x), np.ones(n)]
    return np.stack(
        [lfilter([1 - pole], [1, -pole], shape) for shape in shapes for pole in (0, 0.9)], axis=1
    ), x


def coloured(n, rho, rng):
    v = lfilter([1], [1, -rho], rng.normal(size=n + 2000))[2000:]
    return v / v.std()


@pytest.mark.parametrize("rho", [0.0, 0.9, 1.0])
def test_noise_of_any_colour_is_not_called_structured(rho):
    called = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        called += structured_error(
            [coloured(2000, rho, rng)], [features(2000, rng)[0]], seed=seed + 100, n_bootstrap=25
        ).present
    assert called <= 1


@pytest.mark.parametrize("rho", [0.0, 0.9])
def test_an_error_that_follows_the_motion_is_found(rho):
    rng = np.random.default_rng(3)
    X, x = features(4000, rng)
    structure = lfilter([0.05], [1, -0.95], np.sign(x))
    found = structured_error([structure + coloured(4000, rho, rng)], [X], n_bootstrap=25)
    assert found.present and found.p_value < 1e-3
    assert np.corrcoef(found.predicted[0], structure)[0, 1] > 0.8
    assert found.noise_rms == pytest.approx(1.0, abs=0.2)


def counted(rng):
    """What a linear motor leaves of a concave one, whose encoder counts steps of 22 rpm; and features."""
    u = np.concatenate(
        [
            np.full(n, volts)
            for n, volts in zip(rng.integers(60, 250, 60), rng.uniform(3, 4.6, 60), strict=True)
        ]
    )[:2900]
    speed = lfilter([0.15], [1, -0.85], 900 * (1 - np.exp(-(u - 1) / 1.3)))
    read = 22.4 * np.diff(np.floor(np.cumsum(np.r_[0, speed]) / 22.4))
    linear = lfilter([0.15], [1, -0.85], u)
    shapes = (np.ones(u.size), u, u**2, speed, speed**2)
    X = np.stack(
        [lfilter([1 - pole], [1, -pole], s / s.max()) for s in shapes for pole in (0, 0.8, 0.97)],
        axis=1,
    )
    return read - linear * (read @ linear) / (linear @ linear), X


def test_noise_of_a_counted_reading_is_as_likely_as_noise_is():
    """Its colour is not the likeliest one for any of its draws: their statistic was nought, and every p-value one."""
    p_values = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        error, X = counted(rng)
        draw = lasting_noise([error], 12).simulate(2900, rng)
        p_values.append(structured_error([draw], [X], drifting=False, seed=seed).p_value)
    assert 0.2 < np.mean(p_values) < 0.8 and max(p_values) < 0.999


def test_gaps_are_left_out_and_stay_unknown():
    rng = np.random.default_rng(3)
    X, x = features(4000, rng)
    error = np.sign(x) + coloured(4000, 0.5, rng)
    error[1000:1200] = np.nan
    found = structured_error([error], [X], n_bootstrap=20)
    assert (
        found.present
        and np.isnan(found.predicted[0][1100])
        and np.isfinite(found.predicted[0][900])
    )


def test_too_few_samples_are_refused():
    with pytest.raises(BadInput, match="need"):
        structured_error([np.zeros(50)], [np.ones((50, 10))])


def test_colour_is_recovered_from_segments():
    rng = np.random.default_rng(0)
    true = ColouredNoise(np.array([-1.5, 0.7]), 2.0)
    found = fit_coloured_noise([true.simulate(4000, rng) for _ in range(3)], order=2)
    np.testing.assert_allclose(found.a, true.a, atol=0.03)
    assert found.innovation_variance == pytest.approx(2.0, rel=0.05)
    assert found.whiten(true.simulate(4000, rng)).std() == pytest.approx(np.sqrt(2.0), rel=0.05)


def test_noise_beside_one_feature_is_as_likely_as_noise_is():
    """The few draws of the null may lie close together by chance; no p-value comes of their spread alone."""
    rng = np.random.default_rng(4)
    decay = np.exp(-np.arange(300) / 30.0)[:, None]
    found = [
        structured_error([rng.normal(size=300)], [decay], drifting=False, seed=seed).p_value
        for seed in range(150)
    ]
    assert min(found) > 1e-5 and np.sum(np.array(found) < 0.01) <= 6
