"""Generalised likelihood ratio over windows of a residual."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt
from scipy import optimize

from residuum.array_types import FloatArray
from residuum.diagnosis.residuals.generators.residual_generator import BoolArray, ResidualSignals
from residuum.diagnosis.thresholds.false_alarm_rate import scan_rate, shiryaev_roberts_rate
from residuum.identification.blas_threads import LARGEST_FOR_ONE_THREAD, one_thread_if_small
from residuum.identification.errors import BadInput
from residuum.kept_loops import njit

# What the error of an identified model adds to a window's statistic, compiled for the scans that
# need it.

STEP, RAMP, TEMPLATE = 0, 1, 2


@njit()
def _last(ring, now, count):  # type: ignore[no-untyped-def]
    """The `count` values of a ring that end at position `now`, oldest first."""
    size = len(ring)
    at = (now - count + 1) % size
    values = np.empty(count)
    for i in range(count):
        values[i] = ring[at]
        at += 1
        if at == size:
            at = 0
    return values


@njit(fastmath={"reassoc"})
def _square_norm(root, w, total, enough):  # type: ignore[no-untyped-def]
    """total + ‖Bᵀ w‖², or a part of it that is `enough`: the largest directions come first, so that
    it soon is.
    """
    for j in range(root.shape[0]):
        row, part = root[j], 0.0
        for k in range(len(w)):
            part += row[k] * w[k]
        total += part * part
        if total > enough:
            break
    return total


@njit()
def model_error(  # type: ignore[no-untyped-def]
    template, white_input, now, count, delay, root, level, enough, shape
):
    """v (Σ p)² + ‖Bᵀ w‖², Σ_g = B Bᵀ, over the `count` samples that end at ring position `now`, or
    a part of it that is `enough`.

    `shape` says whether the fault is a step, a ramp or the template; for a step w follows from lag
    to lag by one sample that enters and one that leaves.
    """
    m = root.shape[1]
    past = _last(white_input, now - delay, count + m)
    w = np.zeros(m)
    sum_p = 0.0
    if shape == STEP:
        sum_p = float(count)
        for i in range(count):
            w[0] += past[m + i]
        for k in range(1, m):
            w[k] = w[k - 1] + past[m - k] - past[m - k + count]
    else:
        shapes = np.arange(1.0, count + 1.0) if shape == RAMP else _last(template, now, count)
        for i in range(count):
            p = shapes[i]
            sum_p += p
            for k in range(m):
                w[k] += p * past[m + i - k]
    return _square_norm(root, w, level * sum_p * sum_p, enough)


@njit()
def mean_square(white_input, now, count, delay, root):  # type: ignore[no-untyped-def]
    """Mean of φᵀ Σ_g φ over (at most eight points of) the window."""
    points, m = min(count, 8), root.shape[1]
    total = 0.0
    for point in range(points):
        phi = _last(white_input, now - (point * count) // points - delay, m)[::-1].copy()
        total = _square_norm(root, phi, total, np.inf)
    return total / points


# One compiled pass over the samples of a likelihood-ratio bank: its windows, and the statistics
# of Shiryaev and Roberts.
# What is scanned and why stands at `LikelihoodRatioBank`. Every statistic is kept as z², the
# largest of a sample together with what it says: a *finding* is (z², kind, window), the kind
# being 0 until z² passes b².

OFFSET, GAIN, POWER, RAMPED = 1, 2, 3, 4
"""What alarmed; 0 is nothing."""
SHORTEST_GAIN = 4  # over one sample the gain statistic is the offset statistic
# below it the cube-root normal of a χ² is too coarse in the far tail, and a ramp is as good as an
# offset
SHORTEST_POWER = 8
# A, nats: the Shiryaev–Roberts statistic then gives nine tenths of the false alarms
HEAD_START = 2.2
# samples, nats: so that one or two samples find a large offset as soon as a test of single samples
# does
SHORT, SHORT_START = 2, 1.2
_EPOCH = 65536  # samples after which time is counted anew
_LARGEST_RATIO = 1e300
_LARGEST_SCORE = 600.0  # either way; its exponential, and the inverse of that, still are numbers
_LAZY = 3.0  # a Shiryaev–Roberts statistic below it need not know the model error exactly


class ScanLimits(NamedTuple):
    """What the statistics of windows of these lengths are held against, shape (windows,) each;
    `square` is b².
    """

    windows: npt.NDArray[np.int64]
    square: float
    spread: FloatArray
    """2/(9 ℓ), of the cube-root normal of a mean square."""
    power: FloatArray
    """Σ s² that passes b where the model is exact."""
    ramp_energy: FloatArray
    """Σ τ² of a ramp 1 … ℓ."""
    quantile: float
    """How far the model error's mean square may exceed its mean, at the same b."""


class ModelError(NamedTuple):
    """Rows (r, m) of a root of the response's covariance, variance of the operating point, lag of
    the first coefficient.
    """

    root: FloatArray
    level: float
    delay: int


class ScanMemory(NamedTuple):
    """What a scan remembers; changed in place.

    `sums` (5, ring): running Σ s, Σ s p, Σ p², Σ s², Σ τ s; `past` (2, size): p and the whitened
    input; `steps` (2, 2): up and down, R of Shiryaev and Roberts and the samples since it was below
    1; `counts`: samples in the windows, samples in the memory.
    """

    sums: FloatArray
    past: FloatArray
    steps: FloatArray
    counts: npt.NDArray[np.int64]


def scan_limits(windows: npt.NDArray[np.int64], b: float, quantile: float) -> ScanLimits:
    """The limits of windows of these lengths [samples] for alarms at |z| > b."""
    length = windows.astype(float)
    spread = 2.0 / (9.0 * length)
    power = length * (1.0 - spread + b * np.sqrt(spread)) ** 3
    return ScanLimits(
        windows,
        b * b,
        spread,
        power,
        length * (length + 1.0) * (2.0 * length + 1.0) / 6.0,
        quantile,
    )


@njit()
def scan(  # type: ignore[no-untyped-def]
    scores, template, white_input, valid, limits, model, memory, restart, statistic, kind, window
):
    """Scan the next samples; `statistic`, `kind` and `window` of each are written, the memory goes
    on.
    """
    for t in range(len(scores)):
        now = _remember(memory, template[t], white_input[t])
        if not valid[t]:
            _empty(memory)
            continue
        head, local = _add(memory, scores[t], template[t])
        largest = _over_windows(limits, model, memory, now, head, local)
        largest = _of_steps(largest, limits.square, model, memory, now, scores[t])
        statistic[t], kind[t], window[t] = np.sqrt(largest[0]), largest[1], largest[2]
        if local == _EPOCH:
            _move_origin(memory.sums, head)
        if restart and largest[1] > 0:
            _empty(memory)


@njit()
def _remember(memory, p, u):  # type: ignore[no-untyped-def]
    """Put a sample of template and whitened input into the past; the place where it stands."""
    now = memory.counts[1] % memory.past.shape[1]
    memory.past[0, now], memory.past[1, now] = p, u
    memory.counts[1] += 1
    return now


@njit()
def _empty(memory):  # type: ignore[no-untyped-def]
    """Begin all windows and statistics anew; the past stays."""
    memory.counts[0] = 0
    memory.sums[:, 0] = 0.0
    memory.steps[:] = 0.0


@njit()
def _add(memory, s, p):  # type: ignore[no-untyped-def]
    """Go on with the running sums; their place now, and the local time τ."""
    sums, n = memory.sums, memory.counts[0] + 1
    ring = sums.shape[1]
    head, before, local = n % ring, (n - 1) % ring, (n - 1) % _EPOCH + 1
    sums[0, head] = sums[0, before] + s
    sums[1, head] = sums[1, before] + s * p
    sums[2, head] = sums[2, before] + p * p
    sums[3, head] = sums[3, before] + s * s
    sums[4, head] = sums[4, before] + local * s
    memory.counts[0] = n
    return head, local


@njit()
def _larger(largest, z2, square, kind, length):  # type: ignore[no-untyped-def]
    """The larger of a finding and of z² of a kind over a window."""
    if z2 <= largest[0]:
        return largest
    return (z2, kind, length) if z2 > square else (z2, largest[1], largest[2])


@njit()
def _over_windows(limits, model, memory, now, head, local):  # type: ignore[no-untyped-def]
    """The largest statistic over all windows that end here."""
    sums, ring = memory.sums, memory.sums.shape[1]
    largest = (0.0, 0, 0)
    for i in range(len(limits.windows)):
        length = limits.windows[i]
        if length > memory.counts[0]:
            break
        start = head - length
        if start < 0:
            start += ring
        offset = sums[0, head] - sums[0, start]
        begins = 2.0 * SHORT_START if length <= SHORT else 0.0
        largest = _matched(
            largest,
            offset,
            float(length),
            begins,
            OFFSET,
            STEP,
            length,
            limits.square,
            model,
            memory,
            now,
        )
        if length < SHORTEST_GAIN:
            continue
        product, energy = sums[1, head] - sums[1, start], sums[2, head] - sums[2, start]
        if energy > 0.0:
            largest = _matched(
                largest,
                product,
                energy,
                0.0,
                GAIN,
                TEMPLATE,
                length,
                limits.square,
                model,
                memory,
                now,
            )
        if length < SHORTEST_POWER:
            continue
        ramp = sums[4, head] - sums[4, start] - (local - length) * offset
        largest = _matched(
            largest,
            ramp,
            limits.ramp_energy[i],
            0.0,
            RAMPED,
            RAMP,
            length,
            limits.square,
            model,
            memory,
            now,
        )
        largest = _of_power(largest, sums[3, head] - sums[3, start], i, limits, model, memory, now)
    return largest


@njit()
def _matched(  # type: ignore[no-untyped-def]
    largest, product, energy, begins, kind, shape, length, square, model, memory, now
):
    """(Σ s p)² / (Σ p² + model error) of a template, with a start.

    The model error only lowers it, so it is worked out for the rare windows that would alarm
    without it.
    """
    if product * product <= (largest[0] - begins) * energy:
        return largest
    z2 = product * product / energy
    if z2 + begins > square:
        enough = product * product / (square - begins) - energy
        past, (root, level, delay) = memory.past, model
        z2 = (
            product
            * product
            / (
                energy
                + model_error(past[0], past[1], now, length, delay, root, level, enough, shape)
            )
        )
    return _larger(largest, z2 + begins, square, kind, length)


@njit()
def _of_power(largest, power, i, limits, model, memory, now):  # type: ignore[no-untyped-def]
    """The score of Σ s² over window i, the model error's share taken out."""
    length, spread = limits.windows[i], limits.spread[i]
    if power <= limits.power[i] or _power_score(power / length, spread) ** 2 <= largest[0]:
        return largest
    own = mean_square(memory.past[1], now, length, model.delay, model.root)
    z = _power_score(power / (length * (1.0 + limits.quantile * own)), spread)
    return _larger(largest, z * z, limits.square, POWER, length) if z > 0.0 else largest


@njit()
def _power_score(mean_square, spread):  # type: ignore[no-untyped-def]
    """Standard normal of a mean square χ²_ℓ/ℓ, by its cube root (Wilson and Hilferty); `spread` =
    2/(9 ℓ).
    """
    return (mean_square ** (1.0 / 3.0) - 1.0 + spread) / np.sqrt(spread)


@njit()
def _of_steps(largest, square, model, memory, now, s):  # type: ignore[no-untyped-def]
    """Go on with R of Shiryaev and Roberts for a step up and one down, and the larger of the
    finding and theirs.
    """
    steps = memory.steps
    up = np.exp(min(max(s, -_LARGEST_SCORE), _LARGEST_SCORE) - 0.5)
    for side in range(2):
        ratio = min(
            (1.0 + steps[side, 0]) * (up if side == 0 else np.exp(-1.0) / up), _LARGEST_RATIO
        )
        length = int(steps[side, 1]) + 1 if ratio > 1.0 else 0
        # as old as the longest window: what has not shown by now is no step of this size
        if length >= memory.sums.shape[1]:
            ratio, length = 0.0, 0
        steps[side, 0], steps[side, 1] = ratio, length
        if length > 0:
            largest = _larger(
                largest,
                _step_score(np.log(ratio), length, square, model, memory, now),
                square,
                OFFSET,
                length,
            )
    return largest


@njit()
def _step_score(log_ratio, length, square, model, memory, now):  # type: ignore[no-untyped-def]
    """2 (ln R + A), lowered by the model error where it could matter."""
    z2 = 2.0 * (log_ratio + HEAD_START)
    if z2 <= max(square, _LAZY**2):
        return z2
    offset = log_ratio + 0.5 * length
    least = 0.5 * square - HEAD_START + 0.5 * length
    enough = length * (offset * offset / (least * least) - 1.0)
    past, (root, level, delay) = memory.past, model
    error = model_error(past[0], past[1], now, length, delay, root, level, enough, STEP)
    return 2.0 * (offset * np.sqrt(length / (length + error)) - 0.5 * length + HEAD_START)


@njit()
def _move_origin(sums: Any, head: int) -> None:
    """Count τ of Σ τ s from here on again, and Σ s from its value here: only differences matter,
    and they keep their digits.
    """
    for slot in range(sums.shape[1]):
        sums[4, slot] -= _EPOCH * sums[0, slot]
    for row in range(5):
        level = sums[row, head]
        for slot in range(sums.shape[1]):
            sums[row, slot] -= level


# Generalised likelihood ratio over windows: offset, ramp, gain and power of a whitened residual,
# model error allowed for.

LONGEST_WINDOW = 1024
# of the sum of their own rates, what windows, templates and Shiryaev–Roberts alarm together
_SHARE = 0.83


class BankOutput(NamedTuple):
    """Per sample: the largest standardised statistic, what alarmed (0 = nothing) and
    its window [samples].
    """

    statistic: FloatArray
    kind: npt.NDArray[np.int64]
    window: npt.NDArray[np.int64]

    @property
    def alarm(self) -> BoolArray:
        """Samples at which an alarm was given."""
        return np.asarray(self.kind > 0)


def window_lengths(longest: int = LONGEST_WINDOW) -> npt.NDArray[np.int64]:
    """1, 2, 3, 4, 6, 8, 12, … samples: steps of about √2, so that some window is nearly as long as
    any fault has lasted.
    """
    powers = 2 ** np.arange(int(np.log2(longest)) + 1)
    lengths = np.union1d(powers, 3 * powers // 2)
    return np.asarray(lengths[lengths <= longest], dtype=np.int64)


@cache
def bank_threshold(rate: float, longest: int = LONGEST_WINDOW) -> float:
    """b of a bank that alarms `rate` times per sample of independent standard normal scores.

    Windows, templates and Shiryaev–Roberts often cross together: of the sum of their own rates the
    whole bank alarms 0.79 at b = 3.9, 0.82 at 4.3, 0.83 at 4.7 and 5.1 (± 0.02, measured over up to
    3·10⁷ samples; 5·10⁻³ … 2·10⁻⁵ alarms a sample).
    """
    windows = window_lengths(longest).tolist()
    long = [length for length in windows if length >= SHORTEST_POWER]
    short = [length for length in windows if length <= SHORT]
    scans = [
        (2, windows[len(short) :]),
        (2, [length for length in windows if length >= SHORTEST_GAIN]),
        (1, long),
        (2, long),
    ]

    def excess(b: float) -> float:
        scanned = sum(sides * scan_rate(b, lengths) for sides, lengths in scans if lengths)
        scanned += 2.0 * scan_rate(float(np.sqrt(max(b * b - 2.0 * SHORT_START, 0.01))), short)
        alone = scanned + shiryaev_roberts_rate(b * b / 2.0 - HEAD_START, 1.0)
        return float(np.log(_SHARE * alone / rate))

    return float(optimize.brentq(excess, 1.0, 30.0)) if excess(1.0) > 0 else 1.0


class LikelihoodRatioBank:
    """Scans normal scores s(t) for a lasting offset, a ramp, a lost gain and a rise of power, over
    windows of many lengths.

    For a window of ℓ samples and a template p (1 for an offset, 1 … ℓ for a ramp, the whitened
    prediction for a gain),

        z = Σ s p / √(Σ p² + wᵀ Σ_g w + v (Σ p)²),   w = Σ p(t) φ(t),

    is standard normal while healthy: φ(t) is the whitened input at the model's lags and Σ_g the
    covariance of the identified impulse response, so the second term is exactly what the model's
    own uncertainty adds for the input that was applied; the third is what an operating point adds
    that was itself estimated, v being 1/n for n Gaussian samples. z²/2 is the log likelihood ratio
    of a fault of unknown size in that window (Willsky and Jones, 1976), the largest over the
    windows that of a fault of unknown onset. The power scan compares Σ s² with χ²_ℓ by the
    cube-root normal of Wilson and Hilferty. Beside the windows run the statistics of Shiryaev and
    Roberts for an offset of ±1,

        R(t) = (1 + R(t − 1)) exp(±s(t) − ½),

    the likelihood ratio added up over all onsets: of all tests it finds a step of just this size in
    the shortest time on average (Pollak and Tartakovsky, Statistica Sinica 19, 2009). It need not
    guess size and onset, so it may alarm at A = 2.2 nats less, and counts as z = √(2 (ln R + A));
    ln R, too, is lowered by what the model error may add. Offsets over one or two samples have a
    start of 1.2 nats. An alarm is z > b; after it windows and R start empty again.

    The rate of alarms of healthy, independent scores is set through `bank_threshold`. It fails (too
    many alarms) when scores are not independent: a noise colour that changed, or a model with
    structured error.

    Parameters
    ----------
    threshold : float
        b, of `bank_threshold` for a rate of false alarms, or of a calibration.
    covariance : array, shape (m, m)
        Σ_g [(output unit / input unit)²].
    delay : int
        Lag of the first coefficient.
    longest : int
        Longest window [samples].
    level_variance : float
        v: variance of the scores' mean that the operating point's own error makes.
    restart : bool
        Whether the windows start empty after an alarm; False gives the undisturbed statistic.
    """

    def __init__(
        self,
        threshold: float,
        covariance: FloatArray,
        delay: int,
        longest: int = LONGEST_WINDOW,
        *,
        level_variance: float = 0.0,
        restart: bool = True,
    ) -> None:
        if longest < 1:
            raise BadInput(
                f"likelihood-ratio bank, longest: is {longest}; must be at least one sample"
            )
        self.windows = window_lengths(longest)
        self.b = float(threshold)
        self.restart = restart
        self.covariance: FloatArray = np.ascontiguousarray(covariance, dtype=float)
        self._limits = scan_limits(
            self.windows, self.b, _upper_mean_square(self.covariance, self.b)
        )
        self._model = ModelError(
            covariance_root(self.covariance), float(level_variance), int(delay)
        )
        self._ring = int(self.windows[-1]) + 1
        self._memory = self._ring + len(self.covariance) + delay
        self.reset()

    def reset(self) -> None:
        """Empty all windows and forget the input."""
        self._sums: FloatArray = np.zeros((5, self._ring))  # running Σ s, Σ s p, Σ p², Σ s², Σ τ s
        self._past: FloatArray = np.zeros((2, self._memory))  # p and the whitened input
        # up, down: R of Shiryaev and Roberts, and the samples since it was below 1
        self._steps: FloatArray = np.zeros((2, 2))
        self._counts = np.zeros(2, dtype=np.int64)  # samples in the windows, samples in the memory

    def process(self, signals: ResidualSignals) -> BankOutput:
        """Scan the next block; samples that are not valid empty the windows."""
        n = len(signals.scores)
        output = BankOutput(np.zeros(n), np.zeros(n, dtype=np.int64), np.zeros(n, dtype=np.int64))
        inputs = (signals.scores, signals.gain_template, signals.white_input, signals.valid)
        memory = ScanMemory(self._sums, self._past, self._steps, self._counts)
        scan(*inputs, self._limits, self._model, memory, self.restart, *output)
        return output

    @property
    def state(self) -> dict[str, Any]:
        """Everything the scan remembers."""
        return {
            "sums": self._sums.copy(),
            "past": self._past.copy(),
            "steps": self._steps.copy(),
            "counts": self._counts.copy(),
        }

    def resume(self, state: Mapping[str, Any]) -> None:
        """Continue from a saved `state`; BadInput when it is of another bank."""
        if state.keys() != self.state.keys() or any(
            np.shape(state[name]) != np.shape(mine) for name, mine in self.state.items()
        ):
            raise BadInput(
                "likelihood-ratio bank: the saved state is of another design; start anew without it"
            )
        self._sums = np.array(state["sums"], dtype=float)
        self._past = np.array(state["past"], dtype=float)
        self._steps = np.array(state["steps"], dtype=float)
        self._counts = np.array(state["counts"], dtype=np.int64)


@one_thread_if_small(LARGEST_FOR_ONE_THREAD)
def covariance_root(covariance: FloatArray) -> FloatArray:
    """Rows of Bᵀ with Σ_g = B Bᵀ, largest first, shape (r, m); what makes up less than 10⁻⁶ of the
    trace is left out.
    """
    eigenvalues, vectors = np.linalg.eigh(covariance)
    eigenvalues = np.maximum(eigenvalues[::-1], 0.0)
    left = np.cumsum(eigenvalues[::-1])[::-1]
    large = left > 1e-6 * left[0] if left.size and left[0] > 0 else np.zeros(len(left), dtype=bool)
    large[:1] = True
    return np.ascontiguousarray((vectors[:, ::-1][:, large] * np.sqrt(eigenvalues[large])).T)


def _upper_mean_square(covariance: FloatArray, b: float) -> float:
    """How far δᵀ A δ may exceed its mean at the b-sigma level, δ being the model error with this
    covariance.
    """
    trace, square = float(np.trace(covariance)), float(np.sum(covariance**2))
    if trace <= 0.0:
        return 0.0
    spread = 2.0 * square / (9.0 * trace**2)
    return float((1.0 - spread + b * np.sqrt(spread)) ** 3)
