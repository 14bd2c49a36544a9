"""What data say of the plant itself before a model is made: dead time, feedback, integrators,
unstable poles, excitation.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import reduce
from operator import add

import numpy as np
from scipy import linalg, stats

from residuum.array_types import FloatArray
from residuum.identification.blas_threads import one_thread_if_small
from residuum.identification.errors import BadRecord, NotIdentifiable
from residuum.identification.kernel_based.gram import RegressionSums, regression_sums
from residuum.identification.kernel_based.lagged_data import record_sums
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.validation import (
    input_correlation_test,
    simulated_beside,
)
from residuum.identification.record import Record

# A long autoregression with input, the common ground of the tests: it needs no knowledge of
# orders, dead time or feedback.
# A(q) y(t) = Σ_{j=0 or 1}^{Q} b_j u(t − j) + c + e(t), A(q) = 1 + a₁ q⁻¹ + … + a_P q⁻ᴾ
# by least squares, P by BIC. With lags enough e is white, and the estimates are consistent for
# open and closed loops alike (direct method: Ljung, System Identification (1999), 13.4).
# All comes from the Gram matrix and two Cholesky factors of it. With G = L Lᵀ and z = L⁻¹ Φᵀy, Σ
# z² of the last k columns is what they explain beyond all others, so that nested models and tests
# of the first k weights are running sums.

OUTPUT_LAGS = (2, 4, 8, 16, 30)
"""Candidates for P."""
SHORT_REACH, LONG_REACH = 120, 600
"""Input lags Q of a first look, and at most."""
_SAMPLES_A_LAG = 12  # at least, of an input's lags
_FEWEST, _MOST_ROWS = 120, 20_000  # samples of all records: fewer are refused, more left out
# parts of a diagonal element that keep a factor finite, and of the output's power that tell noise
_RIDGE, _RESOLUTION = 1e-10, 1e-10


@dataclass(frozen=True, eq=False)
class LongAutoregression:
    """The estimate in signals of zero mean and unit power.

    Attributes
    ----------
    output_weights : array, shape (P,)
        α_i = −a_i, of y(t − i).
    input_weights : array, shape (Q + 1 − first_lag,)
        b_j from lag `first_lag` on.
    leading : array, shape (Q + 1 − first_lag,)
        θ₁ᵀ Σ₁₁⁻¹ θ₁ of the first 1, 2, … input weights, χ² where they are zero.
    factor : array, shape (P + Q + 1 − first_lag,) squared
        Lower Cholesky factor of the inverse of the covariance; the columns are α₁ … α_P, then b
        from the last lag to the first.
    first_lag : int
        0 where the input may act within its own sample, else 1.
    inputs, innovations : list of array
        u and e of each record, shape (n,); NaN where unknown.
    resolved : bool
        Whether e is more than rounding.
    """

    output_weights: FloatArray
    input_weights: FloatArray
    leading: FloatArray
    factor: FloatArray
    first_lag: int
    inputs: list[FloatArray]
    innovations: list[FloatArray]
    resolved: bool

    def spread(self, of_outputs: FloatArray, of_inputs: FloatArray) -> float:
        """Standard deviation of a sum of weights with these factors."""
        factors = np.concatenate([of_outputs, of_inputs[::-1]])
        return float(np.linalg.norm(linalg.solve_triangular(self.factor, factors, lower=True)))


@one_thread_if_small(SHORT_REACH)
def long_autoregression(
    records: Sequence[Record],
    input: str,
    output: str,
    *,
    first_lag: int = 1,
    reach: int = SHORT_REACH,
) -> LongAutoregression:
    """Estimate it over all records, each with a level of its own; at most their first 20 000
    samples count.

    Parameters
    ----------
    first_lag : {0, 1}
    reach : int
        Input lags Q that are wanted; one in twelve samples at most.

    Raises
    ------
    NotIdentifiable
        Fewer than 120 samples, a signal that does not move, or too few rows without a missing
        sample.
    """
    us, ys = (
        [np.asarray(r[name], dtype=float)[: _MOST_ROWS // len(records)] for r in records]
        for name in (input, output)
    )
    n = sum(map(len, ys))
    if n < _FEWEST:
        raise NotIdentifiable(f"{n} samples: a test of the plant needs at least {_FEWEST}")
    us, ys = _scaled(us, input), _scaled(ys, output)
    Q = max(1, min(reach, n // _SAMPLES_A_LAG))
    sums = _sums(us, ys, first_lag, Q)
    if sums.rows < 2 * len(sums.cross):
        raise NotIdentifiable(
            f"{sums.rows} complete rows: a test of the plant needs {2 * len(sums.cross)}"
        )
    longest = OUTPUT_LAGS[-1]
    P = _output_lags(sums, longest)
    chosen = np.r_[0:P, len(sums.cross) - 1 : longest - 1 : -1]
    factor, explained = factored(sums.columns(chosen))
    theta = linalg.solve_triangular(factor, explained, lower=True, trans="T")
    alpha, b = theta[:P], theta[: P - 1 : -1]
    innovations = [
        _innovations(u, y, alpha, b, first_lag, max(longest, Q))
        for u, y in zip(us, ys, strict=True)
    ]
    energy = sum(float(np.nansum(e**2)) for e in innovations)
    variance = max(energy / max(sums.rows - len(chosen), 1), _RESOLUTION)
    leading = np.cumsum(explained[: P - 1 : -1] ** 2) / variance
    return LongAutoregression(
        alpha,
        b,
        leading,
        factor / np.sqrt(variance),
        first_lag,
        us,
        innovations,
        energy / sums.rows > _RESOLUTION,
    )


def _scaled(parts: Sequence[FloatArray], name: str) -> list[FloatArray]:
    centred = [part - np.nanmean(part) if np.isfinite(part).any() else part for part in parts]
    power = (
        float(np.nanmean(np.concatenate(centred) ** 2))
        if any(np.isfinite(part).any() for part in centred)
        else 0.0
    )
    if not power > 0:
        raise NotIdentifiable(f"channel {name!r}: does not move; nothing can be tested")
    return [part / np.sqrt(power) for part in centred]


def _sums(
    us: Sequence[FloatArray], ys: Sequence[FloatArray], first_lag: int, Q: int
) -> RegressionSums:
    """Of outputs 1 … 30 lags back, then inputs `first_lag` … Q lags back, each record about its
    means.
    """
    orders = [lags + 1 - first_lag for lags in (OUTPUT_LAGS[-1], Q)]
    parts = []
    for u, y in zip(us, ys, strict=True):
        try:
            parts.append(
                regression_sums([y, u], y, max(orders), first_lag, orders=orders).centred()
            )
        except NotIdentifiable:
            continue  # a record without a complete row adds nothing
    total = reduce(add, parts, RegressionSums.zero(sum(orders)))
    return total.columns(np.arange(1 - first_lag, sum(orders)))


def _output_lags(sums: RegressionSums, longest: int) -> int:
    """P of the smallest BIC."""
    inputs_first = np.r_[longest : len(sums.cross), 0:longest]
    _, explained = factored(sums.columns(inputs_first))
    left = sums.energy - np.cumsum(explained**2)[-longest - 1 :]
    return min(
        OUTPUT_LAGS,
        key=lambda P: (
            sums.rows * float(np.log(max(float(left[P]), _RESOLUTION))) + P * np.log(sums.rows)
        ),
    )


def factored(sums: RegressionSums) -> tuple[FloatArray, FloatArray]:
    """L of the Gram matrix, raised so little that columns which say the same have a factor, too,
    and L⁻¹ Φᵀy.
    """
    gram = sums.gram.copy()
    size = float(gram.trace()) / max(len(gram), 1)
    gram[np.diag_indices_from(gram)] += _RIDGE * (np.diag(gram) + max(size, 1.0))
    factor = linalg.cholesky(gram, lower=True)
    return factor, linalg.solve_triangular(factor, sums.cross, lower=True)


def _innovations(
    u: FloatArray, y: FloatArray, alpha: FloatArray, b: FloatArray, first_lag: int, reach: int
) -> FloatArray:
    """e about its mean; NaN where the past is not whole."""
    n = len(y)
    e = np.convolve(y, np.r_[1.0, -alpha])[:n] - np.convolve(u, np.r_[np.zeros(first_lag), b])[:n]
    e[:reach] = np.nan
    return e - np.nanmean(e) if np.isfinite(e).any() else e


# When does the input begin to act? The first lag whose weight, with all before it, is more than
# chance.
# H₀(k): b_first = … = b_k = 0 in the long autoregression, by the χ² of the leading weights; the
# dead time is the first k that is refused at .1 %. A response that begins gently is found a
# little late, by what drowns in the noise anyway.

_LEVEL_OF_DEAD_TIME = 1e-3  # at which leading lags are there


def dead_time(regression: LongAutoregression) -> int | None:
    """Samples before the input acts; None where it acts within no lag of the regression.

    >>> from residuum.identification.linear_models.plant_tests import long_autoregression
    >>> from residuum.identification.record import Record
    >>> u, e = np.random.default_rng(0).standard_normal((2, 1000))
    >>> record = Record({"u": u, "y": np.r_[np.zeros(40), u[:-40]] + e}, {"u": "", "y": ""}, 1.0)
    >>> dead_time(long_autoregression([record], "u", "y"))
    40
    """
    refused = np.flatnonzero(
        stats.chi2.sf(regression.leading, np.arange(1, len(regression.leading) + 1))
        < _LEVEL_OF_DEAD_TIME
    )
    return regression.first_lag + int(refused[0]) if refused.size else None


# What of a response does one experiment tell? The directions of its input that rise above the
# output's noise.
# y(t) = Σ_{j=f}^{Q} g_j u(t − j) + c + e(t) in signals of unit power. Along an eigenvector of ΦᵀΦ
# with eigenvalue λ the response is known to σ/√λ; where that exceeds one, the ratio of the powers
# of output and input, the record knows less of it than anybody. The number of the others is the
# order to which the input excites persistently at this noise: one sine 2, whatever its last
# digits say. The static gain is told where its standard deviation stays below one, or it is there
# by more than chance.

# lags of each input: at most, samples for each at least, and at least
_LAGS, _SAMPLES_A_LAG_OF_AN_INPUT, _FEWEST_LAGS = 60, 6, 4
_MOST_SAMPLES = 10_000  # of all records
# standard deviations of a gain that is there: 0.1 %, two-sided
_THERE = 3.3


@dataclass(frozen=True)
class ExcitationTest:
    """Directions that the record tells, of how many lags, and the static gain with its standard
    deviation.
    """

    order: int
    lags: int
    gain: float
    gain_spread: float

    @property
    def tells_gain(self) -> bool:
        """Whether the record tells the static gain without a model's help."""
        return self.gain_spread < max(1.0, abs(self.gain) / _THERE)


@one_thread_if_small(_LAGS)
def excitation_test(
    records: Sequence[Record], input: str, output: str, first_lag: int = 1
) -> ExcitationTest:
    """The test over all records, each with a level of its own; at most their first 10 000 samples
    count.

    Raises NotIdentifiable where no row is complete, or a signal does not move.

    >>> from residuum.identification.record import Record
    >>> rng, t = np.random.default_rng(0), np.arange(600)
    >>> u = np.sin(2 * np.pi * t / 20)
    >>> record = Record({"u": u, "y": 0.3 * np.roll(u, 3) + 0.02 * rng.standard_normal(600)}, {"u": "", "y": ""}, 1.0)
    >>> found = excitation_test([record], "u", "y")
    >>> found.order, found.tells_gain
    (2, False)
    """
    short = [record.window(0, min(record.n, _MOST_SAMPLES // len(records))) for record in records]
    lags = max(
        _FEWEST_LAGS, min(_LAGS, sum(record.n for record in short) // _SAMPLES_A_LAG_OF_AN_INPUT)
    )
    sums = reduce(
        add,
        [
            record_sums(record, [input], output, lags, first_lag, offset=True)[0].centred()
            for record in short
        ],
    )
    power, answer = max(float(np.diag(sums.gram).mean()), 1e-300), max(sums.energy, 1e-300)
    scaled = RegressionSums(
        sums.gram * (sums.rows / power),
        sums.cross * (sums.rows / np.sqrt(power * answer)),
        float(sums.rows),
        sums.rows,
        sums.regressor_sum,
        sums.output_sum,
        sums.fitted_offsets,
    )
    factor, explained = factored(scaled)
    noise = (
        max(1.0 - float(explained @ explained) / sums.rows, 0.0)
        * sums.rows
        / max(sums.degrees_of_freedom - lags, 1)
    )
    g = linalg.solve_triangular(factor, explained, lower=True, trans="T")
    spread = float(
        np.sqrt(noise) * np.linalg.norm(linalg.solve_triangular(factor, np.ones(lags), lower=True))
    )
    resolved = np.linalg.eigvalsh(scaled.gram) > max(noise, 1e-9 * sums.rows)
    return ExcitationTest(int(np.count_nonzero(resolved)), lags, float(g.sum()), spread)


# Does the input answer the output's noise, as a controller's does?
# u(t) = Σ_{i=1}^{30} f_i u(t − i) + Σ_{l} h_l e(t − l) + v(t), e the innovations of the output
# In an open loop all h_l are zero: the F-test of them is exact, whatever moves the input. Lag 0
# counts where the plant has at least one sample of delay; a plant that answers within the sample
# looks the same there, so that a delay of 0 leaves it out. Caines, Chan, IEEE Trans. Automatic
# Control 20 (1975) 498–508.
# Fails to see a loop whose noise is small beside what its set point moves, which then does little
# harm either.

_INPUT_PAST, _NOISE_PAST = 30, 10  # lags of its own past and of the noise that an input may answer
# feedback is there below this level, where it explains at least this share of the input's news
_LEVEL_OF_FEEDBACK, _LEAST_SHARE = 1e-4, 0.003
_FEWEST_A_COLUMN = 3  # rows for each lag
_LEAST_NEWS = 1e-8  # of the input's power, which its own past does not tell


@dataclass(frozen=True)
class FeedbackTest:
    """p-value of the F-test, and the part of the input's news that the output's noise explains."""

    p_value: float
    share: float

    @property
    def present(self) -> bool:
        """Whether the input answers the noise: p below 10⁻⁴, and .3 % of its news or more."""
        return self.p_value < _LEVEL_OF_FEEDBACK and self.share > _LEAST_SHARE


def feedback_test(regression: LongAutoregression) -> FeedbackTest | None:
    """The test on a long autoregression; None where noise or rows are too few to tell.

    >>> from residuum.identification.linear_models.plant_tests import long_autoregression
    >>> from residuum.identification.record import Record
    >>> rng, y, u = np.random.default_rng(0), np.zeros(1000), np.zeros(1000)
    >>> e, r = rng.standard_normal((2, 1000))
    >>> for t in range(1, 1000):
    ...     y[t] = 0.7 * y[t - 1] + u[t - 1] + e[t]
    ...     u[t] = 0.3 * (r[t] - y[t])
    >>> feedback_test(long_autoregression([Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0)], "u", "y")).present
    True
    """
    if not regression.resolved:
        return None
    sums = reduce(
        add,
        [
            _sums_over_innovations(u, e)
            for u, e in zip(regression.inputs, regression.innovations, strict=True)
        ],
    )
    own = np.arange(1, _INPUT_PAST + 1)
    noise = _INPUT_PAST + 1 + np.arange(1 - regression.first_lag, _NOISE_PAST)
    columns = np.r_[own, noise]
    if sums.rows < _FEWEST_A_COLUMN * len(columns):
        return None
    _, explained = factored(sums.columns(columns))
    without = sums.energy - float(np.sum(explained[: len(own)] ** 2))
    if not without > _LEAST_NEWS * sums.energy:
        return None  # an input that its own past tells exactly has no news to answer with
    answer = float(np.sum(explained[len(own) :] ** 2))
    freedom = sums.rows - len(columns)
    statistic = answer / len(noise) / max((without - answer) / freedom, np.finfo(float).tiny)
    return FeedbackTest(float(stats.f.sf(statistic, len(noise), freedom)), answer / without)


def _sums_over_innovations(u: FloatArray, e: FloatArray) -> RegressionSums:
    """Of the input on itself and on the innovations, lags 0 … 30 of both, about the means of one
    record.
    """
    try:
        return regression_sums([u, e], u, _INPUT_PAST + 1, 0).centred()
    except NotIdentifiable:
        return RegressionSums.zero(2 * (_INPUT_PAST + 1))


# Does the plant integrate? Whether the static gain B(1)/A(1) has a bound.
# The static gain of a long autoregression is B(1)/A(1). Its confidence set is bounded only if
# A(1) differs from zero by more than chance (Fieller 1954), and under a root at one chance is
# Dickey's and Fuller's: with the level estimated, A(1)/std exceeds 3.43 in 1 % of records only.
# Where A(1) may be zero and B(1) is not, the plant integrates, or settles slower than the record
# shows: the record cannot tell the two apart. Where neither differs from zero, the noise wanders
# and the plant need not.
# Fails where the loop holds the output so well that it hardly moves (then `feedback` speaks), and
# for a pole at one that the input does not reach.

DICKEY_FULLER = 3.43
"""1 % level of Dickey's and Fuller's statistic with a constant, long records."""
# standard deviations of a sum of input weights that is there: 0.1 %, two-sided
_INPUT_ACTS = 3.3


@dataclass(frozen=True)
class IntegratorTest:
    """A(1) and B(1) over their standard deviations."""

    level_statistic: float
    input_statistic: float

    @property
    def integrates(self) -> bool:
        """Whether the static gain has no bound."""
        return self.level_statistic < DICKEY_FULLER and abs(self.input_statistic) > _INPUT_ACTS

    @property
    def wanders(self) -> bool:
        """Whether the output wanders by itself."""
        return self.level_statistic < DICKEY_FULLER and abs(self.input_statistic) <= _INPUT_ACTS


def integrator_test(regression: LongAutoregression) -> IntegratorTest:
    """The test on a long autoregression.

    >>> from residuum.identification.linear_models.plant_tests import long_autoregression
    >>> from residuum.identification.record import Record
    >>> rng = np.random.default_rng(0)
    >>> u, e = rng.standard_normal((2, 1000))
    >>> level = np.r_[0.0, np.cumsum(u)[:-1]] + 0.1 * e
    >>> record = Record({"u": u, "level": level}, {"u": "", "level": ""}, 1.0)
    >>> integrator_test(long_autoregression([record], "u", "level")).integrates
    True
    """
    a, b = regression.output_weights, regression.input_weights
    level_spread = regression.spread(np.ones_like(a), np.zeros_like(b))
    input_spread = regression.spread(np.zeros_like(a), np.ones_like(b))
    return IntegratorTest((1.0 - float(a.sum())) / level_spread, float(b.sum()) / input_spread)


# How a model fares on data that its fit has not seen, and how much of the input's effect it
# misses there.
# The error r = y − ŷ of the simulation is regressed on the input: what that explains (adjusted
# R²) the model misses, what it does not is noise, so that a poor fit of a noisy record is no
# fault of the model's.
# missing = R² var r / (var y − (1 − R²) var r) part of the response's power
# Fails where the data kept aside excite less than the others.

KEPT_ASIDE = 0.3
"""The last part of a record that no split note divides."""
_MOST_LAGS, _SAMPLES_A_LAG_KEPT_ASIDE = 80, 12  # lags at most, and samples for each at least
# what the model misses of the output is too much below this level, and above this share
_LEVEL_KEPT_ASIDE, _TOO_MUCH = 1e-4, 0.1
_WORSE_THAN_A_CONSTANT = -5.0  # [%] of fit: a constant has 0


@dataclass(frozen=True)
class KeptAside:
    """Of one part kept aside.

    Attributes
    ----------
    fit_percent : float
        100 (1 − ‖y − ŷ‖/‖y − mean y‖).
    missing : float
        Part of the response's power that the input explains and the model does not.
    p_value : float
        That the error is free of the input.
    """

    fit_percent: float
    missing: float
    p_value: float

    @property
    def fails(self) -> bool:
        """Worse than a constant, or more than a tenth of the response's power (a third of its size)
        is missing.
        """
        return self.fit_percent < _WORSE_THAN_A_CONSTANT or (
            self.missing > _TOO_MUCH and self.p_value < _LEVEL_KEPT_ASIDE
        )


@one_thread_if_small(_MOST_LAGS)
def kept_aside(model: IdentifiedModel, record: Record, first: int = 0) -> KeptAside:
    """The model on the samples of `record` from `first` on; those before only give the input its
    past.

    Raises BadRecord for a part too short to have a fit, or one in whose past and present the input
    stands still.
    """
    past_input = np.asarray(record[model.input_name], dtype=float)[
        max(first - model.delay - model.order + 1, 0) :
    ]
    if first and not np.nanmax(past_input) > np.nanmin(past_input):
        raise BadRecord(
            f"{record.source or 'record'}: the input stands still in the part kept aside, which"
            " therefore tells nothing"
        )
    y, residual = simulated_beside(model, record, first)
    fit = 100 * (1 - float(np.nanstd(residual) / np.nanstd(y)))
    u = np.asarray(record[model.input_name], dtype=float)[first:]
    n = int(np.isfinite(residual).sum())
    lags = max(2, min(_MOST_LAGS, n // _SAMPLES_A_LAG_KEPT_ASIDE))
    try:
        p_value = input_correlation_test(residual, u, lags=lags).p_value
    except NotIdentifiable:
        return KeptAside(fit, 0.0, 1.0)
    noise = float(np.nanvar(residual)) * (1 - _explained(residual, u, lags))
    response = float(np.nanvar(y)) - noise
    missing = (float(np.nanvar(residual)) - noise) / response if response > 0 else 0.0
    return KeptAside(fit, missing, p_value)


def _explained(residual: FloatArray, u: FloatArray, lags: int) -> float:
    """Adjusted R² of the residual on the last `lags` inputs, 0 at least."""
    try:
        sums = regression_sums([u], residual, lags, 0).centred()
    except NotIdentifiable:
        return 0.0
    if sums.rows <= 2 * lags or not sums.energy > 0:
        return 0.0
    _, explained = factored(sums)
    left = sums.energy - float(explained @ explained)
    return max(0.0, 1.0 - left / (sums.rows - lags - 1) / (sums.energy / (sums.rows - 1)))


# Is the plant unstable? Whether A(q) of the long autoregression has a root outside the unit
# circle by more than chance.
# An unstable plant can be recorded only while a controller holds it, and the record stays bounded
# then. The long autoregression is right in the loop, too, so that the root is the plant's: noise
# alone cannot grow in a record that does not. Under a root at one the estimate errs to the stable
# side, which leaves integrators out.
# Fails where the loop answers without noise or set point, so that A cannot be told from the
# controller's answer.

# standard deviations outside the unit circle
_OUTSIDE = 5.0
# e-folds within the record that a root at least means: a slower one is as good as an integrator's
_GROWTH = 3.0


@dataclass(frozen=True)
class UnstableTest:
    """The root of largest size, the standard deviation of its size, and the e-folds that it grows
    in the record.
    """

    pole: complex
    spread: float
    growth: float

    @property
    def unstable(self) -> bool:
        """Whether the plant is."""
        return abs(self.pole) - 1 > _OUTSIDE * self.spread and self.growth > _GROWTH

    def says(self, sample_time: float) -> str:
        """The pole, in z and as a rate.

        >>> UnstableTest(1.1618 + 0j, 0.003, 300.0).says(0.005)
        'pole at 1.162 ± 0.003, which grows e-fold in 0.0333 s'
        """
        real = abs(self.pole.imag) < 1e-9 * abs(self.pole)
        at = (
            f"{self.pole.real:.4g}"
            if real
            else f"{self.pole.real:.4g} ± {abs(self.pole.imag):.4g}i (size {abs(self.pole):.4g})"
        )
        return (
            f"pole at {at} ± {self.spread:.1g}, which grows e-fold in"
            f" {sample_time / np.log(abs(self.pole)):.3g} s"
        )


def unstable_test(regression: LongAutoregression) -> UnstableTest | None:
    """The test on a long autoregression; None where noise is too small to tell.

    >>> from residuum.identification.linear_models.plant_tests import long_autoregression
    >>> from residuum.identification.record import Record
    >>> rng, y, u = np.random.default_rng(0), np.zeros(1000), np.zeros(1000)
    >>> e, r = rng.standard_normal((2, 1000))
    >>> for t in range(1, 1000):
    ...     y[t] = 1.1 * y[t - 1] + u[t - 1] + 0.1 * e[t]
    ...     u[t] = 0.5 * (r[t] - y[t])
    >>> unstable_test(long_autoregression([Record({"u": u, "y": y}, {"u": "", "y": ""}, 1.0)], "u", "y")).unstable
    True
    """
    if not regression.resolved:
        return None
    A = np.r_[1.0, -regression.output_weights]
    roots = np.roots(A)
    pole = complex(roots[np.argmax(np.abs(roots))])
    slope = np.polyval(np.polyder(A), pole)
    if abs(pole) <= 1 or slope == 0:
        return UnstableTest(pole, float("inf"), 0.0)
    by_weight = pole ** np.arange(len(A) - 2, -1, -1.0) / slope  # dλ/dα_i, from A(λ) = 0
    by_size = np.real(np.conj(pole) / abs(pole) * by_weight)
    samples = sum(len(u) for u in regression.inputs) / len(regression.inputs)
    return UnstableTest(
        pole,
        regression.spread(by_size, np.zeros_like(regression.input_weights)),
        float(np.log(abs(pole)) * samples),
    )
