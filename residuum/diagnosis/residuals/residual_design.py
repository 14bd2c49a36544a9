"""A designed residual detector: model, weight, post-filter, noise model and healthy reference, as
one stored thing.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field, fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy import signal, stats

from residuum.array_types import FloatArray
from residuum.diagnosis.learning.stored import load_stored, save_stored
from residuum.diagnosis.residuals.generators.approximate_fault_detection import (
    FaultKind,
    PostFilter,
    approximate_fault_detection,
    noise_path,
)
from residuum.diagnosis.residuals.generators.classical_filters import Given, classical_filter
from residuum.diagnosis.residuals.generators.residual_generator import (
    ResidualGenerator,
    ResidualSignals,
    generator_of,
)
from residuum.diagnosis.residuals.likelihood_ratio import LikelihoodRatioBank, bank_threshold
from residuum.diagnosis.residuals.noise_model import (
    NoiseModel,
    fit_noise_model,
    single_sample_law,
    with_healthy_tail,
    with_unbiased_size,
)
from residuum.diagnosis.residuals.residual_evaluation import EVALUATIONS, evaluate
from residuum.diagnosis.systems import left_coprime, peak_gain
from residuum.diagnosis.thresholds.false_alarm_rate import block_peaks
from residuum.diagnosis.thresholds.tails import HazardTail
from residuum.identification.blas_threads import LARGEST_FOR_ONE_THREAD, one_thread_if_small
from residuum.identification.errors import BadInput, BadRecord, NotIdentifiable
from residuum.identification.linear_models.identified_model import IdentifiedModel
from residuum.identification.linear_models.state_space import StateSpace
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.identification.record import Record

STRUCTURED_P = 1e-3
"""Of a right model, one healthy record in so many shows structured error."""
KIND, VERSION = "residual-design", 1
_SWAPPED = 0.3  # of explained variance by which the reverse direction must win
_RATE_TOLERANCE = 1e-3  # of a record's sample time
# the name of the post-filter by Algorithm 5, beside those of `classical_filters`
ROBUST = "robust"
_NOISE_NUMBERS = ("sigma", "dof", "n", "shape", "freedom", "blur")
_SETTLED = 1000  # samples of the post-filter's impulse response


@dataclass(frozen=True, eq=False, kw_only=True)
class ResidualDesign:
    """Everything a residual detector of one plant consists of.

    Parameters
    ----------
    model : IdentifiedModel
        Nominal model with its covariance; its channel names and units are the design's.
    post_filter : PostFilter
        Verified AFDP filter with γ, β and the error of its reduction.
    noise : NoiseModel
        Of the healthy primary residual.
    robust_noise : NoiseModel or None
        Law of the noise in one sample of the healthy robust residual; None without healthy records.
    W_T : TransferFunction or None
        Multiplicative uncertainty weight the filter was designed for.
    gamma : float
        γ of (4.7).
    fault : "sensor" or "actuator"
        G_f the filter is most sensitive to.
    method : str
        What made the post-filter: `robust` (Algorithm 5) or a classical method.
    input_mean, output_mean : float
        Operating point.
    input_bound, noise_bound : float
        Largest |u − mean| and |e| that the `source` and `peak` thresholds assume; infinite when not
        known.
    peaks : mapping of evaluation name to array
        Healthy peaks (128 samples each) for the `calibrated` threshold; empty without healthy
        records.
    structured_p : float
        Probability that a right model shows healthy scores this far from independent normals; 1
        without healthy records.
    """

    model: IdentifiedModel
    post_filter: PostFilter
    noise: NoiseModel
    robust_noise: NoiseModel | None = None
    W_T: TransferFunction | None = None
    gamma: float = 0.1
    fault: FaultKind = "sensor"
    method: str = ROBUST
    input_mean: float = 0.0
    output_mean: float = 0.0
    input_bound: float = float("inf")
    noise_bound: float = float("inf")
    peaks: dict[str, FloatArray] = field(default_factory=dict)
    structured_p: float = 1.0

    @property
    def has_structured_error(self) -> bool:
        """Whether the healthy record says that a part of the plant is missing: `structured_p` below
        `STRUCTURED_P`.
        """
        return self.structured_p < STRUCTURED_P

    @property
    def generator(self) -> ResidualGenerator:
        """The filters that run on u and y."""
        return generator_of(
            self.model, self.post_filter.Q, self.noise, (self.input_mean, self.output_mean)
        )

    @cached_property
    def peak_gains(self) -> FloatArray:
        """Σ_k |impulse response| from each fictitious noise [u; e] of (4.5), or e alone, to the
        robust residual.
        """
        factors = left_coprime(StateSpace.from_transfer_function(self.model.transfer_function()))
        return np.asarray(peak_gain(self.post_filter.Q @ noise_path(factors, self.W_T))[0])

    @cached_property
    def robust_spread(self) -> float:
        """Standard deviation of the noise in the robust residual [output unit × γ]."""
        return self.noise.output_std(self.post_filter.Q.impulse_response(_SETTLED)[:, 0, 0])

    @property
    def single_sample_noise(self) -> NoiseModel:
        """`robust_noise`; without healthy records the noise model's own law at the size it has in
        the robust residual.
        """
        if self.robust_noise is not None:
            return self.robust_noise
        noise = self.noise
        return replace(
            noise, ar=np.ones(1), sigma=noise.sigma * self.robust_spread / noise.innovation_std
        )

    def robust_error(self, u: FloatArray) -> FloatArray:
        """√(φ_Qᵀ Σ_g φ_Q), shape (n,): standard deviation of the model error in the robust
        residual, φ_Q being u through Q.
        """
        filtered = self.post_filter.Q.modal.simulate((u - self.input_mean)[:, None])[0][:, 0]
        return self.model.simulation_std(filtered)

    def bank(self, threshold: float, *, restart: bool = True) -> LikelihoodRatioBank:
        """A likelihood-ratio bank that knows how uncertain this model and its operating point
        are.
        """
        return LikelihoodRatioBank(
            threshold,
            self.model.covariance,
            self.model.delay,
            level_variance=self.noise.level_variance,
            restart=restart,
        )

    def bank_threshold(self, rate: float) -> float:
        """b at which that bank alarms `rate` times per healthy sample, averaged over the healthy
        records σ may come from.
        """
        return self.noise.allowing_for_size(bank_threshold(rate))

    def signals_of(self, record: Record) -> tuple[FloatArray, FloatArray]:
        """u and y of a record in the design's units.

        Raises
        ------
        BadRecord
            A channel is absent, or the record has another sample time.
        BadUnit
            A channel's unit cannot be converted.
        """
        u = record.in_unit(self.model.input_name, self.model.input_unit)
        y = record.in_unit(self.model.output_name, self.model.output_unit)
        refuse_other_rate(record, self.model.sample_time)
        return u, y

    def refuse_swapped(self, record: Record) -> None:
        """BadRecord when the record fits far better with input and output exchanged."""
        if (reason := self.swapped(record.source, *self.signals_of(record))) is not None:
            raise BadRecord(reason)

    def swapped(self, source: str, u: FloatArray, y: FloatArray) -> str | None:
        """What says that u and y, each of shape (n,), are exchanged, or None."""
        forward, backward = self._explained(u, y), self._explained(y, u)
        if not (backward > _SWAPPED and forward < backward - _SWAPPED):
            return None
        return (
            f"record {source!r}: {self.model.input_name!r} and {self.model.output_name!r} look"
            f" swapped: the model explains {100 * max(forward, 0.0):.0f} % of the output as named,"
            f" {100 * backward:.0f} % the other way round"
        )

    def _explained(self, u: FloatArray, y: FloatArray) -> float:
        """Share of y's variance that the model explains once its memory is full; 0 where y does not
        move there.
        """
        good = np.isfinite(u) & np.isfinite(y)
        m = self.model.order + self.model.delay
        compared = np.flatnonzero(good[m:]) + m
        if good.sum() < 2 * m or not len(compared) or np.ptp(y[compared]) == 0.0:
            return 0.0
        predicted = (
            self.model.simulate(np.where(good, u - np.mean(u[good]), 0.0)) - self.model.offset
        )
        return 1.0 - float(np.var(y[compared] - predicted[compared]) / np.var(y[compared]))

    def save(
        self, path: str | Path, *, kind: str = KIND, settings: dict[str, Any] | None = None
    ) -> None:
        """Store the design (JSON and arrays in a zip), with the settings of a diagnoser that is
        built on it.
        """
        model = {
            item.name: getattr(self.model, item.name)
            for item in fields(IdentifiedModel)
            if item.name != "bands"
        }
        arrays, numbers = _arrays_and_numbers(model)
        arrays = {f"model-{name}": value for name, value in arrays.items()}
        arrays |= {f"Q-{name}": getattr(self.post_filter.Q, name) for name in "ABCD"}
        arrays["noise-ar"] = self.noise.ar
        arrays |= {f"peaks-{name}": value for name, value in self.peaks.items()}
        if self.W_T is not None:
            arrays |= {"W_T-num": self.W_T.num, "W_T-den": self.W_T.den}
        robust_noise = None if self.robust_noise is None else _noise_numbers(self.robust_noise)
        post_filter = {name: getattr(self.post_filter, name) for name in _FILTER_NUMBERS}
        meta = {
            "model": numbers,
            "post_filter": post_filter,
            "noise": _noise_numbers(self.noise),
            "robust_noise": robust_noise,
            "settings": settings or {},
            "design": {name: _jsonable(getattr(self, name)) for name in _NUMBERS},
        }
        save_stored(path, kind, VERSION, meta, arrays)

    @classmethod
    def load(cls, path: str | Path) -> ResidualDesign:
        """The design stored by `save`; BadInput when the file is not one."""
        return cls.load_with_settings(path, kind=KIND)[0]

    @classmethod
    def load_with_settings(
        cls, path: str | Path, *, kind: str
    ) -> tuple[ResidualDesign, dict[str, Any]]:
        """The design and the settings stored with it under `kind`."""
        stored = load_stored(path, kind)
        try:
            model_arrays: dict[str, Any] = _named(stored.arrays, "model-")
            model = IdentifiedModel(
                **{name: _number(value) for name, value in stored.meta["model"].items()},
                **model_arrays,
            )
            A, B, C, D = (stored.arrays[f"Q-{name}"] for name in "ABCD")
            Q = StateSpace(A, B, C, D, model.sample_time)
            robust_noise = stored.meta.get("robust_noise")
            weight = stored.arrays.get("W_T-num")
            design = cls(
                model=model,
                post_filter=PostFilter(Q=Q, **stored.meta["post_filter"]),
                noise=_noise_of(stored.arrays["noise-ar"], stored.meta["noise"]),
                robust_noise=None if robust_noise is None else _noise_of(np.ones(1), robust_noise),
                W_T=(
                    None
                    if weight is None
                    else TransferFunction(weight, stored.arrays["W_T-den"], model.sample_time)
                ),
                peaks=_named(stored.arrays, "peaks-"),
                **{name: _number(value) for name, value in stored.meta["design"].items()},
            )
            return design, dict(stored.meta["settings"])
        except (KeyError, TypeError) as error:
            raise BadInput(
                f"{path}: is not a residual design, as `residuum residual design` writes one:"
                f" {error}"
            ) from None


_FILTER_NUMBERS = tuple(item.name for item in fields(PostFilter) if item.name != "Q")
_NUMBERS = (
    "method",
    "gamma",
    "fault",
    "input_mean",
    "output_mean",
    "input_bound",
    "noise_bound",
    "structured_p",
)


@one_thread_if_small(LARGEST_FOR_ONE_THREAD)
def design_residual(
    model: IdentifiedModel,
    W_T: TransferFunction | None,
    healthy: Sequence[Record] = (),
    *,
    fault: FaultKind = "sensor",
    gamma: float = 0.1,
    method: str = ROBUST,
) -> ResidualDesign:
    """Design the detector of an identified model; Algorithm 5 of the source, then all that healthy
    records teach.

    `method` other than "robust" takes the post-filter from `classical_filters`: observer, kalman,
    parity or h-infinity.

    Without healthy records the noise is what the model says (white of variance σ², or its H), and
    the bounds and the calibrated threshold are not known.

    Raises
    ------
    BadModel
        W_T is unstable or improper, γ ≤ 0; for a classical method an unstable model.
    BadInput
        No such method.
    BadRecord, BadUnit
        A healthy record of another rate, unit or channel, or with input and output swapped.
    """
    plant = StateSpace.from_transfer_function(model.transfer_function())
    factors = left_coprime(plant)
    if method == ROBUST:
        post_filter = approximate_fault_detection(factors, W_T, fault=fault, gamma=gamma)
    else:
        inputs = [record.in_unit(model.input_name, model.input_unit) for record in healthy]
        size = float(np.nanvar(np.concatenate(inputs))) if inputs else 1.0
        post_filter = classical_filter(
            method, Given.of(plant, factors, W_T, size, model.noise_variance, fault)
        )
        gamma = post_filter.gamma
    noise = model_noise(model)
    bare = ResidualDesign(
        model=model,
        post_filter=post_filter,
        noise=noise,
        W_T=W_T,
        gamma=gamma,
        fault=fault,
        output_mean=model.offset,
        method=method,
    )
    return with_healthy_records(bare, healthy) if healthy else bare


def model_noise(model: IdentifiedModel) -> NoiseModel:
    """The noise that an identified model claims, as an autoregression."""
    freedom = float(model.provenance.get("n", np.inf))
    if model.noise_numerator is None or model.noise_denominator is None:
        return NoiseModel(np.ones(1), float(np.sqrt(model.noise_variance)), freedom=freedom)
    # H⁻¹ as an impulse response, cut where it has died out: the whitening filter
    impulse = np.concatenate([[1.0], np.zeros(200)])
    inverse = signal.lfilter(model.noise_denominator, model.noise_numerator, impulse)
    length = int(np.flatnonzero(np.abs(inverse) > 1e-6)[-1]) + 1
    return NoiseModel(inverse[:length], float(np.sqrt(model.noise_variance)), freedom=freedom)


def with_healthy_records(design: ResidualDesign, healthy: Sequence[Record]) -> ResidualDesign:
    """The design with operating point, noise model, bounds and peaks taken from healthy records."""
    for record in healthy:
        design.refuse_swapped(record)
    pairs = [design.signals_of(record) for record in healthy]
    # Each step runs what the one before has found: the operating point before the noise about it,
    # the noise model before the scores that it whitens, those before their healthy peaks.
    centred = _at_operating_point(design, healthy, pairs)
    inputs = [u - centred.input_mean for u, _ in pairs]
    primary = [_primary(centred.generator, u, y) for u, y in pairs]
    noise = with_unbiased_size(fit_noise_model(primary), inputs, primary, design.model)
    whitened = _replaced(centred, noise=with_healthy_tail(noise, primary))
    signals = [whitened.generator.run(u, y) for u, y in pairs]
    robust_noise = _robust_noise(whitened, [u for u, _ in pairs], signals)
    complete = _replaced(whitened, robust_noise=robust_noise)
    return _replaced(
        complete,
        peaks=_healthy_peaks(complete, signals),
        input_bound=float(np.nanmax([np.nanmax(np.abs(u)) for u in inputs])),
        noise_bound=float(max(np.nanmax(np.abs(part)) for part in primary)),
        structured_p=_structured_p(complete, signals),
    )


def _at_operating_point(
    design: ResidualDesign,
    healthy: Sequence[Record],
    pairs: Sequence[tuple[FloatArray, FloatArray]],
) -> ResidualDesign:
    """The design with the mean input, and the output mean at which the healthy residual has none.

    The model's static gain gives the output's mean but for the level that the residual then shows.
    """
    input_mean = float(np.nanmean(np.concatenate([u for u, _ in pairs])))
    gain = float(design.model.frequency_response([0.0])[0].real)
    first = _replaced(
        design, input_mean=input_mean, output_mean=design.model.offset + gain * input_mean
    )
    before = np.concatenate([_primary(first.generator, u, y) for u, y in pairs])
    if not np.isfinite(before).any():
        raise NotIdentifiable(
            f"residual design: the model remembers {first.generator.warm_up} samples, and no"
            f" healthy record has more on end ({', '.join(str(r.n) for r in healthy)} samples,"
            " holes counted); give longer ones, or identify a shorter response"
        )
    return _replaced(first, output_mean=first.output_mean + float(np.nanmean(before)))


def _healthy_peaks(
    design: ResidualDesign, signals: Sequence[ResidualSignals]
) -> dict[str, FloatArray]:
    """Peaks of every evaluation over blocks of the healthy records, for the calibrated
    threshold.
    """
    valid = [part.valid for part in signals]
    return {
        name: block_peaks([evaluate(name, design.bank, part) for part in signals], valid)
        for name in EVALUATIONS
    }


def _robust_noise(
    design: ResidualDesign, inputs: Sequence[FloatArray], signals: Sequence[ResidualSignals]
) -> NoiseModel:
    """Law of the noise in one sample of the robust residual."""
    errors = [
        design.robust_error(np.where(np.isnan(u), design.input_mean, u))[part.valid]
        for u, part in zip(inputs, signals, strict=True)
    ]
    robust = [np.where(part.valid, part.robust, np.nan) for part in signals]
    return single_sample_law(robust, design.robust_spread, np.concatenate(errors))


def _primary(generator: ResidualGenerator, u: FloatArray, y: FloatArray) -> FloatArray:
    """Primary residual, NaN where the memory is not full."""
    signals = generator.run(u, y)
    return np.where(signals.valid, signals.primary, np.nan)


def _structured_p(design: ResidualDesign, signals: Sequence[ResidualSignals]) -> float:
    """Chance of at least this many alarms over the healthy records, were the model right (0.3
    expected).
    """
    n = sum(int(part.valid.sum()) for part in signals)
    if n == 0:
        return 1.0
    expected = 0.3
    alarms = 0
    # a bank a record: alarms of a right model are rare and nearly independent, so Poisson
    for part in signals:
        bank = design.bank(bank_threshold(min(expected / n, 0.01)))
        alarms += int(bank.process(part).alarm.sum())
    return float(stats.poisson.sf(alarms - 1, expected)) if alarms else 1.0


def _replaced(design: ResidualDesign, **changes: Any) -> ResidualDesign:
    return ResidualDesign(
        **{item.name: getattr(design, item.name) for item in fields(design)} | changes
    )


def _arrays_and_numbers(
    values: Mapping[str, Any],
) -> tuple[dict[str, FloatArray], dict[str, Any]]:
    """Values by name, parted in what is stored as an array and what as JSON."""
    arrays, numbers = {}, {}
    for name, value in values.items():
        if isinstance(value, np.ndarray):
            arrays[name] = value
        else:
            numbers[name] = _jsonable(value)
    return arrays, numbers


def _noise_numbers(noise: NoiseModel) -> dict[str, Any]:
    numbers = {name: _jsonable(getattr(noise, name)) for name in _NOISE_NUMBERS}
    return numbers | {"tail": None if noise.tail is None else asdict(noise.tail)}


def _noise_of(ar: FloatArray, numbers: Mapping[str, Any]) -> NoiseModel:
    known = {name: _number(value) for name, value in numbers.items() if name != "tail"}
    tail = numbers.get("tail")
    return NoiseModel(ar, **known, tail=None if tail is None else HazardTail(**tail))


def _jsonable(value: Any) -> Any:
    # JSON has no infinity, which bounds that are not known are
    if isinstance(value, float) and not np.isfinite(value):
        return {"float": repr(value)}
    if isinstance(value, tuple):
        return list(value)
    if hasattr(value, "items"):
        return {name: _jsonable(item) for name, item in value.items()}
    return value.item() if isinstance(value, np.generic) else value


def _named(arrays: Mapping[str, FloatArray], prefix: str) -> dict[str, FloatArray]:
    """The arrays whose name begins so, by the rest of their name."""
    return {
        name.removeprefix(prefix): value
        for name, value in arrays.items()
        if name.startswith(prefix)
    }


def _number(value: Any) -> Any:
    return float(value["float"]) if isinstance(value, dict) and value.keys() == {"float"} else value


def refuse_other_rate(record: Record, sample_time: float) -> None:
    """BadRecord for a record that was not sampled as a design was."""
    if abs(record.sample_time / sample_time - 1.0) > _RATE_TOLERANCE:
        raise BadRecord(
            f"record {record.source!r}: sample time {record.sample_time:g} s; the design needs"
            f" {sample_time:g} s"
        )
