import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from residuum.identification.errors import NotIdentifiable
from residuum.identification.kernel_based.gram import regression_sums


def plain_regression(inputs, y, order, delay):
    """Φ and y written out row by row; rows with a missing value are left out."""
    rows, targets = [], []
    for t in range(delay + order - 1, len(y)):
        row = np.concatenate([[u[t - delay - i] for i in range(order)] for u in inputs])
        if not (np.isnan(row).any() or np.isnan(y[t])):
            rows.append(row)
            targets.append(y[t])
    return np.array(rows).reshape(len(rows), len(inputs) * order), np.array(targets)


def assert_equal_sums(sums, Phi, target):
    scale = max(1.0, np.abs(Phi.T @ Phi).max())
    np.testing.assert_allclose(sums.gram, Phi.T @ Phi, atol=1e-11 * scale)
    np.testing.assert_allclose(sums.cross, Phi.T @ target, atol=1e-11 * scale)
    np.testing.assert_allclose(
        [sums.energy, sums.output_sum], [target @ target, target.sum()], atol=1e-11 * scale
    )
    np.testing.assert_allclose(sums.regressor_sum, Phi.sum(axis=0), atol=1e-11 * scale)
    assert sums.rows == len(target)


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    n=st.integers(10, 300),
    order=st.integers(1, 9),
    delay=st.integers(0, 3),
    n_inputs=st.integers(1, 2),
    gaps=st.integers(0, 6),
)
def test_sums_equal_the_regression_written_out(seed, n, order, delay, n_inputs, gaps):
    rng = np.random.default_rng(seed)
    inputs, y = [rng.standard_normal(n) for _ in range(n_inputs)], rng.standard_normal(n)
    for signal in (*inputs, y):
        signal[rng.integers(0, n, gaps)] = np.nan
    Phi, target = plain_regression(inputs, y, order, delay)
    if len(target):
        assert_equal_sums(regression_sums(inputs, y, order, delay), Phi, target)


def test_long_run_over_many_rows_and_orders():
    rng = np.random.default_rng(1)
    u, y = rng.standard_normal(20_000).astype(np.float32), rng.standard_normal(20_000)
    Phi, target = plain_regression([u[:3000].astype(float)], y[:3000], 150, 1)
    assert_equal_sums(regression_sums([u[:3000]], y[:3000], 150), Phi, target)


def test_centred_sums_are_those_of_deviations_from_the_mean():
    rng = np.random.default_rng(2)
    u, y = 5 + rng.standard_normal(80), -3 + rng.standard_normal(80)
    Phi, target = plain_regression([u], y, 4, 1)
    centred = regression_sums([u], y, 4).centred()
    Phi, target = Phi - Phi.mean(axis=0), target - target.mean()
    np.testing.assert_allclose(centred.gram, Phi.T @ Phi, atol=1e-10)
    np.testing.assert_allclose(centred.cross, Phi.T @ target, atol=1e-10)
    assert centred.degrees_of_freedom == 75


def test_no_complete_row_is_refused():
    with pytest.raises(NotIdentifiable, match="needs 6 samples in a row"):
        regression_sums([np.arange(5.0)], np.arange(5.0), order=5, delay=1)
