"""One compiled pass over the samples of a likelihood-ratio bank: its windows, and the statistics of Shiryaev and Roberts.

What is scanned and why stands in `likelihood_ratio`. Every statistic is kept as z², the largest of a sample together with what it
says: a *finding* is (z², kind, window), the kind being 0 until z² passes b².
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.diagnosis.residuals.likelihood_ratio.window_model_error import RAMP, STEP, TEMPLATE, mean_square, model_error
from residuum.kept_loops import njit

OFFSET, GAIN, POWER, RAMPED = 1, 2, 3, 4
"""What alarmed; 0 is nothing."""
SHORTEST_GAIN = 4  # over one sample the gain statistic is the offset statistic
SHORTEST_POWER = 8  # below it the cube-root normal of a χ² is too coarse in the far tail, and a ramp is as good as an offset
HEAD_START = 2.2  # A, nats: the Shiryaev–Roberts statistic then gives nine tenths of the false alarms
SHORT, SHORT_START = 2, 1.2  # samples, nats: so that one or two samples find a large offset as soon as a test of single samples
_EPOCH = 65536  # samples after which time is counted anew
_LARGEST_RATIO = 1e300
_LARGEST_SCORE = 600.0  # either way; its exponential, and the inverse of that, still are numbers
_LAZY = 3.0  # a Shiryaev–Roberts statistic below it need not know the model error exactly


class ScanLimits(NamedTuple):
    """What the statistics of windows of these lengths are held against, shape (windows,) each; `square` is b²."""

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
    """Rows (r, m) of a root of the response's covariance, variance of the operating point, lag of the first coefficient."""

    root: FloatArray
    level: float
    delay: int


class ScanMemory(NamedTuple):
    """What a scan remembers; changed in place.

    `sums` (5, ring): running Σ s, Σ s p, Σ p², Σ s², Σ τ s; `past` (2, size): p and the whitened input; `steps` (2, 2): up and
    down, R of Shiryaev and Roberts and the samples since it was below 1; `counts`: samples in the windows, samples in the memory.
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
    return ScanLimits(windows, b * b, spread, power, length * (length + 1.0) * (2.0 * length + 1.0) / 6.0, quantile)


@njit()
def scan(scores, template, white_input, valid, limits, model, memory, restart, statistic, kind, window):  # type: ignore[no-untyped-def]
    """Scan the next samples; `statistic`, `kind` and `window` of each are written, the memory goes on."""
    for t in range(len(scores)):
        now = _remember(memory, template[t], white_input[t])
        if not valid[t]:
            _empty(memory)
            continue
        here, local = _add(memory, scores[t], template[t])
        found = _over_windows(limits, model, memory, now, here, local)
        found = _of_steps(found, limits.square, model, memory, now, scores[t])
        statistic[t], kind[t], window[t] = np.sqrt(found[0]), found[1], found[2]
        if local == _EPOCH:
            _move_origin(memory.sums, here)
        if restart and found[1] > 0:
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
    here, before, local = n % ring, (n - 1) % ring, (n - 1) % _EPOCH + 1
    sums[0, here] = sums[0, before] + s
    sums[1, here] = sums[1, before] + s * p
    sums[2, here] = sums[2, before] + p * p
    sums[3, here] = sums[3, before] + s * s
    sums[4, here] = sums[4, before] + local * s
    memory.counts[0] = n
    return here, local


@njit()
def _larger(found, z2, square, kind, length):  # type: ignore[no-untyped-def]
    """The larger of a finding and of z² of a kind over a window."""
    if z2 <= found[0]:
        return found
    return (z2, kind, length) if z2 > square else (z2, found[1], found[2])


@njit()
def _over_windows(limits, model, memory, now, here, local):  # type: ignore[no-untyped-def]
    """The largest statistic over all windows that end here."""
    sums, ring = memory.sums, memory.sums.shape[1]
    found = (0.0, 0, 0)
    for i in range(len(limits.windows)):
        length = limits.windows[i]
        if length > memory.counts[0]:
            break
        start = here - length
        if start < 0:
            start += ring
        offset = sums[0, here] - sums[0, start]
        begins = 2.0 * SHORT_START if length <= SHORT else 0.0
        found = _matched(found, offset, float(length), begins, OFFSET, STEP, length, limits.square, model, memory, now)
        if length < SHORTEST_GAIN:
            continue
        product, energy = sums[1, here] - sums[1, start], sums[2, here] - sums[2, start]
        if energy > 0.0:
            found = _matched(found, product, energy, 0.0, GAIN, TEMPLATE, length, limits.square, model, memory, now)
        if length < SHORTEST_POWER:
            continue
        ramp = sums[4, here] - sums[4, start] - (local - length) * offset
        found = _matched(found, ramp, limits.ramp_energy[i], 0.0, RAMPED, RAMP, length, limits.square, model, memory, now)
        found = _of_power(found, sums[3, here] - sums[3, start], i, limits, model, memory, now)
    return found


@njit()
def _matched(found, product, energy, begins, kind, shape, length, square, model, memory, now):  # type: ignore[no-untyped-def]
    """(Σ s p)² / (Σ p² + model error) of a template, with a start.

    The model error only lowers it, so it is worked out for the rare windows that would alarm without it.
    """
    if product * product <= (found[0] - begins) * energy:
        return found
    z2 = product * product / energy
    if z2 + begins > square:
        enough = product * product / (square - begins) - energy
        past, (root, level, delay) = memory.past, model
        z2 = product * product / (energy + model_error(past[0], past[1], now, length, delay, root, level, enough, shape))
    return _larger(found, z2 + begins, square, kind, length)


@njit()
def _of_power(found, power, i, limits, model, memory, now):  # type: ignore[no-untyped-def]
    """The score of Σ s² over window i, the model error's share taken out."""
    length, spread = limits.windows[i], limits.spread[i]
    if power <= limits.power[i] or _power_score(power / length, spread) ** 2 <= found[0]:
        return found
    own = mean_square(memory.past[1], now, length, model.delay, model.root)
    z = _power_score(power / (length * (1.0 + limits.quantile * own)), spread)
    return _larger(found, z * z, limits.square, POWER, length) if z > 0.0 else found


@njit()
def _power_score(mean_square, spread):  # type: ignore[no-untyped-def]
    """Standard normal of a mean square χ²_ℓ/ℓ, by its cube root (Wilson and Hilferty); `spread` = 2/(9 ℓ)."""
    return (mean_square ** (1.0 / 3.0) - 1.0 + spread) / np.sqrt(spread)


@njit()
def _of_steps(found, square, model, memory, now, s):  # type: ignore[no-untyped-def]
    """Go on with R of Shiryaev and Roberts for a step up and one down, and the larger of the finding and theirs."""
    steps = memory.steps
    up = np.exp(min(max(s, -_LARGEST_SCORE), _LARGEST_SCORE) - 0.5)
    for side in range(2):
        ratio = min((1.0 + steps[side, 0]) * (up if side == 0 else np.exp(-1.0) / up), _LARGEST_RATIO)
        length = int(steps[side, 1]) + 1 if ratio > 1.0 else 0
        if length >= memory.sums.shape[1]:  # as old as the longest window: what has not shown by now is no step of this size
            ratio, length = 0.0, 0
        steps[side, 0], steps[side, 1] = ratio, length
        if length > 0:
            found = _larger(found, _step_score(np.log(ratio), length, square, model, memory, now), square, OFFSET, length)
    return found


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
def _move_origin(sums: Any, here: int) -> None:
    """Count τ of Σ τ s from here on again, and Σ s from its value here: only differences matter, and they keep their digits."""
    for slot in range(sums.shape[1]):
        sums[4, slot] -= _EPOCH * sums[0, slot]
    for row in range(5):
        level = sums[row, here]
        for slot in range(sums.shape[1]):
            sums[row, slot] -= level
