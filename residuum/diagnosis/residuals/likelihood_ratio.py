"""Generalised likelihood ratio over windows: offset, ramp, gain and power of a whitened residual, model error allowed for."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import numba
import numpy as np
import numpy.typing as npt
from scipy import optimize

from residuum.diagnosis.residuals.residual_generator import BoolArray, ResidualSignals
from residuum.diagnosis.residuals.window_model_error import RAMP, STEP, TEMPLATE, mean_square, model_error
from residuum.diagnosis.systems.state_space import FloatArray
from residuum.diagnosis.thresholds.false_alarm_rate import scan_rate, shiryaev_roberts_rate
from residuum.identification.blas_threads import LARGEST, one_thread_if_small
from residuum.identification.errors import BadInput

LONGEST_WINDOW = 1024
KINDS = ("none", "offset", "gain", "power", "ramp")
_SHORTEST_GAIN = 4  # over one sample the gain statistic is the offset statistic
_SHORTEST_POWER = 8  # below it the cube-root normal of a χ² is too coarse in the far tail, and a ramp is as good as an offset
_HEAD_START = 2.2  # A, nats: the Shiryaev–Roberts statistic then gives nine tenths of the false alarms
_SHORT, _SHORT_START = 2, 1.2  # samples, nats: so that one or two samples find a large offset as soon as a test of single samples
_EPOCH = 65536  # samples after which time is counted anew
_SHARE = 0.83  # of the sum of their own rates, what windows, templates and Shiryaev–Roberts alarm together
_LARGEST_RATIO = 1e300
_LARGEST_SCORE = 600.0  # either way; its exponential, and the inverse of that, still are numbers
_LAZY = 3.0  # a Shiryaev–Roberts statistic below it need not know the model error exactly


class BankOutput(NamedTuple):
    """Per sample: the largest standardised statistic, what alarmed (index into `KINDS`, 0 = nothing) and its window [samples]."""

    statistic: FloatArray
    kind: npt.NDArray[np.int64]
    window: npt.NDArray[np.int64]

    @property
    def alarm(self) -> BoolArray:
        """Samples at which an alarm was given."""
        return np.asarray(self.kind > 0)


def window_lengths(longest: int = LONGEST_WINDOW) -> npt.NDArray[np.int64]:
    """1, 2, 3, 4, 6, 8, 12, … samples: steps of about √2, so that some window is nearly as long as any fault has lasted."""
    powers = 2 ** np.arange(int(np.log2(longest)) + 1)
    lengths = np.union1d(powers, 3 * powers // 2)
    return np.asarray(lengths[lengths <= longest], dtype=np.int64)


@cache
def bank_threshold(rate: float, longest: int = LONGEST_WINDOW) -> float:
    """b of a bank that alarms `rate` times per sample of independent standard normal scores.

    Windows, templates and Shiryaev–Roberts often cross together: of the sum of their own rates the whole bank alarms 0.79 at
    b = 3.9, 0.82 at 4.3, 0.83 at 4.7 and 5.1 (± 0.02, measured over up to 3·10⁷ samples; 5·10⁻³ … 2·10⁻⁵ alarms a sample).
    """
    windows = window_lengths(longest).tolist()
    long = [length for length in windows if length >= _SHORTEST_POWER]
    short = [length for length in windows if length <= _SHORT]
    scans = [(2, windows[len(short) :]), (2, [length for length in windows if length >= _SHORTEST_GAIN]), (1, long), (2, long)]

    def excess(b: float) -> float:
        scanned = sum(sides * scan_rate(b, lengths) for sides, lengths in scans if lengths)
        scanned += 2.0 * scan_rate(float(np.sqrt(max(b * b - 2.0 * _SHORT_START, 0.01))), short)
        alone = scanned + shiryaev_roberts_rate(b * b / 2.0 - _HEAD_START, 1.0)
        return float(np.log(_SHARE * alone / rate))

    return float(optimize.brentq(excess, 1.0, 30.0)) if excess(1.0) > 0 else 1.0


class LikelihoodRatioBank:
    """Scans normal scores s(t) for a lasting offset, a ramp, a lost gain and a rise of power, over windows of many lengths.

    For a window of ℓ samples and a template p (1 for an offset, 1 … ℓ for a ramp, the whitened prediction for a gain),

        z = Σ s p / √(Σ p² + wᵀ Σ_g w + v (Σ p)²),   w = Σ p(t) φ(t),

    is standard normal while healthy: φ(t) is the whitened input at the model's lags and Σ_g the covariance of the identified
    impulse response, so the second term is exactly what the model's own uncertainty adds for the input that was applied; the
    third is what an operating point adds that was itself estimated, v being 1/n for n Gaussian samples.
    z²/2 is the log likelihood ratio of a fault of unknown size in that window (Willsky and Jones, 1976), the largest over
    the windows that of a fault of unknown onset. The power scan compares Σ s² with χ²_ℓ by the cube-root normal of Wilson
    and Hilferty. Beside the windows run the statistics of Shiryaev and Roberts for an offset of ±1,

        R(t) = (1 + R(t − 1)) exp(±s(t) − ½),

    the likelihood ratio added up over all onsets: of all tests it finds a step of just this size in the shortest time on
    average (Pollak and Tartakovsky, Statistica Sinica 19, 2009). It need not guess size and onset, so it may alarm at A = 2.2
    nats less, and counts as z = √(2 (ln R + A)); ln R, too, is lowered by what the model error may add. Offsets over one or
    two samples have a start of 1.2 nats. An alarm is z > b; after it windows and R start empty again.

    The rate of alarms of healthy, independent scores is set through `bank_threshold`. It fails (too many alarms) when
    scores are not independent: a noise colour that changed, or a model with structured error.

    Parameters
    ----------
    rate : float
        False alarms per sample.
    covariance : array, shape (m, m)
        Σ_g [(output unit / input unit)²].
    delay : int
        Lag of the first coefficient.
    longest : int
        Longest window [samples].
    threshold : float or None
        b, when it comes from elsewhere (calibration); then `rate` is not used.
    level_variance : float
        v: variance of the scores' mean that the operating point's own error makes.
    restart : bool
        Whether the windows start empty after an alarm; False gives the undisturbed statistic.
    """

    def __init__(
        self,
        rate: float,
        covariance: FloatArray,
        delay: int,
        longest: int = LONGEST_WINDOW,
        *,
        threshold: float | None = None,
        level_variance: float = 0.0,
        restart: bool = True,
    ) -> None:
        if longest < 1:
            raise BadInput(f"likelihood-ratio bank, longest: is {longest}; must be at least one sample")
        self.windows = window_lengths(longest)
        self.b = bank_threshold(rate, longest) if threshold is None else float(threshold)
        self.delay = delay
        self.level_variance = level_variance
        self.restart = restart
        self.covariance: FloatArray = np.ascontiguousarray(covariance, dtype=float)
        self._root = _root(self.covariance)
        self._power_quantile = _upper_mean_square(self.covariance, self.b)
        self._ring = int(self.windows[-1]) + 1
        self._memory = self._ring + len(self.covariance) + delay
        self.reset()

    def reset(self) -> None:
        """Empty all windows and forget the input."""
        self._sums: FloatArray = np.zeros((5, self._ring))  # running Σ s, Σ s p, Σ p², Σ s², Σ τ s
        self._past: FloatArray = np.zeros((2, self._memory))  # p and the whitened input
        self._steps: FloatArray = np.zeros((2, 2))  # up, down: R of Shiryaev and Roberts, and the samples since it was below 1
        self._counts = np.zeros(2, dtype=np.int64)  # samples in the windows, samples in the memory

    def process(self, signals: ResidualSignals) -> BankOutput:
        """Scan the next block; samples that are not valid empty the windows."""
        n = len(signals.scores)
        output = BankOutput(np.zeros(n), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64))
        _scan(
            signals.scores, signals.gain_template, signals.white_input, signals.valid, self.windows, self.b,
            self._root, self.level_variance, self.delay, self._power_quantile, self.restart, self._sums, self._past,
            self._steps, self._counts, *output,
        )  # fmt: skip
        return output

    @property
    def state(self) -> dict[str, Any]:
        """Everything the scan remembers."""
        return {
            "sums": self._sums.copy(), "past": self._past.copy(), "steps": self._steps.copy(), "counts": self._counts.copy()
        }  # fmt: skip

    def resume(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved `state`; BadInput when it is of another bank."""
        if state.keys() != self.state.keys() or any(np.shape(state[name]) != np.shape(mine) for name, mine in self.state.items()):
            raise BadInput("likelihood-ratio bank: the saved state is of another bank")
        self._sums = np.array(state["sums"], dtype=float)
        self._past = np.array(state["past"], dtype=float)
        self._steps = np.array(state["steps"], dtype=float)
        self._counts = np.array(state["counts"], dtype=np.int64)


@one_thread_if_small(LARGEST)
def _root(covariance: FloatArray) -> FloatArray:
    """Rows of Bᵀ with Σ_g = B Bᵀ, largest first, shape (r, m); what makes up less than 10⁻⁶ of the trace is left out."""
    eigenvalues, vectors = np.linalg.eigh(covariance)
    eigenvalues = np.maximum(eigenvalues[::-1], 0.0)
    left = np.cumsum(eigenvalues[::-1])[::-1]
    kept = left > 1e-6 * left[0] if left[0] > 0 else np.zeros(len(left), dtype=bool)
    kept[0] = True
    return np.ascontiguousarray((vectors[:, ::-1][:, kept] * np.sqrt(eigenvalues[kept])).T)


def _upper_mean_square(covariance: FloatArray, b: float) -> float:
    """How far δᵀ A δ may exceed its mean at the b-sigma level, δ being the model error with this covariance."""
    trace, square = float(np.trace(covariance)), float(np.sum(covariance**2))
    if trace <= 0.0:
        return 0.0
    spread = 2.0 * square / (9.0 * trace**2)
    return float((1.0 - spread + b * np.sqrt(spread)) ** 3)


@numba.njit(cache=True)
def _power_score(mean_square, spread):  # type: ignore[no-untyped-def]
    """Standard normal of a mean square χ²_ℓ/ℓ, by its cube root (Wilson and Hilferty); `spread` = 2/(9 ℓ)."""
    return (mean_square ** (1.0 / 3.0) - 1.0 + spread) / np.sqrt(spread)


@numba.njit(cache=True)
def _move_origin(sums, here, ring):  # type: ignore[no-untyped-def]
    """Count τ of Σ τ s from here on again, and Σ s from its value here: only differences matter, and they keep their digits."""
    for slot in range(ring):
        sums[4, slot] -= _EPOCH * sums[0, slot]
    for row in range(5):
        level = sums[row, here]
        for slot in range(ring):
            sums[row, slot] -= level


@numba.njit(cache=True)
def _scan(  # type: ignore[no-untyped-def]  # noqa: PLR0912, PLR0915  one pass over the samples, kept in one loop for speed
    scores,
    template,
    white_input,
    valid,
    windows,
    b,
    root,
    level,
    delay,
    quantile,
    restart,
    sums,
    past,
    both_steps,
    counts,
    statistic,
    kind,
    window,
) -> None:
    ring, size, square, number = sums.shape[1], past.shape[1], b * b, len(windows)
    spread = np.empty(number)
    power_limit = np.empty(number)
    ramp_energy = np.empty(number)
    for i in range(number):
        length = float(windows[i])
        spread[i] = 2.0 / (9.0 * length)
        power_limit[i] = length * (1.0 - spread[i] + b * np.sqrt(spread[i])) ** 3
        ramp_energy[i] = length * (length + 1.0) * (2.0 * length + 1.0) / 6.0
    for t in range(len(scores)):
        now = counts[1] % size
        past[0, now], past[1, now] = template[t], white_input[t]
        counts[1] += 1
        if not valid[t]:
            counts[0] = 0
            sums[:, 0] = 0.0
            both_steps[:] = 0.0
            continue
        n, s, p = counts[0] + 1, scores[t], template[t]
        here, before, local = n % ring, (n - 1) % ring, (n - 1) % _EPOCH + 1
        sums[0, here] = sums[0, before] + s
        sums[1, here] = sums[1, before] + s * p
        sums[2, here] = sums[2, before] + p * p
        sums[3, here] = sums[3, before] + s * s
        sums[4, here] = sums[4, before] + local * s
        counts[0] = n
        sum_s, sum_sp, sum_pp, sum_ss, sum_ts = sums[0, here], sums[1, here], sums[2, here], sums[3, here], sums[4, here]
        largest = 0.0
        for i in range(number):
            length = windows[i]
            if length > n:
                break
            start = here - length
            if start < 0:
                start += ring
            offset = sum_s - sums[0, start]
            z2 = offset * offset / length
            start2 = 2.0 * _SHORT_START if length <= _SHORT else 0.0
            # The model error only lowers z, so it is worked out for the rare windows that would alarm without it.
            if z2 + start2 > largest:
                if z2 + start2 > square:
                    enough = offset * offset / (square - start2) - length
                    error = model_error(past[0], past[1], now, length, delay, root, level, enough, STEP)
                    z2 = offset * offset / (length + error)
                z2 += start2
                if z2 > largest:
                    largest = z2
                    if z2 > square:
                        kind[t], window[t] = 1, length
            if length < _SHORTEST_GAIN:
                continue
            energy = sum_pp - sums[2, start]
            matched = sum_sp - sums[1, start]
            if matched * matched > largest * energy and energy > 0.0:
                z2 = matched * matched / energy
                if z2 > square:
                    enough = matched * matched / square - energy
                    error = model_error(past[0], past[1], now, length, delay, root, level, enough, TEMPLATE)
                    z2 = matched * matched / (energy + error)
                if z2 > largest:
                    largest = z2
                    if z2 > square:
                        kind[t], window[t] = 2, length
            if length < _SHORTEST_POWER:
                continue
            ramp = sum_ts - sums[4, start] - (local - length) * offset
            if ramp * ramp > largest * ramp_energy[i]:
                z2 = ramp * ramp / ramp_energy[i]
                if z2 > square:
                    enough = ramp * ramp / square - ramp_energy[i]
                    error = model_error(past[0], past[1], now, length, delay, root, level, enough, RAMP)
                    z2 = ramp * ramp / (ramp_energy[i] + error)
                if z2 > largest:
                    largest = z2
                    if z2 > square:
                        kind[t], window[t] = 4, length
            power = sum_ss - sums[3, start]
            if power > power_limit[i] and _power_score(power / length, spread[i]) ** 2 > largest:
                power /= length * (1.0 + quantile * mean_square(past[1], now, length, delay, root))
                z = _power_score(power, spread[i])
                if z > 0.0 and z * z > largest:
                    largest = z * z
                    if z > b:
                        kind[t], window[t] = 3, length
        up = np.exp(min(max(s, -_LARGEST_SCORE), _LARGEST_SCORE) - 0.5)
        for side in range(2):
            ratio = min((1.0 + both_steps[side, 0]) * (up if side == 0 else np.exp(-1.0) / up), _LARGEST_RATIO)
            length = int(both_steps[side, 1]) + 1 if ratio > 1.0 else 0
            if length >= ring:  # as old as the longest window: what has not shown by now is no step of this size
                ratio, length = 0.0, 0
            both_steps[side, 0], both_steps[side, 1] = ratio, length
            if length == 0:
                continue
            log_ratio = np.log(ratio)
            z2 = 2.0 * (log_ratio + _HEAD_START)
            if z2 > max(square, _LAZY**2):
                offset = log_ratio + 0.5 * length
                least = 0.5 * square - _HEAD_START + 0.5 * length
                enough = length * (offset * offset / (least * least) - 1.0)
                error = model_error(past[0], past[1], now, length, delay, root, level, enough, STEP)
                z2 = 2.0 * (offset * np.sqrt(length / (length + error)) - 0.5 * length + _HEAD_START)
            if z2 > largest:
                largest = z2
                if z2 > square:
                    kind[t], window[t] = 1, length
        statistic[t] = np.sqrt(largest)
        if local == _EPOCH:
            _move_origin(sums, here, ring)
        if restart and kind[t] > 0:
            counts[0] = 0
            sums[:, 0] = 0.0
            both_steps[:] = 0.0
