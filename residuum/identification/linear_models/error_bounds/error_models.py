"""Ways to state how far an identified model may be from the plant, other than the covariance of its
own estimate.

A covariance that an estimate makes of itself knows variance, not bias: a model of too low an order
looks certain. Here the error G − Ĝ₀ is identified from residuals that the model leaves on records,
and stated as the second moment Σ_e + ê êᵀ of the error's impulse response, so that random models
drawn about Ĝ₀ reach as far as it does. Weights, residuals and controllers then use it as they use
any covariance; section 1.4.3 and Remark 2.9 of the source.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt
from scipy import linalg, signal

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.blas_threads import one_thread_if_small
from residuum.identification.errors import BadInput, BadModel, NotIdentifiable
from residuum.identification.kernel_based.gram import RegressionSums
from residuum.identification.kernel_based.impulse_response import (
    check_settings,
    maximise,
    provenance,
    scaled_sums,
)
from residuum.identification.kernel_based.kernels import KERNELS
from residuum.identification.kernel_based.lagged_data import lagged_data
from residuum.identification.kernel_based.marginal_likelihood import marginal_likelihood
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.set_membership import feasible_set
from residuum.identification.linear_models.validation import model_error_model, residual_record
from residuum.identification.record import Record

# A frequency grid on which an error envelope hides nothing between its points.
# On a fixed grid a resonance or a near zero of the nominal response can lie between two points; a
# bound that was fitted to the points then fails there. The envelope is built from responses that
# are trigonometric polynomials or ratios of them, so what it does within the angle π/m of the
# highest lag m is smooth except where the nominal response nearly vanishes. The grid therefore
# has points enough for the highest lag, the minima of the nominal response, and then halves each
# interval whose middle lies above the line through its ends.

Envelope = Callable[[FloatArray], FloatArray]

_DECADES, _LOGARITHMIC = 5.5, 600
# points of the linear grid, and of the one on which minima of the nominal response are looked
# for, a lag
_POINTS_A_LAG, _FINE = 4, 30
_MINIMA = 60
OFF_THE_LINE = 0.005
"""By how much a middle may lie above the line through its neighbours, in parts."""
_ROUNDS, _MOST = 12, 6000
# interval, in parts of its frequency, that is not halved further
_NARROWEST = 1e-6


def refined_grid(
    envelope: Envelope,
    nominal: Callable[[FloatArray], ComplexArray],
    lags: int,
    sample_time: float,
    asked: FloatArray | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Frequencies [rad/s] and the envelope there: between them it lies below the lines through its
    points, within `OFF_THE_LINE`.

    Parameters
    ----------
    envelope : callable
        ω, shape (k,) → Ω(ω), shape (k,), always of the same random models.
    nominal : callable
        ω → the nominal response.
    lags : int
        Highest power of z in the responses.
    asked : array or None
        Frequencies [rad/s] that the grid has, none below the first; None: 600 over five and a half
        decades.

    Notes
    -----
    Halving ends after `_ROUNDS` rounds or `_MOST` points; what is left between them is the caller's
    to check.
    """
    nyquist = math.pi / sample_time
    given = (
        np.geomspace(nyquist / 10**_DECADES, nyquist, _LOGARITHMIC)
        if asked is None
        else np.append(asked, nyquist)
    )
    omega = np.unique(
        np.concatenate(
            [
                given,
                nyquist * np.arange(1, _POINTS_A_LAG * lags + 1) / (_POINTS_A_LAG * lags),
                _minima(nominal, lags, nyquist),
            ]
        )
    )
    omega = omega[(omega >= given[0]) & (omega <= nyquist)]
    apart = np.append(True, np.diff(omega) > _NARROWEST * omega[1:])
    omega = omega[apart | np.isin(omega, given)]
    values = envelope(omega)
    # by the point that an interval begins at
    doubtful = np.append(np.ones(len(omega) - 1, dtype=bool), False)
    for _ in range(_ROUNDS):
        left = np.flatnonzero(doubtful)
        left = left[omega[left + 1] > omega[left] * (1.0 + _NARROWEST)]
        if not len(left) or len(omega) + len(left) > _MOST:
            break
        # from ω = 0: a tenth
        middle = np.sqrt(np.maximum(omega[left], 0.1 * omega[left + 1]) * omega[left + 1])
        inner = envelope(middle)
        # the middle of a straight line in (ln ω, ln Ω)
        line = np.sqrt(values[left] * values[left + 1])
        doubtful[left] = above = inner > line * (1.0 + OFF_THE_LINE)
        order = np.argsort(np.concatenate([omega, middle]))
        omega, values, doubtful = (
            np.concatenate(pair)[order]
            for pair in ((omega, middle), (values, inner), (doubtful, above))
        )
    return omega, values


def _minima(nominal: Callable[[FloatArray], ComplexArray], lags: int, nyquist: float) -> FloatArray:
    """Where the nominal response is smallest beside its neighbours, found on a fine grid and by
    parabolas through it.
    """
    omega = nyquist * np.arange(1, _FINE * lags + 1) / (_FINE * lags)
    power = np.abs(nominal(omega)) ** 2
    inner = np.flatnonzero((power[1:-1] < power[:-2]) & (power[1:-1] <= power[2:])) + 1
    inner = inner[np.argsort(power[inner])[:_MINIMA]]
    step = omega[1] - omega[0]
    bend = power[inner - 1] - 2 * power[inner] + power[inner + 1]
    shift = 0.5 * np.divide(
        power[inner - 1] - power[inner + 1], bend, out=np.zeros(len(inner)), where=bend > 0
    )
    return np.asarray(omega[inner] + step * np.clip(shift, -0.5, 0.5))


def asked_grid(sample_time: float, points: int | None, lowest: float | None) -> FloatArray | None:
    """The logarithmic grid [rad/s] up to π/Ts of so many points from a lowest frequency on; None:
    neither was asked for.

    Raises BadInput when the lowest frequency does not lie between 0 and π/Ts.
    """
    if points is None and lowest is None:
        return None
    nyquist = np.pi / sample_time
    low = nyquist / 10**_DECADES if lowest is None else lowest
    if not 0 < low < nyquist:
        raise BadInput(
            f"lowest frequency {low:g}: must lie between 0 and the Nyquist frequency, {nyquist:.6g}"
            " rad/s"
        )
    return np.asarray(np.geomspace(low, nyquist, points or _LOGARITHMIC))


# Errors of drawn models as ratios of polynomials, so that they can be evaluated, and bounded,
# between frequencies too.

Polynomials = tuple[FloatArray, FloatArray]
FORMS = ("multiplicative", "additive", "inverse-multiplicative")
_VALUES_AT_ONCE = 2_000_000


@dataclass(frozen=True, eq=False)
class DrawnErrors:
    """|A_i(e^{jωTs})| / |B_i(e^{jωTs})|, the error of each drawn model against a nominal one.

    Parameters
    ----------
    numerators : array, shape (n, p)
        A_i in ascending powers of z⁻¹.
    denominators : array, shape (n, q) or (1, q)
        B_i in ascending powers of z⁻¹.
    sample_time : float
        Ts [s].
    form : {"multiplicative", "additive", "inverse-multiplicative"}
        G_i/G₀ − 1, G_i − G₀, or 1 − G₀/G_i.
    """

    numerators: FloatArray
    denominators: FloatArray
    sample_time: float
    form: str

    @classmethod
    def of(
        cls, drawn: Polynomials, nominal: Polynomials, sample_time: float, form: str
    ) -> DrawnErrors:
        """Errors of G_i = N_i/D_i against G₀ = N₀/D₀, coefficient rows in ascending powers of
        z⁻¹.
        """
        (N, D), (N0, D0) = drawn, nominal
        mixed = _times(N, D0)
        difference = _sum(mixed, -_times(D, N0))
        below = {
            "multiplicative": _times(D, N0),
            "additive": _times(D, D0),
            "inverse-multiplicative": mixed,
        }[form]
        return cls(difference, below, sample_time, form)

    @classmethod
    def joined(cls, parts: Sequence[DrawnErrors]) -> DrawnErrors:
        """The errors of several sets of models together."""
        numerators, denominators = (
            [getattr(part, name) for part in parts] for name in ("numerators", "denominators")
        )
        p, q = (max(rows.shape[1] for rows in many) for many in (numerators, denominators))
        if all(
            len(rows) == 1 and np.array_equal(_padded(rows, q), _padded(denominators[0], q))
            for rows in denominators
        ):
            below = _padded(denominators[0], q)
        else:
            below = np.vstack(
                [
                    np.broadcast_to(_padded(b, q), (len(a), q))
                    for a, b in zip(numerators, denominators, strict=True)
                ]
            )
        return cls(
            np.vstack([_padded(rows, p) for rows in numerators]),
            below,
            parts[0].sample_time,
            parts[0].form,
        )

    @property
    def lags(self) -> int:
        """Highest lag of the polynomials."""
        return max(self.numerators.shape[1], self.denominators.shape[1]) - 1

    def envelope(self, omega: npt.ArrayLike) -> FloatArray:
        """Ω(ω) = max_i |A_i|/|B_i| (2.21), shape of `omega`.

        Raises
        ------
        BadModel
            A denominator is zero at a frequency, where a relative error means nothing.
        """
        omega = np.asarray(omega, dtype=float)
        largest = np.empty(len(omega))
        step = max(1, _VALUES_AT_ONCE // len(self.numerators))
        for first in range(0, len(omega), step):
            part = omega[first : first + step]
            above, below = (
                magnitude(rows, part * self.sample_time)
                for rows in (self.numerators, self.denominators)
            )
            smallest = 1e-14 * np.abs(self.denominators).sum(axis=1, keepdims=True)
            if (below <= smallest).any():
                zero = part[np.argmax((below <= smallest).any(axis=0))]
                raise BadModel(
                    f"uncertainty weight: the response is zero at {zero:g} rad/s, where no"
                    f" {self.form} error exists; use additive"
                )
            largest[first : first + step] = (above / below).max(axis=0)
        return np.maximum(largest, np.finfo(float).tiny)


def magnitude(rows: FloatArray, angle: FloatArray) -> FloatArray:
    """|Σ_k a_k e^{−jkθ}| of each row, shape (rows, angles)."""
    phase = np.multiply.outer(np.arange(rows.shape[1]), angle)
    return np.asarray(np.hypot(rows @ np.cos(phase), rows @ np.sin(phase)))


def _times(a: FloatArray, b: FloatArray) -> FloatArray:
    """Products of polynomials row by row; a single row goes with every row of the other."""
    long, short = (a, b) if a.shape[1] >= b.shape[1] else (b, a)
    product = np.zeros((max(len(a), len(b)), a.shape[1] + b.shape[1] - 1))
    for k in range(short.shape[1]):
        product[:, k : k + long.shape[1]] += short[:, k : k + 1] * long
    return product


def _sum(a: FloatArray, b: FloatArray) -> FloatArray:
    size = max(a.shape[1], b.shape[1])
    return _padded(a, size) + _padded(b, size)


def _padded(rows: FloatArray, size: int) -> FloatArray:
    return np.pad(rows, ((0, 0), (0, size - rows.shape[1])))


# Stochastic embedding: a simple nominal model, and the error of its simplicity as a random
# impulse response.


@dataclass(frozen=True, eq=False)
class StochasticEmbedding:
    """The nominal model, whose covariance holds bias and variance, and the two parts of that
    covariance, shape (m, m).
    """

    nominal: IdentifiedModel
    bias_covariance: FloatArray
    variance_covariance: FloatArray


def laguerre_basis(pole: float, functions: int, order: int) -> FloatArray:
    """Impulse responses of the first Laguerre functions, orthonormal, shape (order, functions).

    L_k(z) = √(1−p²)/(z−p) · ((1−pz)/(z−p))^{k−1}.

    >>> basis = laguerre_basis(0.5, 3, 200)
    >>> bool(np.allclose(basis.T @ basis, np.eye(3)))
    True
    """
    if not -1 < pole < 1 or not 1 <= functions <= order:
        raise BadInput(
            f"Laguerre basis: pole {pole} must lie inside ±1 and {functions} functions between 1"
            f" and the order {order}"
        )
    columns = [signal.lfilter([math.sqrt(1 - pole**2)], [1, -pole], np.eye(1, order)[0])]
    while len(columns) < functions:
        columns.append(signal.lfilter([-pole, 1], [1, -pole], columns[-1]))
    return np.stack(columns, axis=1)


def stochastic_embedding(
    records: Record | Sequence[Record],
    input: str,
    output: str,
    *,
    basis: npt.ArrayLike,
    kernel: str = "dc",
    delay: int = 1,
    offset: bool = True,
) -> StochasticEmbedding:
    """Identify g = B θ + δ: a nominal model in the span of a few basis functions, and a random
    error δ ~ N(0, λ K(α)).

    θ̂ = (BᵀRB)⁻¹BᵀΦᵀy is least squares. λ, α and σ² maximise the likelihood of the data from which
    θ was eliminated. With Π = B (BᵀRB)⁻¹ BᵀR, the error of the nominal model is

        Cov(Bθ̂ − g) = (Π − I) λK (Π − I)ᵀ + σ² B (BᵀRB)⁻¹ Bᵀ      (bias + variance)

    Goodwin, Gevers, Ninness, IEEE Trans. Automatic Control 37 (1992) 913–928; (1.124) of the
    source.

    Parameters
    ----------
    records, input, output, delay, offset
        As in `identify_impulse_response`.
    basis : array, shape (m, p)
        Impulse responses B of the basis functions, e.g. `laguerre_basis`.
    kernel : str
        Prior of δ. What a basis leaves over swings around zero, which `dc` can express; with `di`,
        the prior of the reference, and `tc` the 95 % ellipses covered the truth at 40–60 % of the
        frequencies in our tests, with `dc` at 94–95 %.

    Raises
    ------
    NotIdentifiable
        The input does not excite the basis, or there are too few rows.
    """
    started = time.perf_counter()
    B = np.atleast_2d(np.asarray(basis, dtype=float))
    check_settings(kernel, len(B), delay, "marginal")
    data = lagged_data(records, [input], output, len(B), delay, offset=offset)
    R = data.sums.gram
    with one_thread_if_small(len(R)):
        inverse = _inverse(B.T @ R @ B, data.sums.rows)
        theta = inverse @ B.T @ data.sums.cross
        scaled, input_scale, output_scale = scaled_sums(_without_nominal(data.sums, B, inverse), 1)
        likelihood = marginal_likelihood(scaled, KERNELS[kernel])
        x, value = maximise(likelihood)
        variance = output_scale**2 * likelihood.posterior(x).noise_variance
    [(eta, kappa)] = likelihood.hyper_parameters(x)
    scale = kappa * variance / float(input_scale[0]) ** 2
    left = B @ inverse @ B.T @ R - np.eye(len(B))
    bias = left @ (scale * KERNELS[kernel].matrix(len(B), eta)) @ left.T
    spread = variance * B @ inverse @ B.T
    names = [item.name for item in KERNELS[kernel].parameters]
    nominal = IdentifiedModel(
        method=f"stochastic-embedding-{kernel}",
        sample_time=data.sample_time,
        impulse_response=B @ theta,
        covariance=bias + spread,
        noise_variance=variance,
        input_name=input,
        input_unit=data.input_units[0],
        output_name=output,
        output_unit=data.output_unit,
        delay=delay,
        offset=data.offset(B @ theta),
        hyper_parameters={**dict(zip(names, map(float, eta), strict=True)), "scale": scale},
        negative_log_likelihood=value + likelihood.n * math.log(output_scale),
        provenance=provenance(data, "marginal", started),
    )
    return StochasticEmbedding(nominal, bias, spread)


def _inverse(normal: FloatArray, rows: int) -> FloatArray:
    try:
        return np.asarray(linalg.cho_solve(linalg.cho_factor(normal), np.eye(len(normal))))
    except linalg.LinAlgError:
        raise NotIdentifiable(
            f"stochastic embedding: {rows} rows do not excite the {len(normal)} basis functions"
        ) from None


def _without_nominal(sums: RegressionSums, B: FloatArray, inverse: FloatArray) -> RegressionSums:
    """The sums after B θ was eliminated, as a constant level is: each basis function takes one
    degree of freedom.
    """
    RB, b = sums.gram @ B, B.T @ sums.cross
    return RegressionSums(
        sums.gram - RB @ inverse @ RB.T,
        sums.cross - RB @ inverse @ b,
        sums.energy - float(b @ inverse @ b),
        sums.rows,
        sums.regressor_sum,
        sums.output_sum,
        sums.fitted_offsets + B.shape[1],
    )


_LAGS, _LEAST_LAGS = 100, 20
_SET_LAGS, _SET_ROWS = 20, 4000
_ROOM = 1.1
_POLES = (0.2, 0.4, 0.6, 0.75, 0.85, 0.92, 0.96)
_FUNCTIONS = 4


def with_model_error(
    model: IdentifiedModel, records: Sequence[Record], noise_bound: float | None = None
) -> IdentifiedModel:
    """The model with a kernel model error model (1.125) from records: Σ_e + ê êᵀ of the error's
    impulse response.

    Raises BadInput when a noise bound is given: this way has none; and what `model_error_model`
    raises.
    """
    if noise_bound is not None:
        raise BadInput(
            "uncertainty model-error: takes no noise bound; that belongs to set-membership"
        )
    shortest = min(record.n for record in records)
    lags = max(_LEAST_LAGS, min(_LAGS, shortest // 4))
    error_model = model_error_model(model, records, order=lags)
    verdict = "falsified" if error_model.falsified else "not falsified"
    warning = (
        f"model error model: {verdict}, at {len(error_model.falsified_at)} of"
        f" {len(error_model.omega)} frequencies"
    )
    return _with_error(
        model,
        error_model.error.impulse_response,
        error_model.error.covariance,
        "model-error",
        warning,
    )


def with_set_membership(
    model: IdentifiedModel, records: Sequence[Record], noise_bound: float | None = None
) -> IdentifiedModel:
    """The model with a set-membership model error model (1.127): all error responses that noise
    below a bound allows.

    Each coefficient is taken as evenly spread over its interval, centre c and half width r: second
    moment diag(r²/3) + c cᵀ.

    Parameters
    ----------
    noise_bound : float or None
        ν [output unit]; None: 1.1 times the smallest with which any error response is possible.

    Raises
    ------
    NotIdentifiable
        The bound is too small: no error response agrees with the records; says the smallest that
        does.
    """
    Phi, residual = _regression(model, records)
    smallest = feasible_set(
        Phi, residual, 1e-12 * float(np.abs(residual).max() or 1.0)
    ).smallest_bound
    bound = _ROOM * smallest if noise_bound is None else noise_bound
    feasible = feasible_set(Phi, residual, bound)
    if feasible.empty:
        raise NotIdentifiable(
            f"uncertainty set-membership: with noise of at most {bound:.4g} {model.output_unit} no"
            " error response agrees with the records; the smallest bound that leaves one is"
            f" {smallest:.4g}".replace("  ", " ")
        )
    warning = f"set membership: noise at most {bound:.4g} {model.output_unit}".rstrip()
    warning += f", smallest possible {smallest:.4g}"
    return _with_error(
        model, feasible.centre, np.diag(feasible.radius**2 / 3.0), "set-membership", warning
    )


def with_stochastic_embedding(
    model: IdentifiedModel, records: Sequence[Record], noise_bound: float | None = None
) -> IdentifiedModel:
    """Stochastic embedding (1.124) in the model's place: four Laguerre functions of the likeliest
    pole, and a random error.

    Raises BadInput when a noise bound is given, NotIdentifiable when the records do not excite the
    basis.
    """
    if noise_bound is not None:
        raise BadInput(
            "uncertainty stochastic-embedding: takes no noise bound; that belongs to set-membership"
        )
    return likeliest_embedding(records, model.input_name, model.output_name, delay=model.delay)


def likeliest_embedding(
    records: Sequence[Record],
    input: str,
    output: str,
    *,
    delay: int = 1,
    order: int | None = None,
    offset: bool = True,
) -> IdentifiedModel:
    """The nominal model of `stochastic_embedding` on four Laguerre functions of the likeliest of
    seven poles.

    Assumes that what four functions leave over decays and swings about zero (kernel `dc`). Fails,
    with bands too narrow, where that error is large: a resonance beside a slow mode, of which one
    pole fits only one.

    Parameters
    ----------
    order : int or None
        Length of the impulse response; None: 100, at most a quarter of the shortest record.

    Raises
    ------
    NotIdentifiable
        The records do not excite the basis.
    """
    if order is None:
        order = max(_LEAST_LAGS, min(_LAGS, min(record.n for record in records) // 4))
    functions = min(_FUNCTIONS, order)
    tried = [
        stochastic_embedding(
            records,
            input,
            output,
            basis=laguerre_basis(pole, functions, order),
            delay=delay,
            offset=offset,
        ).nominal
        for pole in _POLES
    ]
    best = int(np.argmin([model.negative_log_likelihood for model in tried]))
    warning = (
        f"stochastic embedding: {functions} Laguerre functions of pole {_POLES[best]:g}; the"
        " nominal model is theirs"
    )
    return replace(tried[best], warnings=(*tried[best].warnings, warning))


ERROR_MODELS: dict[
    str, Callable[[IdentifiedModel, Sequence[Record], float | None], IdentifiedModel]
] = {
    "model-error": with_model_error,
    "set-membership": with_set_membership,
    "stochastic-embedding": with_stochastic_embedding,
}
"""Name of a choice of `identify --uncertainty` → what makes it; each takes the model, records and a
noise bound or None.
"""


def _regression(model: IdentifiedModel, records: Sequence[Record]) -> tuple[FloatArray, FloatArray]:
    """Lagged inputs and what the model leaves of the output, about its mean; rows with anything
    missing are left out.
    """
    rows, targets = [], []
    for record in records:
        left = residual_record(model, record)
        u, e = left[model.input_name], left[model.output_name]
        lags = model.delay + np.arange(_SET_LAGS)
        first = int(lags[-1])
        Phi = np.stack([u[first - lag : len(u) - lag] for lag in lags], axis=1)
        good = np.isfinite(Phi).all(axis=1) & np.isfinite(e[first:])
        rows.append(Phi[good])
        targets.append(e[first:][good] - np.mean(e[first:][good]))
    Phi, target = np.concatenate(rows)[:_SET_ROWS], np.concatenate(targets)[:_SET_ROWS]
    if len(target) < 2 * _SET_LAGS:
        raise NotIdentifiable(
            f"uncertainty set-membership: {len(target)} complete rows; at least {2 * _SET_LAGS} are"
            " needed"
        )
    return np.asarray(Phi, dtype=float), np.asarray(target, dtype=float)


def _with_error(
    model: IdentifiedModel, error: FloatArray, covariance: FloatArray, name: str, warning: str
) -> IdentifiedModel:
    """The nominal impulse response, with the second moment of the error about it as its
    covariance.
    """
    m = max(model.order, len(error))
    g, e, spread = np.zeros(m), np.zeros(m), np.zeros((m, m))
    g[: model.order], e[: len(error)] = model.impulse_response, error
    spread[: len(error), : len(error)] = covariance
    return IdentifiedModel(
        method=f"{model.method}+{name}",
        sample_time=model.sample_time,
        impulse_response=g,
        covariance=spread + np.outer(e, e),
        noise_variance=model.noise_variance,
        input_name=model.input_name,
        input_unit=model.input_unit,
        output_name=model.output_name,
        output_unit=model.output_unit,
        delay=model.delay,
        offset=model.offset,
        hyper_parameters=model.hyper_parameters,
        warnings=(*model.warnings, warning),
        provenance=model.provenance,
    )
