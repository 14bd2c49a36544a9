import numpy as np
import pytest
from scipy import signal

from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.linear_models.autoregression import fit_autoregression
from residuum.identification.linear_models.validation import input_correlation_test, whiteness_test


def coloured_pair(seed, n=800):
    """A residual and an input, both strongly coloured, that have nothing to do with each other."""
    e, w = np.random.default_rng(seed).standard_normal((2, n))
    return signal.lfilter([1.0], [1, -0.9], e), signal.lfilter([1.0], [1, -0.95], w)


def test_coloured_noise_raises_no_alarm_unless_the_colour_is_ignored():
    pairs = [coloured_pair(seed) for seed in range(150)]
    alarms = sum(not input_correlation_test(v, u, level=0.05).passed for v, u in pairs)
    assert 1 <= alarms <= 16  # 5 % of 150; beyond with probability 0.1 %
    assert (
        sum(not input_correlation_test(v, u, level=0.05, coloured=False).passed for v, u in pairs)
        > 40
    )


def test_a_missed_path_is_found_behind_coloured_noise():
    found = 0
    for seed in range(10):
        v, u = coloured_pair(seed)
        found += not input_correlation_test(
            v + 0.4 * signal.lfilter([0, 0, 1.0], [1.0], u), u
        ).passed
    assert found == 10


def test_gaps_are_left_out():
    v, u = coloured_pair(1)
    v[100:110], u[400] = np.nan, np.nan
    assert input_correlation_test(v, u).passed
    assert not input_correlation_test(v + 0.5 * u, u).passed


def test_feedback_shows_at_negative_lags():
    e = np.random.default_rng(0).standard_normal(2000)
    u = signal.lfilter([0, 0, 1.0], [1.0], e) + 0.5 * np.random.default_rng(1).standard_normal(2000)
    assert input_correlation_test(e, u, lags=10).passed
    assert not input_correlation_test(e, u, lags=10, first_lag=-9).passed


def test_whiteness_has_its_level_and_power():
    rng = np.random.default_rng(2)
    assert (
        sum(not whiteness_test(rng.standard_normal(400), level=0.05).passed for _ in range(200))
        <= 20
    )
    assert not whiteness_test(signal.lfilter([1.0], [1, -0.4], rng.standard_normal(400))).passed


def test_autoregression_finds_order_and_poles_through_gaps():
    v = signal.lfilter([1.0], [1, -1.5, 0.8], np.random.default_rng(3).standard_normal(5000))
    v[1000:1050] = np.nan
    A, variance = fit_autoregression(v)
    np.testing.assert_allclose(A, [1, -1.5, 0.8], atol=0.05)
    assert variance == pytest.approx(1.0, rel=0.1)


def test_unusable_residuals_are_refused():
    with pytest.raises(NotIdentifiable, match="constant"):
        whiteness_test(np.ones(100))
    with pytest.raises(NotIdentifiable, match="needs more than twice"):
        input_correlation_test(
            np.random.default_rng(0).standard_normal(60),
            np.random.default_rng(1).standard_normal(60),
            lags=25,
        )
    with pytest.raises(BadInput, match="must exceed the 9"):
        whiteness_test(np.arange(100.0), lags=5, n_parameters=9)
