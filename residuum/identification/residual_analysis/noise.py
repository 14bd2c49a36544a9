"""Noise of a channel: its floor, its colour, its innovations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.recursive_filter import all_pole
from residuum.identification.residual_analysis.policy import (
    ABOVE_A_DRIFT,
    AGREED,
    COLOURS,
    DRIFT_MEMORY,
    DRIFTS,
    FEWEST_FOR_A_FLOOR,
    FREEDOM,
    INNOVATION_STRETCH,
    LARGEST_REFLECTION,
    LEAST_SPREAD,
    LOG_DENSITY_AT_ZERO,
    LOWEST_FREQUENCY,
    MEDIAN_SQUARE,
    MEMORY_OF_ALL,
    MEMORY_OF_THE_LONGEST,
    NOISE_ORDER,
    NOISE_REWEIGHTINGS,
    SCALINGS,
    SHORTEST_MEMORY,
    SPECTRUM_SAMPLES,
    STILL_LIKELY,
    ZERO_INNOVATION,
)
from residuum.kept_loops import njit

# Compiled recursions over an autoregression's coefficients: its poles, and the predictors of a
# signal's first samples.


@njit(error_model="numpy")
def within(a, radius):  # type: ignore[no-untyped-def]  # compiled
    """Coefficients of A(z) with its zeros drawn onto the circle of this radius where they lie
    beyond, and whether any did.
    """
    if stable(a / radius ** np.arange(1, a.shape[0] + 1)):
        return a, False
    expanded = np.zeros(a.shape[0] + 1, dtype=np.complex128)
    expanded[0] = 1.0
    polynomial = np.ones(a.shape[0] + 1, dtype=np.complex128)
    polynomial[1:] = a
    for number, root in enumerate(np.roots(polynomial)):
        size = abs(root)
        drawn = root * (radius / size) if size > radius else root
        for k in range(number + 1, 0, -1):
            expanded[k] -= drawn * expanded[k - 1]
    return expanded[1:].real.copy(), True


@njit(error_model="numpy")
def first_predictors(a, stable):  # type: ignore[no-untyped-def]  # compiled
    """Levinson's recursion downwards: rows of the scaled predictors of the first p samples, and the
    logarithms of their spreads.

    Reflection coefficients are kept within ±`stable`.
    """
    order = a.shape[0]
    rows, spreads, spread, a = np.zeros((order, order)), np.zeros(order), 0.0, a.copy()
    for k in range(order, 0, -1):
        reflection = min(max(a[k - 1], -stable), stable)
        left = 1.0 - reflection**2
        spread -= 0.5 * np.log(left)
        a = (a[: k - 1] - reflection * a[: k - 1][::-1]) / left
        rows[k - 1, : k - 1] = np.exp(-spread) * a[::-1]
        rows[k - 1, k - 1] = np.exp(-spread)
        spreads[k - 1] = spread
    return rows, spreads


@njit(error_model="numpy")
def stable(a):  # type: ignore[no-untyped-def]  # compiled
    """Whether all poles of 1/A(z) lie within the unit circle (Levinson's recursion downwards:
    reflections below one).
    """
    a = a.copy()
    for k in range(a.shape[0], 0, -1):
        reflection = a[k - 1]
        if not abs(reflection) < 1.0:
            return False
        a = (a[: k - 1] - reflection * a[: k - 1][::-1]) / (1.0 - reflection**2)
    return True


# Compiled sums over innovations: autoregression, whitening, normal equations and likelihood of
# t-distributed noise.
# They run without the interpreter's lock, so that candidates are judged side by side.

_FAST = {"reassoc", "contract", "arcp"}  # sums in any order; missing samples stay NaN


@njit(error_model="numpy", fastmath=_FAST)
def whitened(rows, a):  # type: ignore[no-untyped-def]  # compiled
    """A(z) x of each row x without the first p samples, shape (rows, n − p); NaN where one of its
    samples is missing.
    """
    order, count, n = a.shape[0], rows.shape[0], rows.shape[1]
    innovations = np.empty((count, max(n - order, 0)))
    for row in range(count):
        whiten(rows[row], a, innovations[row])
    return innovations


@njit(error_model="numpy", fastmath=_FAST)
def whiten(x, a, e):  # type: ignore[no-untyped-def]  # compiled
    """e(t) = x(t) + Σ aᵢ x(t − i) from the sample p on, lag by lag in stretches that stay in the
    cache.
    """
    order = a.shape[0]
    for begin in range(0, e.shape[0], INNOVATION_STRETCH):
        end = min(begin + INNOVATION_STRETCH, e.shape[0])
        stretch = e[begin:end]
        stretch[:] = x[begin + order : end + order]
        for lag in range(order):
            past, factor = x[begin + order - lag - 1 :], a[lag]
            for t in range(stretch.shape[0]):
                stretch[t] += factor * past[t]


@njit(error_model="numpy", fastmath=_FAST)
def add_lag_products(v, a, variance, G, g):  # type: ignore[no-untyped-def]  # compiled
    """Add Σ w·φφᵀ (its lower half) to G and Σ w·φ·v(t) to g, where φ = v(t−1) … v(t−p). w is the
    weight of Student's t of the innovation (1 for variance 0, 0 where a sample is missing).

    Returns how many complete rows there were.
    """
    order, rows, count = a.shape[0], 0, v.shape[0] - a.shape[0]
    if count <= 0:
        return 0
    w, known, innovations = np.empty(count), np.empty(v.shape[0]), np.empty(count)
    whiten(v, a, innovations)
    for t in range(v.shape[0]):
        known[t] = v[t] if np.isfinite(v[t]) else 0.0
    for t in range(count):
        e = innovations[t]
        complete = np.isfinite(e)
        rows += complete
        # Student's weight (ν + 1)/(ν + e²/s²); without a scale yet all count alike
        w[t] = (
            0.0
            if not complete
            else (1.0 if variance == 0.0 else (FREEDOM + 1.0) / (FREEDOM + e * e / variance))
        )
    weighted = np.empty(count)
    for i in range(order):
        past = known[order - i - 1 :]
        for t in range(count):
            weighted[t] = w[t] * past[t]
        g[i] += product(weighted, known[order:], count)
        for j in range(i + 1):
            G[i, j] += product(weighted, known[order - j - 1 :], count)
    return rows


@njit(error_model="numpy", fastmath=_FAST)
def product(x, y, count):  # type: ignore[no-untyped-def]  # compiled
    """Σ x·y over the first `count` samples."""
    sum_ = 0.0
    for t in range(count):
        sum_ += x[t] * y[t]
    return sum_


@njit(error_model="numpy", fastmath=_FAST)
def squared_scale(e, near, floor):  # type: ignore[no-untyped-def]  # compiled
    """Maximum-likelihood squared scale of t-distributed innovations (none missing), sought from
    `near` on (0: anywhere).

    It is at least a part of `floor`, the variance that coarse steps hide; and where most
    innovations are zero (a machine that stands) a part of theirs. Otherwise the likelihood has no
    top.
    """
    n = e.shape[0]
    square = e * e
    mean, zeros = np.mean(square), 0
    for power in square:
        zeros += power <= ZERO_INNOVATION * mean
    least = max(LEAST_SPREAD * max(mean if 2 * zeros > n else 0.0, floor), 1e-300)
    variance = near
    if near == 0.0:
        variance = max(np.median(square) / MEDIAN_SQUARE, 1e-24 * mean)
    variance = max(variance, least)
    for _ in range(SCALINGS):
        sum_ = 0.0
        for t in range(n):
            sum_ += (FREEDOM + 1.0) * square[t] / (FREEDOM + square[t] / variance)
        before, variance = variance, max(sum_ / n, least)
        if abs(variance - before) < 1e-6 * before:
            break
    return variance


@njit(error_model="numpy")
def scale_of(x, starts, a, near, floor):  # type: ignore[no-untyped-def]  # compiled
    """`squared_scale` of the innovations A(z) x of several signals, signal j being x[starts[j]] …
    x[starts[j + 1] − 1].
    """
    e, count = np.empty(x.shape[0]), 0
    for j in range(starts.shape[0] - 1):
        v = x[starts[j] : starts[j + 1]]
        innovations = np.empty(max(v.shape[0] - a.shape[0], 0))
        whiten(v, a, innovations)
        for innovation in innovations:
            if np.isfinite(innovation):
                e[count] = innovation
                count += 1
    return squared_scale(e[:count], near, floor)


@njit(error_model="numpy")
def reweighted(x, starts, a, variance, turns, floor):  # type: ignore[no-untyped-def]  # compiled
    """Coefficients and squared scale after so many turns of reweighted least squares, signals laid
    out as in `scale_of`.

    White noise of the variance `floor` is taken to lie over the signals, beside what they show of
    it. No coefficients where missing samples leave too few complete rows for them.
    """
    order = a.shape[0]
    for _ in range(turns):
        G, g, rows = np.zeros((order, order)), np.zeros(order), 0
        for j in range(starts.shape[0] - 1):
            rows += add_lag_products(x[starts[j] : starts[j + 1]], a, variance, G, g)
        if rows < 3 * (order + 1):
            return np.zeros(0), scale_of(x, starts, np.zeros(0), 0.0, floor)
        if order:
            ridge = 1e-10 * (np.trace(G) + 1e-300) + floor * rows
            for i in range(order):
                for j in range(i):
                    G[j, i] = G[i, j]
                G[i, i] += ridge
            a = -np.linalg.solve(G, g)
        variance = scale_of(x, starts, a, variance, floor)
    return a, variance


@njit(error_model="numpy")
def autoregression(x, starts, a, variance, turns, floor, radius):  # type: ignore[no-untyped-def]  # compiled
    """`reweighted`, its poles kept within the circle of this radius and the scale found again where
    that moved them.
    """
    a, variance = reweighted(x, starts, a, variance, turns, floor)
    a, moved = within(a, radius)
    return a, scale_of(x, starts, a, variance, floor) if moved else variance


@njit(error_model="numpy")
def log_density(e, s):  # type: ignore[no-untyped-def]  # compiled
    """Log density of t-distributed innovations of scale s."""
    constant = LOG_DENSITY_AT_ZERO - np.log(s)
    return constant - 0.5 * (FREEDOM + 1.0) * np.log1p((e / s) ** 2 / FREEDOM)


# Autoregressive model of coloured noise, and whitening with it.


@dataclass(frozen=True, eq=False)
class ColouredNoise:
    """v(k) + a₁ v(k−1) + … + a_p v(k−p) = e(k), e white with variance σ².

    Parameters
    ----------
    a : array, shape (p,)
        Coefficients of the whitening filter A(z) = 1 + a₁ z⁻¹ + …, all roots inside the unit
        circle.
    innovation_variance : float
        σ², in the square of the signal's unit.
    floor : float
        Variance that coarse steps of a reading hide; σ² is a part of it at least.
    """

    a: FloatArray
    innovation_variance: float
    floor: float = 0.0

    @property
    def order(self) -> int:
        """Number of coefficients p."""
        return int(self.a.shape[0])

    def whiten(self, x: FloatArray) -> FloatArray:
        """A(z) x along axis 0, without the first p samples; shape (n − p, …). NaN spreads over p
        samples.
        """
        rows = np.ascontiguousarray(np.reshape(x, (len(x), -1)).T, dtype=float)
        return np.asarray(whitened(rows, self.a).T.reshape(-1, *x.shape[1:]))

    def innovations(self, x: FloatArray) -> FloatArray:
        """A(z) x along axis 0 with the first p samples too: each has its own predictor from those
        before it, and is scaled to the innovations' variance. Shape of x; NaN spreads over p
        samples.
        """
        known = min(self.order, len(x))
        return np.concatenate(
            [np.tensordot(self.first[0][:known, :known], x[:known], 1), self.whiten(x)]
        )

    @cached_property
    def first(self) -> tuple[FloatArray, FloatArray]:
        """Rows of the scaled predictors of the first p samples (Levinson's recursion), and the
        logarithms of how far their errors spread, over the innovations.
        """
        rows, spreads = first_predictors(self.a, LARGEST_REFLECTION)
        return np.asarray(rows), np.asarray(spreads)

    def simulate(self, n: int, rng: np.random.Generator) -> FloatArray:
        """A realisation of v of n samples, after a run-in that forgets the zero start."""
        run_in = min(20_000, int(10 * self.time_constant) + 10 * self.order)
        e = rng.normal(scale=np.sqrt(self.innovation_variance), size=n + run_in)
        return all_pole(np.r_[1.0, self.a], e)[run_in:]

    @property
    def time_constant(self) -> float:
        """Samples after which the slowest mode has decayed to 1/e."""
        if self.order == 0:
            return 0.0
        slowest = float(np.abs(np.roots(np.r_[1.0, self.a])).max())
        return 0.0 if slowest <= 0 else 1.0 / max(-np.log(min(slowest, 1 - 1e-12)), 1e-12)


def fit_coloured_noise(
    segments: Sequence[FloatArray], order: int | None = None, *, highest_order: int = 16
) -> ColouredNoise:
    """Fit the AR model by Burg's method to signal segments (no product is taken across a seam).

    Parameters
    ----------
    segments : sequence of arrays, shapes (n_i,)
        Parts of one signal without missing samples; their means are not removed.
    order : int or None
        p; None chooses it in 0 … `highest_order` by Akaike's criterion.

    Raises
    ------
    BadInput
        No segment is longer than the order.

    References
    ----------
    J. P. Burg, *Maximum entropy spectral analysis*, Stanford 1975: the lattice recursion is stable
    by construction, and less biased near the unit circle than Yule–Walker.
    """
    limit = highest_order if order is None else order
    usable = [np.asarray(segment, dtype=float) for segment in segments if len(segment) > 2 * limit]
    if not usable:
        raise BadInput(
            f"coloured noise of order {limit}: needs a stretch of more than {2 * limit} samples"
            " without a gap"
        )
    candidates = _burg(usable, limit)
    if order is not None:
        return ColouredNoise(*candidates[order])
    n = sum(map(len, usable))
    akaike = [
        n * np.log(max(variance, 1e-300)) + 2 * len(coefficients)
        for coefficients, variance in candidates
    ]
    return ColouredNoise(*candidates[int(np.argmin(akaike))])


def _burg(segments: list[FloatArray], highest_order: int) -> list[tuple[FloatArray, float]]:
    """Coefficients and innovation variance of every order from 0 on, by Burg's lattice."""
    power = sum(float(segment @ segment) for segment in segments) / sum(map(len, segments))
    forward, backward = segments, segments
    a = np.zeros(0)
    models = [(a, power)]
    for _ in range(highest_order):
        # errors of the predictions forwards f(t) and backwards b(t − 1), where both are there
        forward = [f[1:] for f in forward]
        backward = [b[:-1] for b in backward]
        pairs = list(zip(forward, backward, strict=True))
        # the reflection coefficient with the least Σ f² + b² of the next order: |k| ≤ 1, so stable
        cross = sum(float(f @ b) for f, b in pairs)
        energy = sum(float(f @ f) + float(b @ b) for f, b in pairs)
        k = -2.0 * cross / energy if energy > 0 else 0.0
        # Levinson's recursion to the coefficients of the next order
        a = np.r_[a, 0.0] + k * np.r_[a[::-1], 1.0]
        power *= 1.0 - k * k
        forward = [f + k * b for f, b in pairs]
        backward = [b + k * f for f, b in pairs]
        models.append((a, power))
    return models


def stretches(present: npt.NDArray[np.bool_]) -> list[slice]:
    """The runs of True in a mask, as slices in order."""
    edges = np.flatnonzero(np.diff(np.r_[False, present, False].astype(np.int8)))
    return [
        slice(int(start), int(stop)) for start, stop in zip(edges[::2], edges[1::2], strict=True)
    ]


def longest_memory(samples: int, longest: int) -> float:
    """Samples over which noise may remember: a thirtieth of all, a fifth of the longest record.

    What is slower cannot be told from an error of the model, and must not be called noise.
    """
    return min(samples / MEMORY_OF_ALL, longest / MEMORY_OF_THE_LONGEST)


def pole_radius(memory: float) -> float:
    """Largest pole of noise that forgets over `memory` samples."""
    return float(np.exp(-1.0 / max(memory, SHORTEST_MEMORY)))


def forgetting(a: FloatArray, memory: float) -> FloatArray:
    """The autoregression with its poles kept within the radius that forgets over `memory`
    samples.
    """
    return np.asarray(within(a, pole_radius(memory))[0])


# Innovations of coloured, heavy-tailed noise: A(q) v = e with e Student-t, one noise an output.
# Real innovations have outliers (a step between two samples, a lost packet, a knock). With the t
# distribution each is one unlikely sample; with the normal one a few of them set the variance,
# and every effect drowns in it.

Noises = tuple[ColouredNoise | None, ...]
"""The noise of each output (`innovation_variance` is the squared scale); None for an output that
was not measured.
"""


def fit_noises(
    residuals: Sequence[FloatArray],
    order: int = NOISE_ORDER,
    *,
    drifting: bool = False,
    near: Noises | None = None,
    reading: FloatArray | None = None,
) -> Noises:
    """The noise of every output's residuals (one array (n, outputs) an experiment, NaN where
    missing).

    Noise that is `drifting` may be integrated (a load that walks at random); other noise forgets
    within the data. Autoregression by iteratively reweighted least squares, the maximum likelihood
    of t-distributed innovations; a noise it is `near` saves one turn. `reading` are the variances
    of what coarse steps hide of each output.
    """
    signals = [[r[:, o] for r in residuals] for o in range(residuals[0].shape[1])]
    known = [None] * len(signals) if near is None else near
    floors = np.zeros(len(signals)) if reading is None else reading
    per_output = zip(signals, known, floors.tolist(), strict=True)
    return tuple(_fit(signal, order, drifting, noise, floor) for signal, noise, floor in per_output)


def _fit(
    signals: list[FloatArray], order: int, drifting: bool, near: ColouredNoise | None, floor: float
) -> ColouredNoise | None:
    x, starts = _end_to_end(signals)
    known = int(np.isfinite(x).sum())
    if known == 0:
        return None
    longest = max(map(len, signals))
    # twenty samples a coefficient, four times as long a signal: of fewer the order is lowered
    a = np.zeros(max(0, min(order, longest // 4, known // 20)))
    variance, turns = 0.0, NOISE_REWEIGHTINGS
    if near is not None and near.order == a.size:
        a, variance, turns = near.a, near.innovation_variance, NOISE_REWEIGHTINGS - 1
    radius = pole_radius(DRIFT_MEMORY if drifting else longest_memory(known, longest))
    a, variance = autoregression(x, starts, a, variance, turns, floor, radius)
    return ColouredNoise(a, variance, floor)


def _end_to_end(signals: Sequence[FloatArray]) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Several signals in one, and where each of them starts in it and the last one ends."""
    return np.concatenate(signals), np.cumsum([0, *map(len, signals)])


# Noise floor of a channel: how much of a model's error can be measurement noise.


def noise_floor(
    residuals: Sequence[FloatArray],
    slowest: float = 1.0,
    lowest: Sequence[float] = (LOWEST_FREQUENCY,),
) -> float:
    """RMS of the noise in a model's error, read from its fast part alone.

    A model's error is slow against the sampling rate, noise is not: an AR(1) spectrum σ²(1 − ρ²)/|1
    − ρ e^{−jω}|² is fitted (Whittle's likelihood) to the periodogram above 2 % of the sampling rate
    and σ is given, its slow part included.

    Parameters
    ----------
    residuals : sequence of arrays, shapes (n_r,)
        Measured minus modelled, NaN where missing.
    slowest : float
        Largest ρ that is still called noise.
    lowest : sequence of float
        Where the fast part may begin, in parts of the sampling rate: the least σ is given.

    Returns
    -------
    σ in the channel's unit, at most the RMS of the residuals; 0 for an error without a fast part;
    the RMS itself for fewer than 64 samples in a row.

    Notes
    -----
    Fast errors of the model (ripple, switching) count as noise. For noise slower than ρ ≈ 0.99 it
    is a lower bound.

    References
    ----------
    P. Whittle, *Estimation and information in stationary time series*, Ark. Mat. 2 (1953).
    """
    parts, rms = _parts_and_rms(residuals)
    if not parts:
        return rms
    length = min(SPECTRUM_SAMPLES, *(len(part) for part in parts))
    spectra = [_spectra(_windows(part, length)).mean(axis=0) for part in parts]
    weights = np.array([len(part) for part in parts], dtype=float)
    power = np.average(spectra, axis=0, weights=weights)
    colours, variances = COLOURS[max(slowest, 0.0) >= COLOURS], []
    for begin in lowest:
        frequency, fast = _fast_frequencies(length, begin)
        variances.append(_whittle_variance(frequency[fast], power[fast], colours))
    return min(rms, float(np.sqrt(min(variances))))


@dataclass(frozen=True)
class Floor:
    """RMS of the noise in an error; `at_most` where the error's own tail may be as large: the noise
    is then that or less.
    """

    rms: float
    at_most: bool


def floor_under_drift(residuals: Sequence[FloatArray]) -> Floor:
    """The noise in an error that drifts, steps and lags, told as a size where the spectrum tells
    it, else as a bound.

    Above 5 % of the sampling rate a structured error is the tail of what it does below: c |1 −
    e^{−jω}|^{−2} for steps and walks, the power −4 for what passed through a machine. Beside it
    stands AR(1) noise of variance σ². Every pair (ρ, c) gives its likeliest σ; all that are nearly
    as likely as the best are believed. Where they agree within a quarter their middle is the noise,
    otherwise the largest is a bound: the tail of a walk and slow noise are alike.

    Of 144 drawn errors (noise white, coloured, quantised; error none, ramp, sine, drift, steps,
    lagged steps, lagged noise, walk) 106 were told as a size, all within 20 %, and none of the
    bounds was under .9 of the noise.

    Parameters
    ----------
    residuals : sequence of arrays, shapes (n_r,)
        Measured minus modelled, NaN where missing.

    References
    ----------
    P. Whittle, *Estimation and information in stationary time series*, Ark. Mat. 2 (1953).
    """
    parts, rms = _parts_and_rms(residuals)
    if not parts:
        return Floor(rms, at_most=True)
    # shorter windows than those of the floor: how likely a reading is needs many of them
    length = min(SPECTRUM_SAMPLES // 2, *(len(part) for part in parts))
    windows = np.concatenate([_windows(part, length) for part in parts])
    frequency, fast = _fast_frequencies(length, ABOVE_A_DRIFT)
    sizes, cost = _whittle_sizes(frequency[fast], _spectra(windows)[:, fast].mean(axis=0))
    if not sizes.size:
        return Floor(0.0, at_most=False)
    # Hann windows that overlap by half: 1.05 of them count as one, and so do 1.5 of the frequencies
    independent = len(windows) / 1.05 * fast.sum() / 1.5
    believed = np.minimum(sizes[2.0 * independent * (cost - cost.min()) < STILL_LIKELY], rms)
    least, largest = float(believed.min()), float(believed.max())
    if largest > AGREED * least:
        return Floor(largest, at_most=True)
    return Floor(float(np.sqrt(least * largest)), at_most=False)


def _parts_and_rms(residuals: Sequence[FloatArray]) -> tuple[list[FloatArray], float]:
    """The stretches without a missing sample that are long enough, and the RMS of all samples."""
    every = np.concatenate([residual[np.isfinite(residual)] for residual in residuals])
    rms = float(np.sqrt(np.mean(every**2))) if every.size else 0.0
    return [part for residual in residuals for part in _whole_parts(residual)], rms


def _whittle_sizes(frequency: FloatArray, power: FloatArray) -> tuple[FloatArray, FloatArray]:
    """σ of AR(1) noise beside a power of the frequency, and what its fit costs, of every colour and
    tail.
    """
    step = np.abs(1.0 - np.exp(-2j * np.pi * frequency)) ** 2
    sizes, costs = [], []
    # tails with the powers −2 and −4 of the frequency, beside noise of every second colour
    for slow in (DRIFTS[:, None] / step, DRIFTS[:, None] / step**2):
        for rho in COLOURS[::2]:
            shape = (1 - rho**2) / np.abs(1 - rho * np.exp(-2j * np.pi * frequency)) ** 2 + slow
            # the likeliest σ² of a shape is the mean ratio (halved: the spectrum is one-sided), and
            # with it Whittle's −log L is Σ log shape + n log σ²
            variance = np.mean(power / shape, axis=1) / 2.0
            if np.all(variance > 0):
                sizes.append(np.sqrt(variance))
                costs.append(np.mean(np.log(shape), axis=1) + np.log(variance))
    return (np.concatenate(sizes), np.concatenate(costs)) if sizes else (np.zeros(0), np.zeros(0))


def fast_floor(residuals: Sequence[FloatArray]) -> float:
    """`noise_floor` of noise that is no slower than the residuals can show; 0 if not measured."""
    samples = sum(int(np.isfinite(residual).sum()) for residual in residuals)
    memory = longest_memory(samples, max(map(len, residuals)))
    return noise_floor(residuals, pole_radius(memory)) if samples else 0.0


def times_the_noise(residuals: Sequence[FloatArray]) -> float:
    """RMS of an output's residuals over its `fast_floor`; 0 if not measured."""
    known = np.concatenate([residual[np.isfinite(residual)] for residual in residuals])
    floor = fast_floor(residuals)
    return float(np.sqrt(np.mean(known**2))) / floor if floor > 0 else 0.0


def _whole_parts(residual: FloatArray) -> list[FloatArray]:
    return [
        residual[part]
        for part in stretches(np.isfinite(residual))
        if part.stop - part.start >= FEWEST_FOR_A_FLOOR
    ]


def _windows(part: FloatArray, length: int) -> FloatArray:
    """Stretches of this length, each half over the next; shape (windows, length)."""
    return np.asarray(
        np.lib.stride_tricks.sliding_window_view(part, length)[:: length - length // 2]
    )


def _spectra(windows: FloatArray) -> FloatArray:
    """One-sided power of each window a unit of relative frequency: its straight line taken out,
    under a Hann window (Welch).
    """
    length = windows.shape[1]
    slope = np.arange(length) - 0.5 * (length - 1)
    line = np.stack([np.full(length, length**-0.5), slope / np.linalg.norm(slope)])
    taper = 0.5 - 0.5 * np.cos(2.0 * np.pi * np.arange(length) / length)
    detrended = windows - windows @ line.T @ line
    power = np.abs(np.fft.rfft(detrended * taper, axis=1)) ** 2 / np.sum(taper**2)
    power[:, 1 : (length + 1) // 2] *= 2.0
    return np.asarray(power)


def _fast_frequencies(length: int, lowest: float) -> tuple[FloatArray, npt.NDArray[np.bool_]]:
    """Relative frequencies of a window's spectrum, and which of them belong to an error's fast
    part.
    """
    frequency = np.asarray(np.fft.rfftfreq(length), dtype=np.float64)
    return frequency, (frequency >= lowest) & (frequency < 0.5)


def _whittle_variance(frequency: FloatArray, power: FloatArray, colours: FloatArray) -> float:
    """Variance of the AR(1) process whose spectrum fits best (one-sided `power` a unit of relative
    frequency).
    """
    shape = (1 - colours[:, None] ** 2) / np.abs(
        1 - colours[:, None] * np.exp(-2j * np.pi * frequency)
    ) ** 2
    variance = np.mean(power / shape, axis=1) / 2.0
    if not np.all(variance > 0):
        return 0.0
    cost = np.mean(np.log(shape), axis=1) + np.log(variance)
    return float(variance[int(np.argmin(cost))])
