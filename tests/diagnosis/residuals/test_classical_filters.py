"""Observer, Kalman filter, parity space and H∞ estimate as post-filters of a residual: blind to the input, and they alarm."""

import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.diagnosis.residuals.generators.approximate_fault_detection import noise_path
from residuum.diagnosis.residuals.generators.classical_filters import CLASSICAL_METHODS
from residuum.diagnosis.residuals.residual_design import ResidualDesign, design_residual
from residuum.diagnosis.residuals.residual_detection import detect
from residuum.diagnosis.systems import h_infinity_norm, left_coprime
from residuum.identification.errors import BadInput, BadModel, NotIdentifiable
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.state_space import StateSpace
from residuum.identification.linear_models.uncertainty import design_uncertainty_weight
from residuum.identification.record import Record


def record(seed, offset=0.0, noise=0.2):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(3000)
    y = lfilter([0, 0.4], [1, -0.8], u) + noise * rng.standard_normal(3000)
    y[1500:] += offset
    return Record({"u": u, "y": y}, {"u": "V", "y": "mm"}, 0.1)


@pytest.fixture(scope="module")
def model():
    return identify_impulse_response(record(1), "u", "y", order=40, offset=False)


@pytest.fixture(scope="module")
def weight(model):
    return design_uncertainty_weight(model, order=2, rule="worst-case").weight


@pytest.fixture(scope="module")
def designs(model, weight):
    return {
        method: design_residual(model, weight, [record(1)], method=method)
        for method in CLASSICAL_METHODS
    }


@pytest.mark.parametrize("method", CLASSICAL_METHODS)
def test_an_offset_is_found_and_a_healthy_record_is_not_blamed(designs, method, tmp_path):
    designs[method].save(tmp_path / "design")
    design = ResidualDesign.load(tmp_path / "design")
    assert design.method == method and detect(design, record(4)).first_alarm is None
    found = detect(design, record(3, offset=3.0))
    assert found.threshold.evaluation == "point" and 1500 <= found.first_alarm < 1600


def test_healthy_records_that_never_fill_the_memory_are_refused(model, weight):
    short = record(1).window(0, 30)
    with pytest.raises(
        NotIdentifiable,
        match=r"remembers \d+ samples, and no healthy record has more .*30 samples.*longer ones",
    ):
        design_residual(model, weight, [short])


@pytest.mark.parametrize("method", CLASSICAL_METHODS)
def test_the_input_does_not_move_the_residual_of_the_model_itself(designs, model, method):
    u = np.random.default_rng(0).standard_normal(500)
    r = designs[method].generator.run(
        u + designs[method].input_mean, model.simulate(u) + designs[method].output_mean
    )
    assert np.abs(r.robust[100:]).max() < 1e-6 * np.abs(designs[method].post_filter.beta)


def test_the_kalman_innovation_is_white_where_the_noise_is_as_assumed(model, weight):
    design = design_residual(model, None, method="kalman")
    e = np.sqrt(model.noise_variance) * np.random.default_rng(1).standard_normal(20_000)
    r = design.post_filter.Q.simulate(e[:, None])[0][100:, 0]
    assert np.std(r) == pytest.approx(1.0, abs=0.03)
    assert abs(np.corrcoef(r[1:], r[:-1])[0, 1]) < 0.03


def test_no_gain_and_no_other_filter_estimates_the_fault_better_than_the_h_infinity_one(
    model, weight, designs
):
    factors = left_coprime(StateSpace.from_transfer_function(model.transfer_function()))
    noise = noise_path(factors, weight)

    def worst(Q):
        omega = np.linspace(0, np.pi / 0.1, 500)
        q, v = Q.frequency_response(omega)[:, 0, 0], (Q @ noise).frequency_response(omega)[:, 0]
        return float(np.sqrt(np.abs(q - 1) ** 2 + (np.abs(v) ** 2).sum(axis=1)).max())

    best = worst(designs["h-infinity"].post_filter.Q)
    others = [StateSpace.gain([[gain]], 0.1) for gain in (0.2, 0.4, 0.45, 0.55, 0.7, 1.0)]
    lags = [
        StateSpace(np.array([[a]]), np.array([[1 - a]]), np.array([[0.5]]), np.zeros((1, 1)), 0.1)
        for a in (0.3, 0.7)
    ]
    assert all(worst(Q) >= best - 1e-9 for Q in [*others, *lags])
    assert h_infinity_norm(designs["h-infinity"].post_filter.Q)[0] < 0.51


def test_what_cannot_be_made_is_refused(model, weight):
    with pytest.raises(BadInput, match="known are robust, observer, kalman, parity, h-infinity"):
        design_residual(model, weight, method="guess")
    with pytest.raises(BadModel, match="is made for sensor faults"):
        design_residual(model, weight, method="h-infinity", fault="actuator")
