"""The confidence ellipsoid of the parameters, (1.107) of the source."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from scipy import stats

from residuum.identification.errors import BadInput
from residuum.identification.linear_models.identified_model import IdentifiedModel

_NEGLIGIBLE = 1e-12


def in_confidence_ellipsoid(model: IdentifiedModel, theta: npt.ArrayLike, probability: float = 0.95) -> bool:
    """Whether parameters lie in the region that holds the true ones with `probability`.

    C = {θ : (θ − θ̂)ᵀ P⁻¹ (θ − θ̂) ≤ χ²_p(probability)},  p the rank of P = cov θ̂      — (1.107) of the source

    Parameters
    ----------
    model : IdentifiedModel
        With a parameter covariance.
    theta : array, shape (p,)
        `[*numerator, *denominator[1:]]` in descending powers of z. Coefficients that were not estimated (zero variance) must
        be equal to the model's.
    probability : float
        Between 0 and 1.

    Raises
    ------
    BadInput
        A model without parameters, a vector of another length, a probability outside (0, 1).

    Notes
    -----
    First order in 1/n: where a pole nearly cancels a zero, or the record is short, the region is no ellipsoid, and this one
    covers the truth less often than it says.

    >>> model = IdentifiedModel(method="by hand", sample_time=1.0, impulse_response=[0.6], covariance=[[0.01]],
    ...                         noise_variance=0.1, numerator=[0.6], denominator=[1.0, 0.4],
    ...                         parameter_covariance=[[0.01, 0], [0, 0.04]])
    >>> in_confidence_ellipsoid(model, [0.8, 0.4]), in_confidence_ellipsoid(model, [0.9, 0.4])
    (True, False)
    """
    if model.numerator is None or model.denominator is None or model.parameter_covariance is None:
        raise BadInput(f"confidence ellipsoid: model {model.method!r} has no parameters with a covariance")
    if not 0 < probability < 1:
        raise BadInput(f"confidence ellipsoid: probability is {probability}; must lie between 0 and 1")
    estimate, given = np.concatenate([model.numerator, model.denominator[1:]]), np.asarray(theta, dtype=float)
    if given.shape != estimate.shape:
        raise BadInput(f"confidence ellipsoid: theta has shape {given.shape}; must be {estimate.shape}")
    std = np.sqrt(np.diag(model.parameter_covariance))
    estimated = std > 0.0
    if np.any(given[~estimated] != estimate[~estimated]):
        return False
    scale = std[estimated]
    eigenvalues, axes = np.linalg.eigh(model.parameter_covariance[np.ix_(estimated, estimated)] / np.outer(scale, scale))
    along = axes.T @ ((given - estimate)[estimated] / scale)
    free = eigenvalues > _NEGLIGIBLE * eigenvalues.max(initial=0.0)
    if np.any(np.abs(along[~free]) > np.sqrt(_NEGLIGIBLE)):
        return False
    return bool(np.sum(along[free] ** 2 / eigenvalues[free]) <= stats.chi2.ppf(probability, df=max(int(free.sum()), 1)))
