"""Mean, scatter and dependence of values on the run, of made windows whose truth is known."""

import numpy as np
import pytest

from residuum.diagnosis.model_based.window_fit import Scatter

WINDOWS = 400


def drawn(seed, slope, doubt):
    """Values 3 + slope·φ with a standard deviation of 0.2 between windows, each told with a standard deviation `doubt`."""
    rng = np.random.default_rng(seed)
    phi = rng.standard_normal(WINDOWS)
    true = 3.0 + slope * phi + 0.2 * rng.standard_normal(WINDOWS)
    told = true + doubt * rng.standard_normal(WINDOWS)
    return np.column_stack([np.ones(WINDOWS), phi]), told[:, None]


def test_what_windows_leave_open_is_no_scatter_between_them():
    F, x = drawn(1, slope=0.0, doubt=0.5)
    found = Scatter.of(F, x, [np.array([[4.0]])] * WINDOWS, np.array([1e-3]))
    assert np.sqrt(found.S[0, 0]) == pytest.approx(0.2, rel=0.25)
    assert found.at(F[0])[0][0] == pytest.approx(3.0, abs=0.1)


def test_values_that_move_with_the_run_are_expected_to():
    F, x = drawn(2, slope=1.0, doubt=0.0)
    found = Scatter.of(F, x, None, np.array([1e-3]))
    mean, covariance = found.at(np.array([1.0, 2.0]))
    assert mean[0] == pytest.approx(5.0, abs=0.1) and np.sqrt(covariance[0, 0]) == pytest.approx(
        0.2, rel=0.15
    )


def test_the_scatter_widens_far_from_the_runs_seen():
    F, x = drawn(3, slope=0.0, doubt=0.0)
    found = Scatter.of(F[:12], x[:12], None, np.array([1e-3]))
    near, far = (found.at(np.array([1.0, phi]))[1][0, 0] for phi in (0.0, 30.0))
    assert far > 1.5 * near


def test_values_that_nothing_tells_are_those_of_the_others():
    F, x = drawn(4, slope=0.0, doubt=0.0)
    x[0] = 1e3
    information = [np.array([[0.0]]), *[np.array([[1e6]])] * (WINDOWS - 1)]
    assert Scatter.of(F, x, information, np.array([1e-3])).at(F[1])[0][0] == pytest.approx(
        3.0, abs=0.1
    )


@pytest.mark.parametrize("told", [0.0, 1e-4])
def test_values_that_no_window_tells_scatter_no_more_than_they_must(told):
    """Few windows of several features: what nothing tells may not grow from step to step of the search for the scatter."""
    rng = np.random.default_rng(5)
    F, x = (
        np.column_stack([np.ones(8), rng.standard_normal((8, 3))]),
        1e-9 * rng.standard_normal((8, 1)),
    )
    found = Scatter.of(F, x, [np.array([[told]])] * 8, np.array([1e-6]))
    assert 0.0 < found.S[0, 0] < (1e-4) ** 2
