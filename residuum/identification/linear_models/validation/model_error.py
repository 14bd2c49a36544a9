"""Model error model: what of the residual the input still explains, with a band; is the model falsified, and where.

ε = y − Ĝ₀u = (G − Ĝ₀) u + v. The impulse response from u to ε is identified by the kernel method, with ε and u filtered by the
autoregression of v so that coloured noise does not shorten the band. Where zero leaves the band, the model is falsified. Ljung,
IFAC Proc. Vol. 32 (1999) 7157–7162; Reinelt, Garulli, Ljung, Automatica 38 (2002) 787–803; (1.125) of the source, which
names the kernel-based form as future work.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.linear_models.autoregression import fit_autoregression, whitened
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.validation.residual_tests import ResidualTest, input_correlation_test
from residuum.identification.record import Record

_DRAWS = 4000
_PASSES = 2


@dataclass(frozen=True, eq=False)
class ModelErrorModel:
    """The error G − Ĝ₀ with its band, and the verdict.

    Attributes
    ----------
    error : IdentifiedModel
        Impulse response from the input to the residual.
    omega : array, shape (k,)
        Frequencies [rad/s].
    response : array, shape (k,)
        Estimated error at ω.
    distance : array, shape (k,)
        How far zero lies from the estimate, in standard deviations (Mahalanobis, of the complex value).
    limit : float
        The distance that no frequency exceeds with probability 1 − level when the band is right (simultaneous band).
    correlation : tuple of ResidualTest
        For every record the test that the residual is free of the input.
    """

    error: IdentifiedModel
    omega: FloatArray
    response: ComplexArray
    distance: FloatArray
    limit: float
    correlation: tuple[ResidualTest, ...]

    @property
    def falsified_at(self) -> FloatArray:
        """The frequencies [rad/s] at which zero is outside the band."""
        return self.omega[self.distance > self.limit]

    @property
    def falsified(self) -> bool:
        """Whether zero leaves the band anywhere."""
        return bool(len(self.falsified_at))

    @property
    def magnitude_bound(self) -> FloatArray:
        """|error| plus the half width of its band, shape (k,): additive uncertainty that covers bias and variance."""
        largest = np.linalg.eigvalsh(self.error.frequency_covariance(self.omega))[:, 1]
        return np.asarray(np.abs(self.response) + self.limit * np.sqrt(np.maximum(largest, 0.0)))


def model_error_model(
    model: IdentifiedModel,
    records: Record | Sequence[Record],
    *,
    order: int | None = None,
    kernel: str = "tc",
    omega: npt.ArrayLike | None = None,
    level: float = 0.01,
    seed: int = 0,
) -> ModelErrorModel:
    """Identify the error of `model` on records that it was not estimated from.

    Parameters
    ----------
    model : IdentifiedModel
        Names the channels of input and output.
    records : Record or sequence of Record
    order : int or None
        Length of the error's impulse response; None: that of the model, at most a quarter of the samples.
    kernel : str
        Prior of the error.
    omega : array or None
        Frequencies [rad/s]; None: 200, log-spaced over three decades below π/Ts.
    level : float
        Probability that a true model is called falsified somewhere (the band is simultaneous over `omega`).
    seed : int
        Of the draws that give the simultaneous band.

    Raises
    ------
    BadInput
        What `identify_impulse_response` raises.

    Notes
    -----
    A prior that is zero in the mean shrinks errors that the data hardly show; such errors are not falsified. On the estimation
    data a kernel model's own error is invisible, hence the records should be new.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(1000)
    >>> y = np.convolve(u, [0.0, 1.0, 0.5])[:1000] + 0.1 * rng.standard_normal(1000)
    >>> wrong = IdentifiedModel(method="by hand", sample_time=1.0, impulse_response=[1.0], covariance=[[0.0]], noise_variance=0.0)
    >>> model_error_model(wrong, Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0), order=20).falsified
    True
    """
    if not 0 < level < 1:
        raise BadInput(f"model error model, level: is {level}; must lie between 0 and 1")
    experiments = [records] if isinstance(records, Record) else list(records)
    residuals = [residual_record(model, record) for record in experiments]
    shortest = min(record.n for record in residuals)
    order = min(model.order, shortest // 4) if order is None else order
    error = _whitened_fit(model, residuals, order, kernel)
    nyquist = np.pi / model.sample_time
    frequencies = np.geomspace(nyquist / 1e3, nyquist, 200) if omega is None else np.asarray(omega, dtype=float)
    response, covariance = error.frequency_response(frequencies), error.frequency_covariance(frequencies)
    lags = min(25, shortest // 10)
    return ModelErrorModel(
        error,
        frequencies,
        response,
        _distance(response, covariance),
        _simultaneous_limit(error, frequencies, covariance, level, seed),
        tuple(
            input_correlation_test(
                record[model.output_name], record[model.input_name], lags=lags, first_lag=model.delay, level=level
            )
            for record in residuals
        ),
    )


def residual_record(model: IdentifiedModel, record: Record) -> Record:
    """The record with the output replaced by y − ŷ; NaN where the past input is not known."""
    u, y = np.asarray(record[model.input_name], dtype=float), np.asarray(record[model.output_name], dtype=float)
    known = np.concatenate([np.zeros(model.delay + model.order - 1, dtype=bool), ~np.isnan(u)])
    whole_past = np.lib.stride_tricks.sliding_window_view(known, model.delay + model.order).all(axis=1)
    residual = np.where(whole_past, y - model.simulate(np.where(np.isnan(u), 0.0, u)), np.nan)
    return replace(
        record,
        channels={model.input_name: u, model.output_name: residual},
        units={name: record.units[name] for name in (model.input_name, model.output_name)},
    )


def _whitened_fit(model: IdentifiedModel, residuals: Sequence[Record], order: int, kernel: str) -> IdentifiedModel:
    """The impulse response from input to residual; the noise filter comes from what the fit before left over."""
    remainders, channels = residuals, (model.input_name, model.output_name)
    for _ in range(_PASSES):
        A = _joint_autoregression([record[model.output_name] for record in remainders])
        filtered = [replace(record, channels={name: whitened(record[name], A) for name in channels}) for record in residuals]
        error = identify_impulse_response(filtered, *channels, kernel=kernel, order=order, delay=model.delay, cover_cut=False)
        remainders = [residual_record(error, record) for record in residuals]
    return error


def _joint_autoregression(residuals: Sequence[npt.NDArray[np.floating]]) -> FloatArray:
    """The autoregression of the longest record's residual; all share one noise colour."""
    return fit_autoregression(max(residuals, key=len))[0]


def _distance(response: ComplexArray, covariance: FloatArray) -> FloatArray:
    """√(vᵀ C⁻¹ v) with v = (Re, Im) of `response`, shape (…, k), and C of every frequency, shape (k, 2, 2)."""
    # A frequency of 0 or π/Ts has no imaginary part: the pseudo-inverse leaves that direction out.
    inverse = np.linalg.pinv(covariance, rcond=1e-12, hermitian=True)
    real, imaginary = response.real, response.imag
    squared = inverse[:, 0, 0] * real**2 + 2 * inverse[:, 0, 1] * real * imaginary + inverse[:, 1, 1] * imaginary**2
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def _simultaneous_limit(error: IdentifiedModel, omega: FloatArray, covariance: FloatArray, level: float, seed: int) -> float:
    """The 1 − level quantile of the largest distance over ω between a random error and the estimate."""
    drawn = error.sample_frequency_responses(_DRAWS, omega, seed) - error.frequency_response(omega)
    return float(np.quantile(_distance(drawn, covariance).max(axis=1), 1 - level))
