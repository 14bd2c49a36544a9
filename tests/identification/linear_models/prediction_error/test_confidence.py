"""The ellipsoid (1.107): its boundary by an independent form, coefficients that were not estimated, refusals."""

import numpy as np
import pytest
from scipy.stats import chi2

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.prediction_error import in_confidence_ellipsoid


def model(covariance, numerator=(0.5, 0.2), denominator=(1.0, -0.7)):
    return IdentifiedModel(
        method="by hand",
        sample_time=1.0,
        impulse_response=[0.5],
        covariance=[[0.01]],
        noise_variance=1.0,
        numerator=numerator,
        denominator=denominator,
        parameter_covariance=covariance,
    )


@pytest.mark.parametrize("probability", [0.5, 0.95, 0.999])
def test_boundary_is_at_the_quantile_in_every_direction(probability):
    rng = np.random.default_rng(0)
    root = rng.normal(size=(3, 3)) * [[1e-3], [1.0], [10.0]]
    estimated, theta = model(root @ root.T), np.array([0.5, 0.2, -0.7])
    for direction in rng.normal(size=(20, 3)):
        edge = root @ direction / np.linalg.norm(direction) * np.sqrt(chi2.ppf(probability, df=3))
        assert in_confidence_ellipsoid(estimated, theta + 0.999 * edge, probability)
        assert not in_confidence_ellipsoid(estimated, theta + 1.001 * edge, probability)


def test_coefficients_that_were_not_estimated_take_no_degree_of_freedom():
    estimated = model(np.diag([0.01, 0.0, 0.0]))
    assert in_confidence_ellipsoid(estimated, [0.5 + 0.195, 0.2, -0.7])
    assert not in_confidence_ellipsoid(estimated, [0.5 + 0.197, 0.2, -0.7])
    assert not in_confidence_ellipsoid(estimated, [0.5, 0.2 + 1e-6, -0.7])


def test_dependent_coefficients_must_stay_on_their_line():
    estimated = model(np.outer([1.0, 2.0, 0.0], [1.0, 2.0, 0.0]))
    assert in_confidence_ellipsoid(estimated, [0.5 + 1.9, 0.2 + 3.8, -0.7])
    assert not in_confidence_ellipsoid(estimated, [0.5 + 2.0, 0.2 + 4.0, -0.7])
    assert not in_confidence_ellipsoid(estimated, [0.5 + 0.1, 0.2, -0.7])


@pytest.mark.parametrize(
    ("arguments", "rule"),
    [
        ((model(np.eye(3)), [0.5, 0.2]), r"theta has shape \(2,\); must be \(3,\)"),
        ((model(np.eye(3)), [0.5, 0.2, -0.7], 1.0), "probability is 1.0"),
        ((model(None), [0.5, 0.2, -0.7]), "no parameters with a covariance"),
    ],
)
def test_refusals(arguments, rule):
    with pytest.raises(BadInput, match=rule):
        in_confidence_ellipsoid(*arguments)
