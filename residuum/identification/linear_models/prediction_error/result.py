"""From polynomials and their covariance to an IdentifiedModel in the record's units."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy import stats

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.prediction_error.criterion import (
    Orders,
    Polynomials,
    filtered,
)
from residuum.identification.linear_models.prediction_error.data import Signals
from residuum.identification.linear_models.prediction_error.starts import Structure
from residuum.identification.record import Record

# The confidence ellipsoid of the parameters, (1.107) of the source.

_NEGLIGIBLE_EIGENVALUE = 1e-12


def in_confidence_ellipsoid(
    model: IdentifiedModel, theta: npt.ArrayLike, probability: float = 0.95
) -> bool:
    """Whether parameters lie in the region that holds the true ones with `probability`.

    C = {θ : (θ − θ̂)ᵀ P⁻¹ (θ − θ̂) ≤ χ²_p(probability)},  p the rank of P = cov θ̂      — (1.107) of the source

    Parameters
    ----------
    model : IdentifiedModel
        With a parameter covariance.
    theta : array, shape (p,)
        `[*numerator, *denominator[1:]]` in descending powers of z. Coefficients that were not
        estimated (zero variance) must be equal to the model's.
    probability : float
        Between 0 and 1.

    Raises
    ------
    BadInput
        A model without parameters, a vector of another length, a probability outside (0, 1).

    Notes
    -----
    First order in 1/n: where a pole nearly cancels a zero, or the record is short, the region is no
    ellipsoid, and this one covers the truth less often than it says.

    >>> model = IdentifiedModel(method="by hand", sample_time=1.0, impulse_response=[0.6], covariance=[[0.01]],
    ...                         noise_variance=0.1, numerator=[0.6], denominator=[1.0, 0.4],
    ...                         parameter_covariance=[[0.01, 0], [0, 0.04]])
    >>> in_confidence_ellipsoid(model, [0.8, 0.4]), in_confidence_ellipsoid(model, [0.9, 0.4])
    (True, False)
    """
    if model.numerator is None or model.denominator is None or model.parameter_covariance is None:
        raise BadInput(
            f"confidence ellipsoid: model {model.method!r} has no parameters with a covariance"
        )
    if not 0 < probability < 1:
        raise BadInput(
            f"confidence ellipsoid: probability is {probability}; must lie between 0 and 1"
        )
    estimate, given = (
        np.concatenate([model.numerator, model.denominator[1:]]),
        np.asarray(theta, dtype=float),
    )
    if given.shape != estimate.shape:
        raise BadInput(
            f"confidence ellipsoid: theta has shape {given.shape}; must be {estimate.shape}"
        )
    std = np.sqrt(np.diag(model.parameter_covariance))
    estimated = std > 0.0
    if np.any(given[~estimated] != estimate[~estimated]):
        return False
    scale = std[estimated]
    eigenvalues, axes = np.linalg.eigh(
        model.parameter_covariance[np.ix_(estimated, estimated)] / np.outer(scale, scale)
    )
    along = axes.T @ ((given - estimate)[estimated] / scale)
    free = eigenvalues > _NEGLIGIBLE_EIGENVALUE * eigenvalues.max(initial=0.0)
    if np.any(np.abs(along[~free]) > np.sqrt(_NEGLIGIBLE_EIGENVALUE)):
        return False
    return bool(
        np.sum(along[free] ** 2 / eigenvalues[free])
        <= stats.chi2.ppf(probability, df=max(int(free.sum()), 1))
    )


_LONGEST_RESPONSE = 400
_NEGLIGIBLE = 1e-4


def identified_model(
    polynomials: Polynomials,
    covariance: FloatArray,
    innovation_variance: float,
    level: float,
    data: Signals,
    described: Mapping[str, Any],
) -> IdentifiedModel:
    """The result of a prediction error method, unscaled.

    Parameters
    ----------
    covariance : array, shape (count, count)
        Of θ, (1.104) of the source.
    innovation_variance, level : float
        In scaled units.
    described : mapping
        What else IdentifiedModel takes (names, units, likelihood, criteria, warnings, provenance).
    """
    gain = data.y_scale / data.u_scale
    num, den, jacobian = _plant(polynomials)
    scale = np.r_[np.full(len(num), gain), np.ones(len(den) - 1)]
    root = _square_root(covariance)
    along = scale[:, None] * (jacobian @ root)
    g, dg = _impulse_response(polynomials)
    dg = gain * (dg @ root)
    noise_num, noise_den = _noise(polynomials)
    return IdentifiedModel(
        impulse_response=g * gain,
        covariance=dg @ dg.T,
        noise_variance=innovation_variance * data.y_scale**2,
        delay=polynomials.orders.delay,
        offset=data.y_level
        + level * data.y_scale
        - float(num.sum() / den.sum()) * gain * data.u_level,
        numerator=num * gain,
        denominator=den,
        parameter_covariance=along @ along.T,
        noise_numerator=noise_num,
        noise_denominator=noise_den,
        **described,
    )


def description(
    structure: Structure,
    records: Sequence[Record],
    input: str | None,
    output: str,
    orders: Orders,
    n: int,
) -> dict[str, Any]:
    """Names, units and provenance of a result, as IdentifiedModel takes them; `n` is the number of
    samples used.
    """
    driven = input if structure.has_input and input else ""
    return {
        "method": structure.name,
        "sample_time": records[0].sample_time,
        "input_name": driven,
        "input_unit": records[0].units[driven] if driven else "",
        "output_name": output,
        "output_unit": records[0].units[output],
        "provenance": {
            "records": [record.source for record in records],
            "n": n,
            "structure": structure.equation,
            "orders": str(orders),
        },
    }


def _square_root(covariance: FloatArray) -> FloatArray:
    """B with B Bᵀ = Σ: J B (J B)ᵀ stays a covariance where J Σ Jᵀ, of badly known parameters, loses
    its symmetry to rounding.

    Parameters of unequal size are brought to unit variance first; those that were not estimated
    keep rows of zeros.
    """
    std = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    size = np.where(std > 0, std, 1.0)
    eigenvalues, vectors = np.linalg.eigh(0.5 * (covariance + covariance.T) / np.outer(size, size))
    return np.asarray(std[:, None] * vectors * np.sqrt(np.maximum(eigenvalues, 0.0)))


def _plant(p: Polynomials) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(numerator, denominator, ∂[numerator, denominator₁…]/∂θ) of z^{−n_k} B/(A F) in descending
    powers of z.
    """
    o = p.orders
    den = np.convolve(p.a, p.f)
    b = p.b if o.nb else np.zeros(1)
    size = max(len(den) - 1, o.delay + len(b) - 1)
    num = np.concatenate([b, np.zeros(size - o.delay - len(b) + 1)])
    den = np.concatenate([den, np.zeros(size + 1 - len(den))])
    jacobian = np.zeros((len(num) + size, o.count))
    for k in range(o.nb):
        jacobian[k, o.na + k] = 1.0
    for first, count, factor in ((0, o.na, p.f), (o.na + o.nb, o.nf, p.a)):
        for k in range(count):
            at = len(num) + k
            jacobian[at : at + len(factor), first + k] += factor[: len(jacobian) - at]
    return num, den, jacobian


def _impulse_response(p: Polynomials) -> tuple[FloatArray, FloatArray]:
    """g from lag n_k on until it has decayed (at most 400 coefficients), and ∂g/∂θ, shape (m,
    count).
    """
    o = p.orders
    pulse = np.r_[1.0, np.zeros(_LONGEST_RESPONSE - 1)]
    b = p.b if o.nb else np.zeros(1)
    den = np.convolve(p.a, p.f)
    g = np.asarray(filtered(b, den, pulse))
    significant = np.flatnonzero(np.abs(g) > _NEGLIGIBLE * np.abs(g).max(initial=0.0))
    m = int(max(significant[-1] + 1 if significant.size else 1, o.nb, 1))
    dg = np.zeros((_LONGEST_RESPONSE, o.count))
    by_b = np.asarray(filtered([1.0], den, pulse))
    for first, count, signal, lag in (
        (0, o.na, -filtered([1.0], p.a, g), 1),
        (o.na, o.nb, by_b, 0),
        (o.na + o.nb, o.nf, -filtered([1.0], p.f, g), 1),
    ):
        for k in range(count):
            dg[lag + k :, first + k] = signal[: _LONGEST_RESPONSE - lag - k]
    return g[:m], dg[:m]


def _noise(p: Polynomials) -> tuple[FloatArray | None, FloatArray | None]:
    """H = C/(D A) in descending powers of z, both polynomials of equal length; (None, None) for
    white noise.
    """
    den = np.convolve(p.d, p.a)
    size = max(len(p.c), len(den))
    if size == 1:
        return None, None
    return np.r_[p.c, np.zeros(size - len(p.c))], np.r_[den, np.zeros(size - len(den))]
