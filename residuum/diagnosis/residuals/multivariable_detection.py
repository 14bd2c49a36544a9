"""Detection and isolation on the residual of a multivariable plant: which sensor or actuator, since
when, how large.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt
from scipy import optimize, signal

from residuum.array_types import FloatArray
from residuum.diagnosis.residuals.likelihood_ratio import covariance_root, window_lengths
from residuum.diagnosis.residuals.multivariable import (
    BoolArray,
    MultivariableResidual,
    VectorResidual,
    own_response,
    static_gain,
)
from residuum.diagnosis.thresholds.false_alarm_rate import alarms_per_sample, scan_rate
from residuum.identification.errors import BadInput
from residuum.identification.record import Record

IntArray = npt.NDArray[np.int64]
LONGEST_SCAN = 1024  # samples of the longest window
# a window is looked at each time this part of its length has passed
_EVERY = 8
_AFTER = 1024  # samples after the alarm that tell the fault
_COARSE = 64  # onsets that are tried first
_ALIKE = 3.0  # of log likelihood, to the likeliest: a factor of twenty


@dataclass(frozen=True)
class Hypothesis:
    """A lasting offset of one sensor or one actuator: `kind` is `sensor` or `actuator`, `place` its
    index.
    """

    kind: str
    place: int
    name: str
    unit: str


@dataclass(frozen=True)
class IsolatedFault:
    """The likeliest fault, its size and what explains the residual as well.

    Parameters
    ----------
    hypothesis : Hypothesis
    value, std : float
        Size of the offset [its channel's unit]; the model's own uncertainty is part of `std`.
    onset : int
        Sample of the record at which it began.
    probability : float
        Among all hypotheses, equally likely beforehand.
    indistinguishable_from : tuple of Hypothesis
        Those within 3 units of log likelihood.
    """

    hypothesis: Hypothesis
    value: float
    std: float
    onset: int
    probability: float
    indistinguishable_from: tuple[Hypothesis, ...]


@dataclass(frozen=True, eq=False)
class MultivariableDetection:
    """What the residual of a record says: its statistic, shape (n,), the threshold b, alarms, and
    the fault at the first one.
    """

    residual: VectorResidual
    statistic: FloatArray
    threshold: float
    alarm: BoolArray
    fault: IsolatedFault | None

    @property
    def first_alarm(self) -> int | None:
        """Sample of the first alarm."""
        return int(np.argmax(self.alarm)) if self.alarm.any() else None


def detect_multivariable(
    design: MultivariableResidual, record: Record, *, false_alarms_per_day: float = 1.0
) -> MultivariableDetection:
    r"""Scan the whitened residual s for a lasting offset of every sensor and every known actuator.

    A fault of unit size moves s by f in the end (W Q e_i, or W Q G(1) e_j), so over a window of ℓ
    samples

    .. math::
        z = f^\top \sum s \Big/ \sqrt{\ell |f|^2 + \sum_i w_i^\top \Sigma_i w_i + \ell^2 |f|^2/n}

    is standard normal while healthy: Σ_i is the joint covariance of output i's impulse responses,
    w_i the inputs at the model's lags through the filter and f, summed over the window, and the
    last term is the error of the operating point, learned from n samples. The threshold is such
    that all faults, signs and windows together alarm so often; they are added up as if they never
    alarmed together, so the true rate is lower.

    It fails (too many alarms) when an unknown input is not in the design or moves in ways that no
    healthy record showed.

    Raises
    ------
    BadInput
        The record has no stretch without a gap that is longer than the memory; a false-alarm rate
        out of range.
    BadRecord, BadUnit
        As in `MultivariableResidual.residual`.
    """
    rate = alarms_per_sample(false_alarms_per_day, design.sample_time)
    residual = design.residual(record)
    if not residual.valid.any():
        raise BadInput(
            f"record {record.source!r}: no stretch without a gap is longer than the memory of model"
            f" and filters, {design.warm_up} samples"
        )
    scan = _Scan(design, residual)
    statistic, threshold = scan.statistic(), threshold_of(len(scan.hypotheses), rate)
    alarm = statistic > threshold
    fault = scan.isolated(int(np.argmax(alarm))) if alarm.any() else None
    return MultivariableDetection(residual, statistic, threshold, alarm, fault)


def threshold_of(hypotheses: int, rate: float) -> float:
    """b that the windows of so many hypotheses, of either sign, exceed `rate` times a sample."""
    lengths = window_lengths(LONGEST_SCAN).tolist()

    def excess(b: float) -> float:
        return float(np.log(2.0 * hypotheses * scan_rate(b, lengths) / rate))

    return float(optimize.brentq(excess, 1.0, 30.0)) if excess(1.0) > 0 else 1.0


class _Scan:
    """The statistics of one record."""

    def __init__(self, design: MultivariableResidual, residual: VectorResidual) -> None:
        self.design, self.residual = design, residual
        self.n = len(residual.valid)
        self.roots = [covariance_root(self._known_part(i)) for i in range(len(design.model.models))]
        self.ends = np.concatenate([[0], np.cumsum(residual.valid)])  # valid samples before each

    def _known_part(self, i: int) -> FloatArray:
        paths = self.design.model.models[i]
        starts = np.cumsum([0, *(path.order for path in paths)])
        columns = np.concatenate(
            [np.zeros(0, int), *(np.arange(starts[j], starts[j + 1]) for j in self.design.known)]
        )
        return np.asarray(self.design.model.covariances[i][np.ix_(columns, columns)])

    @cached_property
    def hypotheses(self) -> list[tuple[Hypothesis, FloatArray]]:
        """What is looked for, with what a unit of it does to the scores in the end, shape (r,)."""
        model, direct = self.design.model, self.design.filter.sum(axis=0)
        through = direct @ static_gain(model)
        rows, first = model.models, model.models[0]
        pairs = [
            (Hypothesis("sensor", i, row[0].output_name, row[0].output_unit), direct[:, i])
            for i, row in enumerate(rows)
        ]
        pairs += [
            (Hypothesis("actuator", j, first[j].input_name, first[j].input_unit), through[:, j])
            for j in self.design.known
        ]
        return [(h, f) for h, f in pairs if np.any(f)]

    def statistic(self) -> FloatArray:
        """Largest |z| over faults and windows that end at each sample, shape (n,); zero where none
        ends.
        """
        largest = np.zeros(self.n)
        for _, f in self.hypotheses:
            # all windows by differences of running sums, in the residual as in the inputs
            sums = np.concatenate([[0.0], np.cumsum(self.residual.scores @ f)])
            moved = self._moved(f)
            for length, last in self._windows():
                z = np.abs(sums[last + 1] - sums[last + 1 - length])
                z /= np.sqrt(
                    self._variance(f, length, [m[last + 1] - m[last + 1 - length] for m in moved])
                )
                largest[last] = np.maximum(largest[last], z)
        return largest

    def _windows(self) -> Iterator[tuple[int, IntArray]]:
        """(length, last samples) of the windows without a sample that is not valid."""
        for length in window_lengths(LONGEST_SCAN).tolist():
            last = np.arange(length - 1, self.n, max(1, length // _EVERY))
            whole = self.ends[last + 1] - self.ends[last + 1 - length] == length
            if whole.any():
                yield length, last[whole]

    def _variance(self, f: FloatArray, length: int, w: Sequence[FloatArray]) -> FloatArray:
        own = float(f @ f) * (length + length**2 / max(self.design.whitener.n, 1))
        return np.asarray(own + self._model_error(w))

    def _model_error(self, w: Sequence[FloatArray]) -> FloatArray:
        """Σ_i wᵀ Σ_i w of w, shape (windows, lags), an output each."""
        return np.asarray(
            sum(
                np.sum((w_i @ root.T) ** 2, axis=-1)
                for w_i, root in zip(w, self.roots, strict=True)
            )
        )

    def _moved(self, f: FloatArray) -> list[FloatArray]:
        """For each output the running sums of the inputs at its lags through filter and signature,
        shape (n + 1, lags).
        """
        moved = []
        for i, row in enumerate(self.design.model.models):
            columns = [np.zeros((self.n + 1, 0))]
            for c, j in enumerate(self.design.known):
                taps = self.design.filter[:, :, i] @ f
                through = np.cumsum(signal.oaconvolve(self.residual.inputs[:, c], taps)[: self.n])
                columns.append(_lagged(through, row[j].delay, row[j].order))
            moved.append(np.concatenate(columns, axis=1))
        return moved

    def isolated(self, alarm: int) -> IsolatedFault | None:
        """The fault that explains best what the scores do about an alarm, with its course from the
        onset on.
        """
        stop = min(self.n, alarm + _AFTER)
        broken = np.flatnonzero(~self.residual.valid[alarm:stop])
        stop = alarm + int(broken[0]) if len(broken) else stop
        before = np.flatnonzero(~self.residual.valid[:alarm])
        start = max(int(before[-1]) + 1 if len(before) else 0, alarm - LONGEST_SCAN)
        fits = []
        for h, f in self.hypotheses:
            response = own_response(self.design, h.place, h.kind == "actuator", stop - start)
            constant = self._moved(f)
            coarse = np.unique(np.linspace(start, alarm, _COARSE).astype(int))
            values = {int(k): self._course(response, constant, int(k), stop) for k in coarse}
            best = max(values, key=lambda k: values[k][2])
            step = max(1, (alarm - start) // _COARSE)
            for k in range(max(start, best - step), min(alarm, best + step) + 1):
                values.setdefault(k, self._course(response, constant, k, stop))
            onset = max(values, key=lambda k: values[k][2])
            fits.append((h, onset, *values[onset]))
        likelihood = np.array([fit[4] for fit in fits])
        chosen = int(np.argmax(likelihood))
        # equally likely beforehand: likelihoods are probabilities but for their sum
        weights = np.exp(likelihood - likelihood.max())
        alike = tuple(
            fits[k][0]
            for k in range(len(fits))
            if k != chosen and likelihood[k] > likelihood[chosen] - _ALIKE
        )
        h, onset, value, std, _ = fits[chosen]
        if h.kind == "actuator":
            std = float(np.hypot(std, self._gain_doubt(h, value)))
        return IsolatedFault(h, value, std, onset, float(weights[chosen] / weights.sum()), alike)

    def _gain_doubt(self, h: Hypothesis, value: float) -> float:
        """Part of `std` that the error of the gains from an actuator's input makes: it acts on the
        fault as on the input.
        """
        f = dict(self.hypotheses)[h]
        direct, variance = self.design.filter.sum(axis=0), 0.0
        for i, row in enumerate(self.design.model.models):
            starts = np.cumsum([0, *(path.order for path in row)])
            part = slice(starts[h.place], starts[h.place + 1])
            gain = float(np.sum(self.design.model.covariances[i][part, part]))
            variance += gain * float(direct[:, i] @ f) ** 2
        return abs(value) * float(np.sqrt(variance)) / float(f @ f)

    def _course(
        self, response: FloatArray, constant: Sequence[FloatArray], onset: int, stop: int
    ) -> tuple[float, float, float]:
        """(size, its standard deviation, log likelihood ratio) of a fault that began at `onset`,
        seen until `stop`.

        The model's error is weighed as if the fault's course were its final one; the course's
        beginning is short beside it.
        """
        f = response[: stop - onset]
        power = float(np.sum(f * f))
        if power == 0.0:
            return 0.0, np.inf, 0.0
        correlation = float(np.sum(f * self.residual.scores[onset:stop]))
        length = stop - onset
        final = float(np.sum(response[-1] ** 2))
        scale = power / max(final * length, 1e-300)
        error = (
            float(self._model_error([(m[stop] - m[onset])[None] for m in constant])[0]) * scale**2
        )
        level = power**2 / (max(final, 1e-300) * max(self.design.whitener.n, 1))
        variance = power + error + level
        return (
            correlation / power,
            float(np.sqrt(variance)) / power,
            0.5 * correlation**2 / variance,
        )


def _lagged(running: FloatArray, delay: int, order: int) -> FloatArray:
    """Sums up to each sample of a signal's past at lags delay … delay + order − 1, shape (n + 1,
    order), from running sums.
    """
    n = len(running)
    padded = np.concatenate([np.zeros(delay + order), running])
    # row t: running[t − delay − order … t − delay − 1]
    view = np.lib.stride_tricks.sliding_window_view(padded, order)
    return np.asarray(view[: n + 1, ::-1])
