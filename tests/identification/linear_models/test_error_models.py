"""Error models in the place of a model's own covariance: the bias of too low an order is covered, and a noise bound counts."""

import numpy as np
import pytest
from scipy.signal import lfilter

from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.linear_models.error_bounds.error_models import (
    ERROR_MODELS,
    laguerre_basis,
    likeliest_embedding,
)
from residuum.identification.linear_models.prediction_error import STRUCTURES, identify
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.linear_models.uncertainty import design_uncertainty_weight
from residuum.identification.record import Record

NUMERATOR, DENOMINATOR = (
    np.array([0.5, 0.3]),
    np.poly([0.85, 0.6 * np.exp(1j), 0.6 * np.exp(-1j)]).real,
)
OMEGA = np.linspace(0.01, np.pi, 400)


def record(seed, bound=0.3):
    rng = np.random.default_rng(seed)
    u = rng.standard_normal(3000)
    y = lfilter(np.r_[0.0, NUMERATOR], DENOMINATOR, u) + rng.uniform(-bound, bound, 3000)
    return Record({"u": u, "y": y}, {"u": "V", "y": "mm"}, 1.0)


@pytest.fixture(scope="module")
def low_order():
    return identify(STRUCTURES["oe"], [record(1)], "u", "y", order=1, offset=False)


def largest_error_over_weight(model):
    weight = design_uncertainty_weight(model, order=2)
    truth = TransferFunction(NUMERATOR, DENOMINATOR, 1.0).frequency_response(OMEGA)
    error = np.abs(truth / model.frequency_response(OMEGA) - 1)
    return float((error / np.abs(weight.weight.frequency_response(OMEGA))).max())


@pytest.mark.parametrize("name", ["model-error", "set-membership"])
def test_the_weight_covers_the_truth_that_the_models_own_covariance_leaves_out(low_order, name):
    assert largest_error_over_weight(low_order) > 3
    trusted = ERROR_MODELS[name](low_order, [record(2)], None)
    assert largest_error_over_weight(trusted) < 1
    assert any(name.split("-")[0] in text for text in trusted.warnings)


def test_stochastic_embedding_knows_of_the_bias_though_its_normal_law_may_fall_short(low_order):
    trusted = ERROR_MODELS["stochastic-embedding"](low_order, [record(2)], None)
    assert largest_error_over_weight(trusted) < 0.5 * largest_error_over_weight(low_order)
    assert any("Laguerre" in text for text in trusted.warnings)


@pytest.mark.parametrize("name", ["model-error", "set-membership"])
def test_the_nominal_model_stays(low_order, name):
    trusted = ERROR_MODELS[name](low_order, [record(2)], None)
    np.testing.assert_allclose(
        trusted.frequency_response(OMEGA), low_order.frequency_response(OMEGA), rtol=1e-3
    )


def test_the_noise_bound_decides_what_is_possible(low_order):
    with pytest.raises(
        NotIdentifiable, match=r"with noise of at most 0.001 mm no error response agrees"
    ):
        ERROR_MODELS["set-membership"](low_order, [record(2)], 1e-3)
    narrow, wide = (
        ERROR_MODELS["set-membership"](low_order, [record(2)], bound) for bound in (1.0, 3.0)
    )
    assert np.trace(wide.covariance) > np.trace(narrow.covariance)
    with pytest.raises(BadInput, match="takes no noise bound"):
        ERROR_MODELS["model-error"](low_order, [record(2)], 0.3)


def test_an_embedding_as_a_method_is_least_squares_on_the_filtered_inputs():
    data = record(3)
    model = likeliest_embedding([data], "u", "y", order=60)
    pole = float(
        next(text for text in model.warnings if "Laguerre" in text).split("pole ")[1].split(";")[0]
    )
    basis = laguerre_basis(pole, 4, 60)
    filtered = np.stack([lfilter(np.r_[0.0, one], [1.0], data["u"]) for one in basis.T], axis=1)[
        60:
    ]
    design = np.column_stack([filtered, np.ones(len(filtered))])
    theta = np.linalg.lstsq(design, data["y"][60:], rcond=None)[0]
    np.testing.assert_allclose(model.impulse_response, basis @ theta[:4], atol=5e-3)
