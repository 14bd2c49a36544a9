import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.kernels import KERNELS

OFF_NOMINAL = {"tc": [0.87], "dc": [0.9, -0.4], "ss": [0.93], "di": [0.6]}


@pytest.mark.parametrize("name", KERNELS)
def test_factor_is_a_root_of_the_matrix(name):
    K = KERNELS[name].matrix(12, OFF_NOMINAL[name])
    F, _ = KERNELS[name].factor(12, OFF_NOMINAL[name])
    np.testing.assert_allclose(F @ F.T, K, rtol=1e-9, atol=1e-12 * K[0, 0])


@pytest.mark.parametrize("name", KERNELS)
def test_whitened_derivative_matches_differences_of_the_matrix(name):
    kernel, eta = KERNELS[name], np.array(OFF_NOMINAL[name])
    F, changes = kernel.factor(6, eta)
    for k, E in enumerate(changes):
        step = np.eye(len(eta))[k] * 1e-6
        dK = (kernel.matrix(6, eta + step) - kernel.matrix(6, eta - step)) / 2e-6
        np.testing.assert_allclose(F @ E @ F.T, dK, rtol=1e-5, atol=1e-8 * np.abs(dK).max())


@given(alpha=st.floats(0.05, 0.999), m=st.integers(1, 60))
def test_tc_is_dc_at_the_square_root_of_alpha(alpha, m):
    tc = KERNELS["tc"].matrix(m, [alpha])
    np.testing.assert_allclose(KERNELS["dc"].matrix(m, [alpha, np.sqrt(alpha)]), tc, rtol=1e-9)


@pytest.mark.parametrize("name", KERNELS)
def test_long_fast_decays_stay_finite(name):
    eta = [0.02, 0.1] if name == "dc" else [0.02]
    F, changes = KERNELS[name].factor(1000, eta)
    assert np.isfinite(F).all()
    assert all(np.isfinite(E).all() for E in changes)


@pytest.mark.parametrize(
    ("name", "eta", "match"),
    [("tc", [1.0], "alpha: is 1"), ("dc", [0.5], "rho"), ("dc", [0.5, -1.2], "rho: is -1.2")],
)
def test_impossible_hyper_parameters_are_refused(name, eta, match):
    with pytest.raises(BadInput, match=match):
        KERNELS[name].matrix(5, eta)
