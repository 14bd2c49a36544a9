"""Kernel-based identification: a regularised impulse response with its posterior covariance.

y(t) = Σ_i g_i u(t − delay − i) + offset + e(t) with the prior g ~ N(0, λ K(η)); η, λ and σ² by
marginal likelihood (empirical Bayes), the posterior by (A.17). Chen, Ohlsson, Ljung, Automatica 48
(2012) 1525–1535; Pillonetto et al., Automatica 50 (2014) 657–682; (2.19)–(2.20), (A.14)–(A.20) of
the source.
"""

from __future__ import annotations

import math
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import optimize

from residuum.array_types import FloatArray
from residuum.identification.blas_threads import one_thread_if_small
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.kernel_based.gram import RegressionSums
from residuum.identification.kernel_based.kernels import KERNELS
from residuum.identification.kernel_based.lagged_data import LaggedData, lagged_data
from residuum.identification.kernel_based.marginal_bands import (
    MOST_COEFFICIENTS,
    HyperMixture,
    PointwiseBands,
)
from residuum.identification.kernel_based.marginal_likelihood import (
    RESOLUTION,
    MarginalLikelihood,
    Posterior,
    marginal_likelihood,
)
from residuum.identification.kernel_based.outlasting import Longer, longer_response
from residuum.identification.linear_models.excitation import excitation_order
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.record import Record
from residuum.nearest_names import known_names

NoiseVariance = float | str
NOISE_VARIANCE_METHODS = ("marginal", "least-squares")
_LONGEST_ORDER = 5000
# above any −log p, and a number: a line search turns back from it, which it does not from NaN
_WALL = 1e100
# of a level's square, below which a movement about it is rounding
_ROUNDING = 1e-20


@dataclass(frozen=True, eq=False)
class ImpulseResponseFit:
    """Posterior of the impulse responses of one output, all inputs stacked: mean (p,), covariance
    (p, p).
    """

    mean: FloatArray
    covariance: FloatArray
    noise_variance: float
    hyper_parameters: tuple[Mapping[str, float], ...]
    negative_log_likelihood: float
    warnings: tuple[str, ...]
    bands: HyperMixture | None = None


def identify_impulse_response(
    records: Record | Sequence[Record],
    input: str,
    output: str,
    *,
    kernel: str = "tc",
    order: int = 100,
    delay: int = 1,
    noise_variance: NoiseVariance = "marginal",
    offset: bool = True,
    tail: int | None = None,
    hyper_uncertainty: bool = True,
    cover_cut: bool = True,
    like: IdentifiedModel | None = None,
) -> IdentifiedModel:
    """Identify the impulse response from `input` to `output`.

    Parameters
    ----------
    records : Record or sequence of Record
        Experiments with the same channels, units and sample time. Each counts with an initial state
        of its own: a row is used when the output sample and the `order` input samples before it are
        all there, so the unknown past, gaps and seams are left out, never filled.
    input, output : str
        Channel names.
    kernel : {"tc", "dc", "ss", "di"}
    order : int
        Number m of coefficients; with `delay` it should span the settling time.
    delay : int
        Lag of the first coefficient (1 = no direct feedthrough); see `estimate_delay`.
    noise_variance : {"marginal", "least-squares"} or float
        σ² as a hyper-parameter, from the unregularised least-squares fit (needs more rows than
        coefficients), or known [output unit²].
    offset : bool
        Whether each record has an unknown constant level (eliminated from its rows); False =
        signals are deviations.
    tail : int or None
        Coefficients beyond the order that are estimated too and left out of the result, so that
        what the order cuts off does not act as noise. None: half the order, at most one in a
        hundred samples; 0: the textbook problem.
    hyper_uncertainty : bool
        Whether the covariance also holds what the unknown hyper-parameters add (first order);
        False: (A.17c) alone.
    cover_cut : bool
        Whether a response that outlasts the order gets a longer one beside it (`longer_response`),
        which random models and bounds on the error are drawn from; False: they know nothing of what
        the order cuts off.
    like : IdentifiedModel or None
        A model of this kernel from records of the same plant: the search of the hyper-parameters
        begins at its.

    Returns
    -------
    IdentifiedModel
        Its `warnings` say when the input hardly excites, the response outlasts the order, or there
        is none. `hyper_parameters` are `alpha` (and `rho`) and `scale` λ [output unit²/input
        unit²].

    Raises
    ------
    NotIdentifiable
        Constant input or output, too few complete rows.
    BadInput
        Unknown kernel, order or delay out of range, records that do not belong together.

    Notes
    -----
    `covariance` is at the estimated hyper-parameters (with their first-order effect), and what
    frequency responses and random models are made from; `std` is of single coefficients, with the
    hyper-parameters marginalised (`marginal_bands`), up to 1000 coefficients. The coverage of both
    is measured in benchmarks/results/identification.md.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(400)
    >>> y = np.convolve(u, [0.0, 1.0, 0.5, 0.2])[:400] + 0.1 * rng.standard_normal(400)
    >>> model = identify_impulse_response(Record({"u": u, "y": y}, {"u": "V", "y": "A"}, 0.01), "u", "y", order=20)
    >>> model.impulse_response[:3].round(1).tolist(), model.method
    ([1.0, 0.5, 0.2], 'kernel-tc')
    """
    started = time.perf_counter()
    check_settings(kernel, order, delay, noise_variance)
    experiments = [records] if isinstance(records, Record) else list(records)
    if tail is None:
        tail = min(order // 2, sum(record.n for record in experiments) // 100)
    data = lagged_data(experiments, [input], output, order + tail, delay, offset=offset)
    fit = fit_impulse_response(
        data.sums, kernel, 1, noise_variance, hyper_uncertainty=hyper_uncertainty, like=like
    )

    def refit(length: int) -> tuple[FloatArray, FloatArray]:
        sums = lagged_data(experiments, [input], output, length, delay, offset=offset).sums
        again = fit_impulse_response(
            sums, kernel, 1, noise_variance, hyper_uncertainty=hyper_uncertainty
        )
        return again.mean, again.covariance

    longer = (
        longer_response((fit.mean, fit.covariance), order, data.sums.rows, refit)
        if cover_cut
        else None
    )
    return IdentifiedModel(
        method=f"kernel-{kernel}",
        sample_time=data.sample_time,
        impulse_response=fit.mean[:order],
        covariance=fit.covariance[:order, :order],
        noise_variance=fit.noise_variance,
        input_name=input,
        input_unit=data.input_units[0],
        output_name=output,
        output_unit=data.output_unit,
        delay=delay,
        offset=data.offset(fit.mean),
        hyper_parameters=fit.hyper_parameters[0],
        negative_log_likelihood=fit.negative_log_likelihood,
        warnings=(*fit.warnings, *uncovered(longer, delay)),
        provenance={**provenance(data, noise_variance, started), "tail": tail},
        longer_response=None if longer is None else longer.mean,
        longer_covariance=None if longer is None else longer.covariance,
        bands=None if fit.bands is None else PointwiseBands(fit.bands, slice(0, order)),
    )


def fit_impulse_response(
    sums: RegressionSums,
    kernel: str,
    n_inputs: int = 1,
    noise_variance: NoiseVariance = "marginal",
    *,
    hyper_uncertainty: bool = True,
    like: IdentifiedModel | None = None,
) -> ImpulseResponseFit:
    """Posterior of the impulse responses from regression sums alone; parameters as in
    `identify_impulse_response`.

    >>> from residuum.identification.kernel_based.gram import regression_sums
    >>> rng = np.random.default_rng(0)
    >>> u = rng.standard_normal(2000)
    >>> y = np.convolve(u, [0.0, 1.0, 0.5])[:2000] + 0.1 * rng.standard_normal(2000)
    >>> fit_impulse_response(regression_sums([u], y, 20), "tc").mean[:2].round(2).tolist()
    [1.0, 0.5]
    """
    order = len(sums.cross) // n_inputs
    if sums.degrees_of_freedom < 4 + 3 * n_inputs:
        raise NotIdentifiable(
            f"{sums.rows} complete rows: kernel identification needs at least {4 + 3 * n_inputs}"
            " (+1 an offset)"
        )
    with one_thread_if_small(len(sums.cross)):
        scaled, input_scale, output_scale = scaled_sums(sums, n_inputs)
        excited = excitation_order(scaled.gram)
        known = _known_variance(scaled, noise_variance, output_scale, excited)
        likelihood = marginal_likelihood(scaled, KERNELS[kernel], n_inputs, known)
        if like is None:
            x, value = maximise(likelihood)
        else:
            x, value = maximise(likelihood, _variables(likelihood, like, input_scale[0]), 1e-7)
        posterior = likelihood.posterior(x)
        spread = likelihood.hyper_parameter_spread(x) if hyper_uncertainty else 0.0
    ratio = output_scale / input_scale
    per_coefficient = np.repeat(ratio, order)
    return ImpulseResponseFit(
        per_coefficient * posterior.mean,
        np.outer(per_coefficient, per_coefficient) * (posterior.covariance + spread),
        output_scale**2 * posterior.noise_variance,
        _named(likelihood, x, posterior.noise_variance * ratio**2),
        # The density is of the output at unit mean square: in its own unit each of n samples
        # divides it by the scale.
        value + likelihood.n * math.log(output_scale),
        tuple(_warnings(likelihood, posterior, value, excited)),
        (
            HyperMixture(likelihood, x, per_coefficient)
            if hyper_uncertainty and len(per_coefficient) <= MOST_COEFFICIENTS
            else None
        ),
    )


def _named(
    likelihood: MarginalLikelihood, x: FloatArray, units: FloatArray
) -> tuple[dict[str, float], ...]:
    """The hyper-parameters of each input by name, κ brought to the scale λ in the units of the
    data.
    """
    names = [item.name for item in likelihood.kernel.parameters]
    return tuple(
        {**dict(zip(names, map(float, eta), strict=True)), "scale": float(kappa * unit)}
        for (eta, kappa), unit in zip(likelihood.hyper_parameters(x), units, strict=True)
    )


def _variables(
    likelihood: MarginalLikelihood, like: IdentifiedModel, input_scale: float
) -> FloatArray:
    """The search variables that a model's hyper-parameters are: the inverse of `_named` for one
    input.
    """
    values = like.hyper_parameters
    kappa = values["scale"] * input_scale**2 / max(like.noise_variance, np.finfo(float).tiny)
    eta = [item.free(values[item.name]) for item in likelihood.kernel.parameters]
    return np.array([*eta, math.log(max(kappa, np.finfo(float).tiny))])


def maximise(
    likelihood: MarginalLikelihood, start: FloatArray | None = None, tolerance: float = 1e-11
) -> tuple[FloatArray, float]:
    """Search variables of the largest marginal likelihood and −log p there.

    A coarse grid of time constants and signal-to-noise ratios (or `start`), then L-BFGS-B on the
    exact gradient. It neither begins where the likelihood is no number nor goes there.

    Raises
    ------
    NotIdentifiable
        The likelihood is a number at none of the starts.
    """
    given = None if start is None else _finite_start(likelihood, [start])
    x = _finite_start(likelihood, _starts(likelihood)) if given is None else given
    if x is None:
        raise NotIdentifiable(
            "the likelihood is no number at any start of its search, so that the record tells no"
            " response: record while the input moves, or scale the signals to about 1"
        )
    decay = [item.bounds for item in likelihood.kernel.parameters]
    # ln κ may move by a factor e⁴⁰ both ways: no estimate, but no overflow either
    kappa = [(value - 40.0, value + 40.0) for value in x.reshape(likelihood.n_inputs, -1)[:, -1]]
    bounds = [pair for input_kappa in kappa for pair in [*decay, input_kappa]]
    optimum = optimize.minimize(
        lambda at: _finite(*likelihood.value_and_gradient(at)),
        x,
        jac=True,
        method="L-BFGS-B",
        bounds=bounds,
        # The gradient grows with the rows, as −log p does, and so does what is small of it.
        options={"ftol": tolerance, "gtol": 1e-6 * likelihood.n},
    )
    return np.asarray(optimum.x), float(optimum.fun)


def _finite_start(
    likelihood: MarginalLikelihood, starts: Sequence[FloatArray]
) -> FloatArray | None:
    """Of the starts the likeliest; None where the likelihood is a number at none."""
    values = [likelihood.value(x) if np.all(np.isfinite(x)) else np.inf for x in starts]
    known = [(value, k) for k, value in enumerate(values) if np.isfinite(value)]
    return starts[min(known)[1]] if known else None


def _finite(value: float, gradient: FloatArray) -> tuple[float, FloatArray]:
    """Value and gradient, or a wall where they are no numbers, from which a line search turns
    back.
    """
    if np.isfinite(value) and np.all(np.isfinite(gradient)):
        return value, gradient
    return _WALL, np.zeros_like(gradient)


def _starts(likelihood: MarginalLikelihood) -> list[FloatArray]:
    starts = []
    # four time constants from a sample to the length of the response, at two ratios of signal to
    # noise: the likelihood may have several maxima
    for time_constant in np.geomspace(min(2.0, likelihood.order), max(likelihood.order, 4.0), 4):
        alpha = math.exp(-1.0 / time_constant)
        free = [
            # ρ = √α makes a TC kernel of a DC one.
            item.free(alpha if item.name == "alpha" else math.sqrt(alpha))
            for item in likelihood.kernel.parameters
        ]
        x = np.tile([*free, 0.0], likelihood.n_inputs)
        gain = likelihood.gain(x)
        for signal_to_noise in (1.0, 100.0):
            x = x.copy()
            # κ last of each input's variables, so that κ tr(ΦᵀΦ K)/n is the ratio
            x[len(free) :: len(free) + 1] = np.log(
                signal_to_noise / np.maximum(gain, np.finfo(float).tiny)
            )
            starts.append(x)
    return starts


def scaled_sums(sums: RegressionSums, n_inputs: int) -> tuple[RegressionSums, FloatArray, float]:
    """The sums with every signal at unit mean square, and the scales; refuses signals that do not
    move.
    """
    n = sums.degrees_of_freedom
    power = np.diag(sums.gram).reshape(n_inputs, -1).mean(axis=1) / n
    level = np.square(sums.regressor_sum / max(sums.rows, 1)).reshape(n_inputs, -1).mean(axis=1)
    # what moves about a level by no more than rounding does not move
    input_scale = np.sqrt(np.where(power > _ROUNDING * level, power, 0.0))
    output_scale = math.sqrt(max(sums.energy, 0.0) / n)
    # squares may underflow to zero where the value itself does not
    if not (output_scale > 0 and output_scale**2 > 0):
        raise NotIdentifiable("the output does not move: an impulse response needs a response")
    if not np.all(np.square(input_scale) > 0):
        raise NotIdentifiable(
            "the input does not move in the rows whose whole past is there (persistently exciting"
            " of order 0): take a smaller order, or record longer before and after what moves it"
        )
    scale = np.repeat(input_scale, len(sums.cross) // n_inputs)
    gram = sums.gram / scale / scale[:, None]
    if not (np.isfinite(gram).all() and np.isfinite(output_scale)):
        raise NotIdentifiable(
            "the sums of the regression are not finite: the signals are too large for double"
            " precision"
        )
    cross = sums.cross / scale / output_scale
    scaled = RegressionSums(
        gram, cross, float(n), sums.rows, sums.regressor_sum, sums.output_sum, sums.fitted_offsets
    )
    return scaled, input_scale, output_scale


def _known_variance(
    scaled: RegressionSums, setting: NoiseVariance, output_scale: float, excited: int
) -> float | None:
    if setting == "marginal":
        return None
    if isinstance(setting, int | float):
        return float(setting) / output_scale**2
    spare = scaled.degrees_of_freedom - excited
    if spare < 1:
        raise NotIdentifiable(
            f"{scaled.rows} complete rows: the least-squares noise variance needs more rows than"
            f" coefficients, here {excited}"
        )
    # The least norm where the input leaves directions without excitation. A fit without noise
    # leaves rounding alone, hence a floor at the resolution of doubles.
    solution = np.linalg.lstsq(scaled.gram, scaled.cross, rcond=1e-12)[0]
    return max(scaled.energy - float(solution @ scaled.cross), RESOLUTION * scaled.energy) / spare


def _warnings(
    likelihood: MarginalLikelihood, posterior: Posterior, value: float, excited: int
) -> list[str]:
    columns = likelihood.order * likelihood.n_inputs
    texts = []
    if excited < columns:
        texts.append(
            f"the input is persistently exciting of order {excited} only; {columns} coefficients"
            " rest on the prior"
        )
    if posterior.noise_variance <= 2 * RESOLUTION:
        texts.append(
            "the noise is below what double precision can resolve; its variance is a bound, not an"
            " estimate"
        )
    variance = (
        likelihood.energy / likelihood.n
        if likelihood.noise_variance is None
        else likelihood.noise_variance
    )
    # −log p of the output as noise alone
    silent = 0.5 * (likelihood.energy / variance + likelihood.n * math.log(2 * math.pi * variance))
    if silent - value < 3.0 + math.log(likelihood.n):
        texts.append("the output shows no significant response to the input")
    for g in np.abs(posterior.mean).reshape(likelihood.n_inputs, -1):
        left = float(
            np.sqrt(np.mean(g[-max(1, len(g) // 20) :] ** 2)) / max(g.max(), np.finfo(float).tiny)
        )
        if len(g) > 1 and left > 0.05:
            texts.append(
                f"the response has not decayed within {len(g)} samples: {100 * left:.0f} % of its"
                " largest value is left"
            )
    return texts


def uncovered(longer: Longer | None, delay: int, n_inputs: int = 1) -> list[str]:
    """The warning of a model whose response lasts longer than the records can tell."""
    if longer is None or longer.negligible:
        return []
    last = delay + len(longer.mean) // n_inputs - 1
    return [
        f"bounds on the model's error do not cover what lies beyond lag {last}, for the response"
        " lasts longer than the records can tell: record longer, or identify with arx or oe"
    ]


def check_settings(kernel: str, order: int, delay: int, noise_variance: NoiseVariance) -> None:
    """Refuse settings that no data could satisfy."""
    if kernel not in KERNELS:
        raise BadInput(
            f"kernel {kernel!r}: there is none of this name; {known_names(kernel, KERNELS)}"
        )
    if not 1 <= order <= _LONGEST_ORDER:
        raise BadInput(f"order {order}: must lie between 1 and {_LONGEST_ORDER}")
    if delay < 0:
        raise BadInput(f"delay {delay}: must be a number of samples ≥ 0")
    if isinstance(noise_variance, str):
        if noise_variance not in NOISE_VARIANCE_METHODS:
            raise BadInput(
                f"noise variance {noise_variance!r}: must be a number or one of"
                f" {', '.join(NOISE_VARIANCE_METHODS)}"
            )
    elif not (math.isfinite(noise_variance) and noise_variance > 0):
        raise BadInput(f"noise variance {noise_variance}: must be positive and finite")


def provenance(
    data: LaggedData, noise_variance: NoiseVariance, started: float
) -> dict[str, object]:
    """What a result was made of."""
    return {
        "records": list(data.sources),
        "n": data.sums.rows,
        "noise_variance_from": noise_variance if isinstance(noise_variance, str) else "known",
        "seconds": time.perf_counter() - started,
    }
