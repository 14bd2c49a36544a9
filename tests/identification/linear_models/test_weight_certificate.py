from dataclasses import replace

import numpy as np
import pytest

from residuum.identification.linear_models.error_bounds.error_models import DrawnErrors
from residuum.identification.linear_models.error_bounds.magnitude_fit import fit_magnitude
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.linear_models.uncertainty import (
    ABOVE_THE_SEEN,
    design_uncertainty_weight,
    drawn_errors,
    largest_excess,
)
from residuum.robust_control.control_problem import average_plant, overall_uncertainty

TS = 0.05
FINE = np.linspace(1e-4, np.pi / TS, 200_001)
COARSE = np.geomspace(1e-4, np.pi / TS, 60)


def resonant(parametric):
    """A resonance and a deep, narrow notch: an error that is large between any sixty points."""
    num, den = (
        np.poly([0.999 * np.exp(1.3j), 0.999 * np.exp(-1.3j)]).real,
        np.poly([0.9 * np.exp(0.5j), 0.9 * np.exp(-0.5j)]).real,
    )
    g = TransferFunction(num, den, TS).simulate(np.r_[1.0, np.zeros(79)])
    common = {"sample_time": TS, "impulse_response": g, "noise_variance": 0.1, "delay": 0}
    common["covariance"] = 1e-4 * np.diag(0.95 ** np.arange(80))
    if not parametric:
        return IdentifiedModel(method="kernel-tc", **common)
    return IdentifiedModel(
        method="oe", numerator=num, denominator=den, parameter_covariance=1e-6 * np.eye(5), **common
    )


def brute(errors, weight):
    return float(np.max(errors.envelope(FINE) / np.abs(weight.frequency_response(FINE))))


@pytest.mark.parametrize("form", ["multiplicative", "additive", "inverse-multiplicative"])
@pytest.mark.parametrize("parametric", [False, True])
def test_the_bound_holds_and_is_tight_on_two_hundred_thousand_frequencies(form, parametric):
    errors = drawn_errors(resonant(parametric), 20, form=form, seed=4)
    weight = fit_magnitude(COARSE, errors.envelope(COARSE), order=3, sample_time=TS)
    found, worst = largest_excess(errors, weight, COARSE), brute(errors, weight)
    assert found.proven
    assert worst <= found.bound <= max(1.0, worst) * (1 + 3 * ABOVE_THE_SEEN)
    if form == "multiplicative":
        assert worst > 2.0  # the sixty points did not see the notch


@pytest.mark.parametrize("asked", [None, COARSE])
def test_a_certified_weight_is_above_all_its_models_everywhere(asked):
    model = resonant(parametric=False)
    made = design_uncertainty_weight(model, omega=asked, order=2, rule="worst-case", seed=5)
    assert made.certified
    assert brute(drawn_errors(model, made.n_samples, seed=5), made.weight) <= 1.0
    if asked is not None:
        np.testing.assert_array_equal(made.omega, asked)


def test_a_zero_on_the_unit_circle_is_not_called_proven():
    nominal = (np.array([[1.0, -2 * np.cos(1.0), 1.0]]), np.ones((1, 1)))
    errors = DrawnErrors.of((nominal[0] + 0.01, nominal[1]), nominal, TS, "multiplicative")
    found = largest_excess(errors, TransferFunction([1.0], [1.0], TS), COARSE)
    assert not found.proven
    assert found.bound == np.inf


def test_the_weight_of_several_operating_points_is_above_all_of_them_everywhere():
    other = replace(
        resonant(parametric=False),
        impulse_response=1.3 * resonant(parametric=False).impulse_response,
    )
    models = [resonant(parametric=False), other]
    average = average_plant(models)
    weight, largest = overall_uncertainty(models, average, COARSE, n_samples=40, seed=2)
    assert largest.shape == COARSE.shape
    nominal, bound = average.frequency_response(FINE), np.abs(weight.frequency_response(FINE))
    for number, model in enumerate(models):
        drawn = model.sample_frequency_responses(20, FINE, np.random.default_rng([2, number]))
        assert np.all(np.abs(drawn / nominal - 1.0) <= bound)
