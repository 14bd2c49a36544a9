"""What data say against an identified model: residual tests, the model of its error, the error on
new data.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import numpy.typing as npt
from scipy import linalg, signal, stats

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.errors import BadInput, BadRecord, NotIdentifiable
from residuum.identification.kernel_based.gram import regression_sums
from residuum.identification.kernel_based.impulse_response import identify_impulse_response
from residuum.identification.kernel_based.lagged_data import past_at_rest
from residuum.identification.linear_models.autoregression import (
    autocovariance,
    fit_autoregression,
    whitened,
)
from residuum.identification.linear_models.excitation import excitation_order
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.integrating import from_straight_line
from residuum.identification.record import Record

# How well a model simulates a record.


def simulation_fit(model: IdentifiedModel, record: Record) -> float:
    """100 (1 − ‖y − ŷ‖/‖y − mean y‖) [%] of the simulation, over the samples whose whole past input
    is in the record.

    The level of ŷ is the one that fits best, since a constant offset belongs to the record, not to
    the model; of a model that integrates its straight line too, since the input at which the plant
    stands still does.

    Raises BadRecord when no sample has its whole past, or the output does not move.

    >>> model = IdentifiedModel(method="by hand", sample_time=1.0, impulse_response=[2.0], covariance=[[0.0]], noise_variance=0.0)
    >>> simulation_fit(model, Record({"u": [1.0, 0.0, 1.0, 0.0], "y": [5.0, 7.0, 5.0, 7.0]}, {"u": "", "y": ""}, 1.0))
    100.0
    """
    y, residual = simulated_beside(model, record)
    return float(100 * (1 - np.nanstd(residual) / np.nanstd(y)))


def simulated_beside(
    model: IdentifiedModel, record: Record, first: int = 0
) -> tuple[FloatArray, FloatArray]:
    """y and y − ŷ from sample `first` on, shape (n − first,); NaN where the input's past is not
    whole.

    A past at rest is whole (`past_at_rest`). A model that is not stable shows its one-step
    predictions: its simulation tells of rounding alone.

    Raises BadRecord as `simulation_fit` does.
    """
    u, y = (
        np.asarray(record[model.input_name], dtype=float),
        np.asarray(record[model.output_name], dtype=float),
    )
    reach = model.delay + model.order - 1
    at_rest = past_at_rest([u], reach) > 0
    known = np.concatenate([np.full(reach, at_rest), ~np.isnan(u)])
    complete = np.lib.stride_tricks.sliding_window_view(known, reach + 1).all(axis=1) & ~np.isnan(y)
    level = (
        float(np.nanmean(u))
        if model.integrates and known.any()
        else float(u[0])
        if at_rest
        else 0.0
    )
    if model.diverges:
        residual = np.where(
            complete, y - _predicted(model, u, y, record.source or "record"), np.nan
        )[first:]
    else:
        residual = np.where(
            complete, y - model.simulate(np.where(np.isnan(u), 0.0, u - level)), np.nan
        )[first:]
    shown = np.where(complete, y, np.nan)[first:]
    if model.integrates:
        residual = from_straight_line(residual)
    spread = float(np.nanstd(shown)) if np.isfinite(shown).any() else 0.0
    if not spread > 0:
        where = record.source or "record"
        raise BadRecord(
            f"{where}: cannot be validated on: too few output samples have {reach} samples of input"
            " before them, or the output is constant"
        )
    return shown, residual


def _predicted(model: IdentifiedModel, u: FloatArray, y: FloatArray, where: str) -> FloatArray:
    if not (np.isfinite(u).all() and np.isfinite(y).all()):
        raise BadRecord(
            f"{where}: a model that is not stable is judged by its predictions, which need every"
            " sample"
        )
    return model.predict(u, y)


# Residual tests: is the residual white, and is it free of the input, with the colour of the noise
# accounted for?


@dataclass(frozen=True, eq=False)
class ResidualTest:
    """Correlations with the band that a good model keeps them in, and the joint test of all lags.

    Attributes
    ----------
    lags, correlation : array, shape (k,)
    band : float
        Half width of the two-sided band of a single correlation at the level of the test.
    statistic, degrees_of_freedom, p_value : float, int, float
        χ² statistic of all lags together.
    level : float
        False-alarm rate of the joint test.
    noise_order : int
        Order of the autoregression that whitened the residual (0 = none).
    """

    lags: npt.NDArray[np.int_]
    correlation: FloatArray
    band: float
    statistic: float
    degrees_of_freedom: int
    p_value: float
    level: float
    noise_order: int

    @property
    def passed(self) -> bool:
        """Whether the joint test finds nothing."""
        return self.p_value >= self.level


def whiteness_test(
    residual: npt.ArrayLike, *, lags: int = 25, n_parameters: int = 0, level: float = 0.01
) -> ResidualTest:
    """Ljung–Box test: Q = n(n+2) Σ r_k²/(n−k) is χ² with `lags` − `n_parameters` degrees of freedom
    if the residual is white.

    A prediction error should pass; a simulation error need not (output noise may be coloured).

    Ljung, Box, Biometrika 65 (1978) 297–303. Missing samples are skipped, which keeps the test
    slightly conservative.

    Parameters
    ----------
    residual : array, shape (n,)
    lags : int
    n_parameters : int
        Parameters of a noise model that were estimated from the same data.
    level : float

    >>> whiteness_test(np.random.default_rng(0).standard_normal(500)).passed
    True
    """
    _check(lags, level)
    if lags <= n_parameters:
        raise BadInput(
            f"whiteness test: {lags} lags must exceed the {n_parameters} estimated parameters"
        )
    covariance = autocovariance(residual, lags)
    if not covariance[0] > 0:
        raise NotIdentifiable("whiteness test: the residual is constant")
    n = int(np.count_nonzero(~np.isnan(np.asarray(residual, dtype=float))))
    correlation, k = covariance[1:] / covariance[0], np.arange(1, lags + 1)
    statistic = float(n * (n + 2) * np.sum(correlation**2 / (n - k)))
    band = float(stats.norm.isf(level / 2)) / math.sqrt(n)
    freedom = lags - n_parameters
    return ResidualTest(
        k, correlation, band, statistic, freedom, float(stats.chi2.sf(statistic, freedom)), level, 0
    )


def input_correlation_test(
    residual: npt.ArrayLike,
    input: npt.ArrayLike,
    *,
    lags: int = 25,
    first_lag: int = 0,
    level: float = 0.01,
    coloured: bool = True,
) -> ResidualTest:
    """Does the residual still contain the input? Regression of ε on u(t − first_lag) … u(t −
    first_lag − lags + 1).

    With coloured noise the correlations of ε and u scatter more than 1/√n, and a test that ignores
    it rejects good models. Both signals are therefore filtered with A(q), the autoregression of ε,
    which leaves their relation unchanged and the noise white: the explained sum of squares over σ²
    is then χ² in the rank of the input's Gram matrix, whatever the colour of the input. Söderström,
    Stoica, System Identification (1989), section 11.2.

    Fails (reports too small a p-value) when parameters were fitted to the same data with more
    freedom than n can bear; use validation data then.

    Parameters
    ----------
    residual, input : array, shape (n,)
        NaN = missing; rows that touch one are left out.
    lags, first_lag : int
        A negative first_lag also looks for feedback from ε to u.
    level : float
    coloured : bool
        False: the noise is taken to be white.

    >>> rng = np.random.default_rng(0)
    >>> u, e = rng.standard_normal((2, 1000))
    >>> input_correlation_test(e, u).passed, input_correlation_test(e + 0.3 * u, u).passed
    (True, False)
    """
    _check(lags, level)
    residual, u = np.asarray(residual, dtype=float), np.asarray(input, dtype=float)
    A = fit_autoregression(residual)[0] if coloured else np.ones(1)
    residual, u = whitened(residual, A), whitened(u, A)
    if first_lag < 0:
        u, residual, delay = u[-first_lag:], residual[:first_lag], 0
    else:
        delay = first_lag
    sums = regression_sums([u], residual, lags, delay).centred()
    if sums.degrees_of_freedom <= 2 * lags:
        raise NotIdentifiable(
            f"input correlation test: {sums.rows} complete rows for {lags} lags; needs more than"
            " twice as many"
        )
    eigenvalues, vectors = linalg.eigh(sums.gram)
    rank = excitation_order(sums.gram)
    projected = (vectors.T @ sums.cross)[len(eigenvalues) - rank :]
    explained = (
        float(np.sum(projected**2 / eigenvalues[len(eigenvalues) - rank :]))
        if eigenvalues[-1] > 0
        else 0.0
    )
    freedom = sums.degrees_of_freedom - rank
    statistic = explained / max((sums.energy - explained) / freedom, np.finfo(float).tiny)
    correlation = sums.cross / np.sqrt(
        np.maximum(np.diag(sums.gram) * sums.energy, np.finfo(float).tiny)
    )
    band = float(stats.norm.isf(level / 2)) / math.sqrt(sums.degrees_of_freedom)
    p_value = float(stats.f.sf(statistic / rank, rank, freedom)) if rank else 1.0
    return ResidualTest(
        first_lag + np.arange(lags), correlation, band, statistic, rank, p_value, level, len(A) - 1
    )


def _check(lags: int, level: float) -> None:
    if lags < 1 or not 0 < level < 1:
        raise BadInput(
            f"residual test: {lags} lags and level {level}; needs lags ≥ 1 and a level between 0"
            " and 1"
        )


# Model error model: what of the residual the input still explains, with a band; is the model
# falsified, and where.
# ε = y − Ĝ₀u = (G − Ĝ₀) u + v. The impulse response from u to ε is identified by the kernel
# method, with ε and u filtered by the autoregression of v so that coloured noise does not shorten
# the band. Where zero leaves the band, the model is falsified. Ljung, IFAC Proc. Vol. 32 (1999)
# 7157–7162; Reinelt, Garulli, Ljung, Automatica 38 (2002) 787–803; (1.125) of the source, which
# names the kernel-based form as future work.

_DRAWS = 4000  # random models that a quantile is taken of
_PASSES = 2  # of whitening: the second by the colour of what the first fit leaves


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
        How far zero lies from the estimate, in standard deviations (Mahalanobis, of the complex
        value).
    limit : float
        The distance that no frequency exceeds with probability 1 − level when the band is right
        (simultaneous band).
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
        """|error| plus the half width of its band, shape (k,): additive uncertainty that covers
        bias and variance.
        """
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
        Length of the error's impulse response; None: that of the model, at most a quarter of the
        samples.
    kernel : str
        Prior of the error.
    omega : array or None
        Frequencies [rad/s]; None: 200, log-spaced over three decades below π/Ts.
    level : float
        Probability that a true model is called falsified somewhere (the band is simultaneous over
        `omega`).
    seed : int
        Of the draws that give the simultaneous band.

    Raises
    ------
    BadInput
        What `identify_impulse_response` raises.

    Notes
    -----
    A prior that is zero in the mean shrinks errors that the data hardly show; such errors are not
    falsified. On the estimation data a kernel model's own error is invisible, hence the records
    should be new.

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
    frequencies = (
        np.geomspace(nyquist / 1e3, nyquist, 200)
        if omega is None
        else np.asarray(omega, dtype=float)
    )
    response, covariance = (
        error.frequency_response(frequencies),
        error.frequency_covariance(frequencies),
    )
    lags = min(25, shortest // 10)
    return ModelErrorModel(
        error,
        frequencies,
        response,
        _distance(response, covariance),
        _simultaneous_limit(error, frequencies, covariance, level, seed),
        tuple(
            input_correlation_test(
                record[model.output_name],
                record[model.input_name],
                lags=lags,
                first_lag=model.delay,
                level=level,
            )
            for record in residuals
        ),
    )


def residual_record(model: IdentifiedModel, record: Record) -> Record:
    """The record with the output replaced by y − ŷ; NaN where the past input is not known."""
    u, y = (
        np.asarray(record[model.input_name], dtype=float),
        np.asarray(record[model.output_name], dtype=float),
    )
    known = np.concatenate([np.zeros(model.delay + model.order - 1, dtype=bool), ~np.isnan(u)])
    whole_past = np.lib.stride_tricks.sliding_window_view(known, model.delay + model.order).all(
        axis=1
    )
    residual = np.where(whole_past, y - model.simulate(np.where(np.isnan(u), 0.0, u)), np.nan)
    return replace(
        record,
        channels={model.input_name: u, model.output_name: residual},
        units={name: record.units[name] for name in (model.input_name, model.output_name)},
    )


def _whitened_fit(
    model: IdentifiedModel, residuals: Sequence[Record], order: int, kernel: str
) -> IdentifiedModel:
    """The impulse response from input to residual; the noise filter comes from what the fit before
    left over.
    """
    remainders, channels = residuals, (model.input_name, model.output_name)
    for _ in range(_PASSES):
        A = _joint_autoregression([record[model.output_name] for record in remainders])
        filtered = [
            replace(record, channels={name: whitened(record[name], A) for name in channels})
            for record in residuals
        ]
        error = identify_impulse_response(
            filtered, *channels, kernel=kernel, order=order, delay=model.delay, cover_cut=False
        )
        remainders = [residual_record(error, record) for record in residuals]
    return error


def _joint_autoregression(residuals: Sequence[npt.NDArray[np.floating]]) -> FloatArray:
    """The autoregression of the longest record's residual; all share one noise colour."""
    return fit_autoregression(max(residuals, key=len))[0]


def _distance(response: ComplexArray, covariance: FloatArray) -> FloatArray:
    """√(vᵀ C⁻¹ v) with v = (Re, Im) of `response`, shape (…, k), and C of every frequency, shape
    (k, 2, 2).
    """
    # A frequency of 0 or π/Ts has no imaginary part: the pseudo-inverse leaves that direction out.
    inverse = np.linalg.pinv(covariance, rcond=1e-12, hermitian=True)
    real, imaginary = response.real, response.imag
    squared = (
        inverse[:, 0, 0] * real**2
        + 2 * inverse[:, 0, 1] * real * imaginary
        + inverse[:, 1, 1] * imaginary**2
    )
    return np.asarray(np.sqrt(np.maximum(squared, 0.0)))


def _simultaneous_limit(
    error: IdentifiedModel, omega: FloatArray, covariance: FloatArray, level: float, seed: int
) -> float:
    """The 1 − level quantile of the largest distance over ω between a random error and the
    estimate.
    """
    drawn = error.sample_frequency_responses(_DRAWS, omega, seed) - error.frequency_response(omega)
    return float(np.quantile(_distance(drawn, covariance).max(axis=1), 1 - level))


# What the residuals of a model say against it: are they white, are they free of the input, where
# does the input explain more.
# Prediction errors ε = H⁻¹ (y − G u) of a method with a noise model, simulation errors y − G u of
# the others. Three questions with their levels: whiteness (Ljung–Box; only a noise model claims
# it), cross-correlation with past inputs, and the kernel model error model of (1.125), whose
# simultaneous band says at which frequencies the model is falsified.
# Assumes data that the model was not estimated from: on its own data a model with many
# coefficients looks better than it is, and the levels do not hold. Fails to see what the input
# does not excite, and takes a drift for a lack of whiteness.

LEVEL = 0.01
"""Share of right models that one of the tests speaks against."""
_LAGS, _SAMPLES_A_LAG = 25, 10  # lags at most, and samples for each at least
_MOST_OF_A_RESPONSE, _BEYOND = 50, 10  # lags of the input: those of the model, and behind them
_SETTLED = 1e-3  # of its beginning, to which a response has decayed


@dataclass(frozen=True, eq=False)
class ResidualCheck:
    """The tests of one part; None where it is too short for a test, or the model has no answer to
    it.

    Attributes
    ----------
    whiteness : ResidualTest or None
        None as well for a method without a noise model, whose residuals need not be white.
    input : ResidualTest or None
        Cross-correlation with past inputs.
    model_error : ModelErrorModel or None
        None as well for a model that integrates.
    samples : int
        Residuals that were tested.
    """

    whiteness: ResidualTest | None
    input: ResidualTest | None
    model_error: ModelErrorModel | None
    samples: int

    @property
    def passed(self) -> bool:
        """Whether no test speaks against the model."""
        tests = [test for test in (self.whiteness, self.input) if test is not None]
        return all(test.passed for test in tests) and not (
            self.model_error is not None and self.model_error.falsified
        )


def residual_check(
    model: IdentifiedModel, record: Record, first: int = 0, level: float = LEVEL
) -> ResidualCheck:
    """Test a model on the samples of `record` from `first` on; those before only give the input its
    past.

    Raises
    ------
    BadInput
        A level outside (0, 1).
    BadRecord
        No sample has its whole past in the record, or the output does not move.
    """
    if not 0 < level < 1:
        raise BadInput(f"residual check, level: is {level}; must lie between 0 and 1")
    e = prediction_errors(model, record)[first:]
    u = np.asarray(record[model.input_name], dtype=float)[first:]
    n = int(np.isfinite(e).sum())
    longest = max(2, n // _SAMPLES_A_LAG)
    lags = min(_LAGS, longest)
    # an input that a cut response leaves out acts behind it
    reached = model.delay + min(model.order, _MOST_OF_A_RESPONSE) + _BEYOND
    white: ResidualTest | None
    free: ResidualTest | None
    wrong: ModelErrorModel | None
    try:
        white = (
            whiteness_test(e, lags=lags, level=level) if model.noise_numerator is not None else None
        )
    except BadInput:
        white = None
    try:
        free = input_correlation_test(
            e, u, lags=min(max(lags, reached), longest), first_lag=min(model.delay, 1), level=level
        )
    except BadInput:
        free = None
    try:
        wrong = (
            None
            if model.integrates
            else model_error_model(model, record.window(first, record.n), level=level)
        )
    except BadInput:
        wrong = None
    return ResidualCheck(white, free, wrong, n)


def prediction_errors(model: IdentifiedModel, record: Record) -> FloatArray:
    """ε about its mean, shape (n,): H⁻¹ (y − G u), H = 1 where there is no noise model; NaN where
    the past is not whole.

    H⁻¹ begins anew behind every gap, and its first samples, until an unknown past has faded to a
    thousandth, are left out.

    Raises BadRecord as `simulated_beside` does, NotIdentifiable for a model whose simulation
    diverges.
    """
    _, residual = simulated_beside(model, record)
    if not np.isfinite(residual[~np.isnan(residual)]).all():
        raise NotIdentifiable(
            f"model {model.method}: its simulation diverges, so its residuals tell nothing; take"
            " another order or method"
        )
    residual = residual - np.nanmean(residual)
    if model.noise_numerator is None or model.noise_denominator is None:
        return np.asarray(residual)
    memory = _memory(model.noise_numerator)
    e = np.full(len(residual), np.nan)
    known = np.flatnonzero(np.isfinite(residual))
    for run in np.split(known, np.flatnonzero(np.diff(known) > 1) + 1):
        filtered = signal.lfilter(model.noise_denominator, model.noise_numerator, residual[run])
        skipped = max(memory, len(model.noise_denominator) - 1)
        e[run[skipped:]] = filtered[skipped:]
    return e


def _memory(numerator: FloatArray) -> int:
    """Samples until 1/C has forgotten its beginning to a thousandth."""
    largest = float(np.abs(np.roots(numerator)).max(initial=0.0))
    return 0 if largest < _SETTLED else int(np.ceil(np.log(_SETTLED) / np.log(min(largest, 0.999))))


# The .632+ bootstrap: the error on new data from data that were all trained on; A.2 of the
# source.
# error = (1 − w) apparent + w out of bag, w = .632/(1 − .368 R), R = (out of bag − apparent)/(γ −
# apparent)
# The apparent error is too small, the error on what a bootstrap sample lacks too large (a sample
# holds .632 of the data); R weighs them by how far the method overfits, 0 to 1, γ being the error
# if input and output had nothing to do with each other. Efron, Tibshirani, J. Amer. Stat. Assoc.
# 92 (1997) 548–560.
# Of signals, blocks of time are drawn instead of samples: neighbours share their noise. Fails,
# and tells too small an error, where the noise remembers longer than a block lasts, and where all
# blocks lie in one operating point and the new data do not. Tells too large a one where the past
# that a prediction needs is a good part of a block, for every block lacks it at its beginning.

Fit = Callable[[Sequence[Record]], IdentifiedModel]
# 1 − 1/e: the share of the data that a bootstrap sample holds
_REACH = 0.632
_BLOCKS, _FEWEST_BLOCKS = 20, 6  # about, and at least
_PASTS_A_BLOCK = 3  # lengths of the past that a prediction needs, in a block at least


def weighed(apparent: float, out_of_bag: float, no_information: float) -> tuple[float, float]:
    """(error, R) of the three errors.

    >>> [round(value, 3) for value in weighed(0.0, 0.2, 0.5)]
    [0.148, 0.4]
    """
    worst = min(out_of_bag, no_information)
    room = no_information - apparent
    overfitting = (worst - apparent) / room if room > 0 and worst > apparent else 0.0
    weight = _REACH / (1.0 - (1.0 - _REACH) * overfitting)
    return (1.0 - weight) * apparent + weight * worst, overfitting


@dataclass(frozen=True)
class BlockBootstrap:
    """Mean squares of prediction errors [output unit²] about each block's level, and what they are
    made of.

    Attributes
    ----------
    error, apparent, out_of_bag, no_information, overfitting
        As in the equation above.
    samples, blocks : int
        Bootstrap samples that a model could be identified from, and blocks that they were drawn
        from.
    """

    error: float
    apparent: float
    out_of_bag: float
    no_information: float
    overfitting: float
    samples: int
    blocks: int


def block_bootstrap(
    fit: Fit, model: IdentifiedModel, records: Sequence[Record], *, repeats: int = 25, seed: int = 0
) -> BlockBootstrap:
    """The .632+ estimate of a model's prediction error on new data.

    Parameters
    ----------
    fit : callable
        Identifies a model as `model` was, from a sequence of records.
    model : IdentifiedModel
        Of all `records`.
    records : sequence of Record
        Cut into blocks, some twenty in all, of at least three times the past that a prediction
        needs.

    Raises
    ------
    NotIdentifiable
        Fewer than six blocks, or no sample that a model could be identified from.
    """
    blocks = cut_into_blocks(model, records)
    apparent, outputs = _errors(model, blocks)
    energy = [float(np.nanmean(y**2)) for y in outputs]  # about each block's level
    predicted = [float(np.nanmean((y - e) ** 2)) for y, e in zip(outputs, apparent, strict=True)]
    trained, mean_squares = _left_out(fit, blocks, repeats, seed)
    counted = [float(np.mean(block)) for block in mean_squares if block]
    if not counted:
        raise NotIdentifiable(
            "bootstrap: no sample of blocks has enough data for the model; record longer, or take a"
            " smaller order"
        )
    own = float(np.mean([np.nanmean(e**2) for e in apparent]))
    out_of_bag = float(np.mean(counted))
    # outputs and predictions of different blocks: their errors if nothing were learnt
    no_information = float(np.mean(energy) + np.mean(predicted))
    error, overfitting = weighed(own, out_of_bag, no_information)
    return BlockBootstrap(error, own, out_of_bag, no_information, overfitting, trained, len(blocks))


def _left_out(
    fit: Fit, blocks: Sequence[Record], repeats: int, seed: int
) -> tuple[int, list[list[float]]]:
    """(models trained, mean square errors of each block by the models that were trained without
    it).
    """
    rng, trained = np.random.default_rng(seed), 0
    mean_squares: list[list[float]] = [[] for _ in blocks]
    for _ in range(repeats):
        drawn = rng.integers(0, len(blocks), len(blocks))
        out = np.setdiff1d(np.arange(len(blocks)), drawn)
        if not len(out):
            continue
        try:
            refit = fit([blocks[k] for k in drawn])
            errors, _ = _errors(refit, [blocks[k] for k in out])
        except BadInput:
            # a sample of blocks may hold too little for the model
            continue
        trained += 1
        for k, e in zip(out, errors, strict=True):
            mean_squares[k].append(float(np.nanmean(e**2)))
    return trained, mean_squares


def cut_into_blocks(model: IdentifiedModel, records: Sequence[Record]) -> list[Record]:
    """Contiguous blocks of equal length, as far as the records' ends allow."""
    n = sum(record.n for record in records)
    past = model.delay + model.order
    length = max(_PASTS_A_BLOCK * past, n // _BLOCKS)
    blocks = []
    for record in records:
        count = record.n // length
        edges = [k * record.n // count for k in range(count + 1)] if count else []
        blocks += [record.window(first, last) for first, last in pairwise(edges)]
    if len(blocks) < _FEWEST_BLOCKS:
        raise NotIdentifiable(
            f"bootstrap: {n} samples make {len(blocks)} blocks of {length}, three times the past"
            f" that a prediction needs; at least {_FEWEST_BLOCKS} are needed: record longer, or"
            " take a smaller order"
        )
    return blocks


def _errors(
    model: IdentifiedModel, blocks: Sequence[Record]
) -> tuple[list[FloatArray], list[FloatArray]]:
    """Prediction errors and outputs of each block about their levels; NaN where the past is not
    whole.
    """
    errors, outputs = [], []
    for block in blocks:
        e = prediction_errors(model, block)
        y = np.where(np.isnan(e), np.nan, np.asarray(block[model.output_name], dtype=float))
        if not np.isfinite(e).any():
            raise NotIdentifiable("bootstrap: a block has no sample whose past is whole")
        errors.append(e - np.nanmean(e))
        outputs.append(y - np.nanmean(y))
    return errors, outputs
