"""Residuals of plants with several inputs and outputs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import linalg, signal

from residuum.array_types import FloatArray
from residuum.diagnosis.learning.stored import load_stored, save_stored
from residuum.diagnosis.residuals.generators.classical_filters import unknown_input_observer
from residuum.diagnosis.residuals.residual_design import ROBUST, refuse_other_rate
from residuum.diagnosis.systems import balanced_truncation, h_infinity_norm, settled_length
from residuum.identification.errors import BadInput, BadModel, BadRecord
from residuum.identification.kernel_based.multivariable import (
    MultivariableModel,
    multivariable_from,
    multivariable_text,
)
from residuum.identification.linear_models.state_space import StateSpace
from residuum.identification.record import Record
from residuum.nearest_names import known_names

# A vector residual made white: a vector autoregression, and the root of its innovations'
# covariance.

_HIGHEST = 10  # order of the autoregression
_ROWS_A_VALUE = 5
"""Rows of the regression that each of its unknowns needs."""


@dataclass(frozen=True, eq=False)
class VectorWhitener:
    """s(t) = L⁻¹ (r(t) − A₁ r(t−1) − … − A_k r(t−k)), of unit covariance while healthy.

    Parameters
    ----------
    past : array, shape (k, r, r)
        A₁ … A_k; k may be 0.
    root : array, shape (r, r)
        L, lower triangular: L Lᵀ is the covariance of the innovations [unit of the residual²].
    n : int
        Healthy samples it was fitted on.
    """

    past: FloatArray
    root: FloatArray
    n: int = 0

    @classmethod
    def none(cls, size: int) -> VectorWhitener:
        """The one that changes nothing."""
        return cls(np.zeros((0, size, size)), np.eye(size))

    @property
    def innovation_std(self) -> FloatArray:
        """Standard deviations of the innovations, shape (r,)."""
        return np.asarray(np.sqrt(np.sum(self.root**2, axis=1)))

    def after(self, impulse: FloatArray) -> FloatArray:
        """Impulse response of the whitener behind a filter with `impulse`, shape (length, r, p) →
        (length + k, r, p).
        """
        whitened = np.concatenate([impulse, np.zeros((len(self.past), *impulse.shape[1:]))])
        for k, A in enumerate(self.past, start=1):
            whitened[k : k + len(impulse)] -= A @ impulse
        return np.linalg.solve(self.root, whitened)


def fit_whitener(residuals: Sequence[FloatArray]) -> VectorWhitener:
    """Least squares over healthy residuals, each of shape (n, r) with NaN where it is not known;
    order by BIC up to 10.

    Raises BadRecord where too few samples are known, or a residual does not move.
    """
    orders = [order for order in range(_HIGHEST + 1) if _enough(residuals, order)]
    if not orders:
        raise BadRecord(
            "healthy records: too short beyond the model's memory to know the residual's noise;"
            " give longer ones"
        )
    now, past = _all_rows(residuals, orders[-1])  # the same for all orders that are compared
    size = now.shape[1]
    order = min(orders, key=lambda k: _schwarz(now, past[:, : k * size]))
    now, past = _all_rows(residuals, order)
    # rows that the highest order had to leave out join again
    A, covariance = _regressed(now, past)
    return VectorWhitener(
        A.reshape(size, order, size).transpose(1, 0, 2),
        np.asarray(np.linalg.cholesky(covariance)),
        len(now),
    )


def _enough(residuals: Sequence[FloatArray], order: int) -> bool:
    now, _ = _all_rows(residuals, order)
    return len(now) >= max(_ROWS_A_VALUE * (order + 1) * now.shape[1], 50)


def _schwarz(now: FloatArray, past: FloatArray) -> float:
    """Schwarz's criterion of the regression of r(t) on its past."""
    A, _ = _regressed(now, past)
    left = now - past @ A.T
    return len(now) * float(np.linalg.slogdet(left.T @ left / len(now))[1]) + A.size * float(
        np.log(len(now))
    )


def _regressed(now: FloatArray, past: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Coefficients of r(t) by its past, and the covariance of what is left."""
    A = (
        np.asarray(np.linalg.lstsq(past, now, rcond=None)[0].T)
        if past.shape[1]
        else np.zeros((now.shape[1], 0))
    )
    left = now - past @ A.T
    covariance = np.asarray(left.T @ left / (len(now) - past.shape[1]))
    sign, log_determinant = np.linalg.slogdet(covariance)
    if sign <= 0 or not np.isfinite(log_determinant):
        raise BadRecord("healthy records: a residual does not move, or two of them move as one")
    return A, covariance


def _all_rows(residuals: Sequence[FloatArray], order: int) -> tuple[FloatArray, FloatArray]:
    rows = [_rows(part, order) for part in residuals]
    return np.concatenate([now for now, _ in rows]), np.concatenate([past for _, past in rows])


def _rows(r: FloatArray, order: int) -> tuple[FloatArray, FloatArray]:
    """r(t), and r(t−1) … r(t−order) beside each other, where all are known."""
    now = r[order:]
    past = (
        np.concatenate([r[order - k : len(r) - k] for k in range(1, order + 1)], axis=1)
        if order
        else np.zeros((len(r), 0))
    )
    good = np.isfinite(now).all(axis=1) & np.isfinite(past).all(axis=1)
    return now[good], past[good]


# Residual of a plant with several inputs and outputs: r = Q (y − G u), blind to unknown inputs
# where asked, then whitened.

BoolArray = npt.NDArray[np.bool_]
KIND, VERSION = "multivariable-residual-design", 1
UNKNOWN_INPUT = "unknown-input-observer"
METHODS = (ROBUST, UNKNOWN_INPUT)


class VectorResidual(NamedTuple):
    """Of a record: whitened residual s, (n, r), zero where it is not `valid`, (n,), and u about its
    mean, (n, q).
    """

    scores: FloatArray
    valid: BoolArray
    inputs: FloatArray


@dataclass(frozen=True, eq=False, kw_only=True)
class MultivariableResidual:
    """The residual generator of a multivariable plant, with all that its judgement needs.

    With known inputs u and unknown inputs d the plant is y = G_u u + G_d d + noise. The primary
    residual e = y − G_u u is free of u; Q, the unknown input observer's own path from y, takes d
    away too (identity where nothing is unknown), and the whitener makes r = Q e independent
    standard normals. A sensor fault f in output i shows as W Q e_i f, an actuator fault in input j
    as W Q G_j f.

    Parameters
    ----------
    model : MultivariableModel
        With the joint covariance of each output's impulse responses.
    unknown : tuple of str
        Inputs of the model that are not measured while the plant is watched.
    Q : StateSpace
        p outputs of the plant → r residuals; r = p minus the number of unknown inputs.
    whitener : VectorWhitener
    input_mean, output_mean : arrays, shapes (q,), (p,)
        Operating point, of the known inputs and the outputs.
    """

    model: MultivariableModel
    unknown: tuple[str, ...] = ()
    Q: StateSpace
    whitener: VectorWhitener
    input_mean: FloatArray = field(default_factory=lambda: np.zeros(0))
    output_mean: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def method(self) -> str:
        """`unknown-input-observer` where inputs are unknown, else `robust`."""
        return UNKNOWN_INPUT if self.unknown else ROBUST

    @property
    def known(self) -> tuple[int, ...]:
        """Indices of the known inputs."""
        return tuple(j for j, name in enumerate(self.model.inputs) if name not in self.unknown)

    @property
    def sample_time(self) -> float:
        """Sample time [s]."""
        return self.model.models[0][0].sample_time

    @cached_property
    def filter(self) -> FloatArray:
        """Impulse response of whitener and Q together, shape (length, r, p)."""
        return self.whitener.after(self.Q.impulse_response(settled_length(self.Q)))

    @property
    def warm_up(self) -> int:
        """Samples after a start or a gap that are not judged: the memory of the model and of the
        filters.
        """
        return max(path.delay + path.order for row in self.model.models for path in row) + len(
            self.filter
        )

    def residual(self, record: Record) -> VectorResidual:
        """The whitened residual of a record.

        Raises
        ------
        BadRecord
            A channel is absent, or the record has another sample time.
        BadUnit
            A channel's unit cannot be converted.
        """
        u, y = self.signals_of(record)
        missing = _any_missing(u) | _any_missing(y)
        du, dy = np.nan_to_num(u - self.input_mean), np.nan_to_num(y - self.output_mean)
        scores = filtered(self.filter, dy - _response(self.model, self.known, du))
        since = np.arange(len(missing)) - np.maximum.accumulate(
            np.where(missing, np.arange(len(missing)), -1)
        )
        valid = since > self.warm_up
        return VectorResidual(np.where(valid[:, None], scores, 0.0), valid, du)

    def signals_of(self, record: Record) -> tuple[FloatArray, FloatArray]:
        """Known inputs and outputs in the model's units, shapes (n, q), (n, p)."""
        refuse_other_rate(record, self.sample_time)
        first = self.model.models[0]
        u = [record.in_unit(first[j].input_name, first[j].input_unit) for j in self.known]
        y = [record.in_unit(row[0].output_name, row[0].output_unit) for row in self.model.models]
        return np.stack(u, axis=1) if u else np.zeros((record.n, 0)), np.stack(y, axis=1)

    def save(self, path: str | Path) -> None:
        """Store the design (JSON and arrays in a zip)."""
        arrays = {f"Q-{name}": getattr(self.Q, name) for name in "ABCD"}
        arrays |= {"whitener-past": self.whitener.past, "whitener-root": self.whitener.root}
        arrays |= {"input-mean": self.input_mean, "output-mean": self.output_mean}
        meta = {
            "model": multivariable_text(self.model),
            "unknown": list(self.unknown),
            "healthy": self.whitener.n,
        }
        save_stored(path, KIND, VERSION, meta, arrays)

    @classmethod
    def load(cls, path: str | Path) -> MultivariableResidual:
        """The design stored by `save`; BadInput when the file is not one."""
        stored = load_stored(path, KIND)
        try:
            model = multivariable_from(json.loads(stored.meta["model"]), Path(path))
            A, B, C, D = (stored.arrays[f"Q-{name}"] for name in "ABCD")
            whitener = VectorWhitener(
                stored.arrays["whitener-past"],
                stored.arrays["whitener-root"],
                stored.meta["healthy"],
            )
            return cls(
                model=model,
                unknown=tuple(stored.meta["unknown"]),
                Q=StateSpace(A, B, C, D, model.models[0][0].sample_time),
                whitener=whitener,
                input_mean=stored.arrays["input-mean"],
                output_mean=stored.arrays["output-mean"],
            )
        except (KeyError, TypeError, ValueError) as error:
            raise BadInput(
                f"{path}: is not a residual design, as `residuum residual design` writes one:"
                f" {error}"
            ) from None


def design_multivariable_residual(
    model: MultivariableModel,
    healthy: Sequence[Record],
    *,
    method: str = ROBUST,
    unknown: Sequence[str] = (),
) -> MultivariableResidual:
    """The residual generator of a multivariable model; operating point and noise come from healthy
    records.

    Parameters
    ----------
    healthy : sequence of Record
        They may lack the unknown inputs.
    method : str
        `robust`, or `unknown-input-observer` with inputs in `unknown`.
    unknown : sequence of str
        Inputs of the model that will not be measured.

    Raises
    ------
    BadInput
        Another method, an unknown input that the model does not have, no healthy record.
    BadModel
        As many unknown inputs as outputs, or inputs that no observer can tell apart.
    BadRecord, BadUnit
        As in `MultivariableResidual.residual`.
    """
    _check(model, healthy, method, unknown)
    p, step = len(model.models), model.models[0][0].sample_time
    # nothing unknown: every output's residual is its own
    Q = unknown_input_decoupling(model, unknown) if unknown else StateSpace.gain(np.eye(p), step)
    blank = MultivariableResidual(
        model=model, unknown=tuple(unknown), Q=Q, whitener=VectorWhitener.none(Q.D.shape[0])
    )
    pairs = [blank.signals_of(record) for record in healthy]
    input_mean = np.nanmean(np.concatenate([u for u, _ in pairs]), axis=0)
    memory = max(path.delay + path.order for row in model.models for path in row)
    errors = [_error_once_remembered(blank, u - input_mean, y, memory=memory) for u, y in pairs]
    if not any(np.isfinite(error).all(axis=1).any() for error in errors):
        raise BadRecord(
            f"healthy records: none is longer than the model's memory, {memory} samples, without"
            " a gap"
        )
    output_mean = np.nanmean(np.concatenate(errors), axis=0)
    settled = settled_length(Q)
    impulse = Q.impulse_response(settled)
    residuals = []
    for error in errors:
        # the filter remembers a gap as long as it rings
        missing = _dilated(_any_missing(error), settled)
        residual = filtered(impulse, np.nan_to_num(error - output_mean))
        residuals.append(np.where(missing[:, None], np.nan, residual))
    return MultivariableResidual(
        model=model,
        unknown=tuple(unknown),
        Q=Q,
        whitener=fit_whitener(residuals),
        input_mean=input_mean,
        output_mean=output_mean,
    )


def _error_once_remembered(
    design: MultivariableResidual, du: FloatArray, y: FloatArray, *, memory: int
) -> FloatArray:
    """y − G_u u of a record, shape (n, p), NaN where one of the last `memory` inputs is missing."""
    missing = _dilated(_any_missing(du), memory)
    error = y - _response(design.model, design.known, np.nan_to_num(du))
    return np.where(missing[:, None], np.nan, error)


def _check(
    model: MultivariableModel, healthy: Sequence[Record], method: str, unknown: Sequence[str]
) -> None:
    if method not in METHODS:
        raise BadInput(
            f"residual method {method!r}: of a model with several inputs or outputs it must be"
            f" {' or '.join(METHODS)}"
        )
    if (method == UNKNOWN_INPUT) != bool(unknown):
        raise BadInput(
            f"residual method {method!r}: unknown inputs belong to {UNKNOWN_INPUT}, which needs at"
            " least one"
        )
    for name in unknown:
        if name not in model.inputs:
            raise BadInput(
                f"unknown input {name!r}: the model has none of this name;"
                f" {known_names(name, model.inputs, 'there are')}"
            )
    if not healthy:
        raise BadInput(
            "multivariable residual: needs healthy records, for its operating point and its noise"
        )


def filtered(impulse: FloatArray, v: FloatArray) -> FloatArray:
    """Output, shape (n, r), of a filter with this impulse response, shape (length, r, p), to v,
    shape (n, p), from rest.
    """
    columns = [
        sum(signal.oaconvolve(v[:, i], impulse[:, k, i])[: len(v)] for i in range(v.shape[1]))
        for k in range(impulse.shape[1])
    ]
    return np.stack(columns, axis=1)


def _response(model: MultivariableModel, known: Sequence[int], u: FloatArray) -> FloatArray:
    """G_u u, shape (n, p), from rest; u of shape (n, q)."""
    response = np.zeros((len(u), len(model.models)))
    for i, row in enumerate(model.models):
        for column, j in enumerate(known):
            taps = np.r_[np.zeros(row[j].delay), row[j].impulse_response]
            response[:, i] += signal.oaconvolve(u[:, column], taps)[: len(u)]
    return response


def _any_missing(values: FloatArray) -> BoolArray:
    return np.asarray(np.isnan(values).any(axis=1))


def _dilated(missing: BoolArray, memory: int) -> BoolArray:
    """Samples of which one of the last `memory` is gone, or lies before the start."""
    n = len(missing)
    last = np.maximum.accumulate(np.where(missing, np.arange(n), -1))
    return np.asarray(np.arange(n) - last <= memory)


def static_gain(model: MultivariableModel) -> FloatArray:
    """G(1), shape (p, q)."""
    return np.array(
        [[float(np.sum(path.impulse_response)) for path in row] for row in model.models]
    )


def own_response(
    design: MultivariableResidual, place: int, actuator: bool, length: int
) -> FloatArray:
    """What a unit step of a sensor's or an actuator's fault does to the scores from its onset on,
    shape (length, r).
    """
    p = len(design.model.models)
    step = np.zeros((length, p))
    if actuator:
        for i, row in enumerate(design.model.models):
            response = np.cumsum(np.r_[np.zeros(row[place].delay), row[place].impulse_response])
            step[:, i] = np.r_[response, np.full(length, response[-1])][:length]
    else:
        step[:, place] = 1.0
    return filtered(design.filter, step)


# The post-filter that makes the residual of an identified multivariable model blind to inputs that
# are not measured.

_NEGLIGIBLE = 1e-3  # of the paths' gain
_CERTAIN = 4.0
"""Standard deviations by which a first coefficient must differ from zero to be taken for the path's
first.
"""


def unknown_input_decoupling(model: MultivariableModel, unknown: Sequence[str]) -> StateSpace:
    """Q with Q G_d = 0, G_d the paths from the unknown inputs to all outputs: p inputs, p − (number
    of unknown) outputs.

    Q is the unknown input observer's path from y to its residual, taken in the directions that d
    does not reach in one step. Samples by which all paths are late say nothing of Q, since Q z⁻ᵏ
    G_d = 0 is the same condition; they are left out, and the lags before the first coefficient that
    is surely not zero count as such. What the model's own error leaves of d in the residual is not
    known beforehand: healthy records in which d moves teach it as noise.

    Raises
    ------
    BadModel
        As many unknown inputs as outputs, paths that cannot be told apart, or an unstable zero
        common to all of them.
    """
    columns = [model.inputs.index(name) for name in unknown]
    if len(columns) >= len(model.models):
        raise BadModel(
            f"unknown input observer: {len(columns)} unknown inputs use up all {len(model.models)}"
            " outputs; no residual is left"
        )
    paths = [[row[j] for j in columns] for row in model.models]
    late = [
        min(_first(row[k].impulse_response, row[k].std) for row in paths)
        for k in range(len(columns))
    ]
    system = _realised(
        [[path.impulse_response[late[k] :] for k, path in enumerate(row)] for row in paths],
        paths[0][0].sample_time,
    )
    # chains of delays have a state a tap; what the observer needs of them is far smaller
    small = balanced_truncation(system, _NEGLIGIBLE * h_infinity_norm(system)[0]).system
    observer = unknown_input_observer(
        StateSpace(
            small.A,
            np.zeros((small.order, 0)),
            small.C,
            np.zeros((len(paths), 0)),
            small.sample_time,
        ),
        small.B,
    )
    # directions of y that d does not reach in one step: Fᵀ C E = 0
    free = linalg.null_space((small.C @ small.B).T).T
    uio = observer.filter
    return StateSpace(uio.A, uio.B, free @ uio.C, free @ uio.D, uio.sample_time)


def _first(g: FloatArray, std: FloatArray) -> int:
    sure = np.flatnonzero(np.abs(g) > _CERTAIN * std)
    return int(sure[0]) if len(sure) else 0


def _realised(taps: Sequence[Sequence[FloatArray]], sample_time: float) -> StateSpace:
    """Impulse responses from lag 1 on, rows outputs, columns inputs, as a chain of delays an
    input.
    """
    lengths = [max(len(row[k]) for row in taps) for k in range(len(taps[0]))]
    C = [
        np.concatenate([np.r_[g, np.zeros(lengths[k] - len(g))] for k, g in enumerate(row)])
        for row in taps
    ]
    A = linalg.block_diag(*[np.eye(length, k=-1) for length in lengths])
    B = linalg.block_diag(*[np.eye(length, 1) for length in lengths])
    return StateSpace(A, B, np.array(C), np.zeros((len(taps), len(lengths))), sample_time)
