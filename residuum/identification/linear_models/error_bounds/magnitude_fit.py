"""Bounded magnitude fit: the stable, proper, minimum-phase transfer function at, above or below
magnitude samples.

|W|² is a ratio of two positive cosine polynomials N/D of the angle θ. The best fit in the
log-Chebyshev sense minimises

    t = max_i max(N_i / (M_i² D_i), M_i² D_i / N_i)

a generalised linear fractional programme. The differential correction algorithm solves it to its
global optimum by a few linear programmes (Barrodale, Powell, Roberts, SIAM J. Numer. Anal. 9 (1972)
493–504; Crouzeix, Ferland, Schaible, J. Optim. Theory Appl. 47 (1985) 35–49). The best fit above or
below the samples has the same shape and another gain. Spectral factorisation picks the poles and
zeros inside the unit circle.

Continuous and discrete time share one problem: θ = 2 atan(ν/ν₀) with ν = ω or ν = tan(ω Ts/2) maps
all frequencies to 0…π and keeps order, stability and minimum phase; ν₀ is put where the magnitude
changes, which keeps the polynomials well conditioned over many decades.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt
from numpy.polynomial import chebyshev
from scipy import optimize

from residuum.array_types import ComplexArray, FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.linear_models.transfer_function import TransferFunction

_Ratio = tuple[FloatArray, FloatArray]
Bound = Literal["above", "at", "below"]
_HIGHEST_ORDER = 20
_ORDERS_TRIED = 8
# N and D stay this far above zero, relative to their mean: keeps roots off the unit circle.
_FLOOR = 1e-7
# A correction may shrink N or D at any angle to this fraction at most, so they stay positive
# between the grid's points.
_SLOWEST_SHRINK = 0.02
_MOST_CORRECTIONS = 40
_SMALLEST_GAIN = 1e-4
_FIRST_POINTS = 80
_FINE = 1024
# Relative rounding of a transfer function's polynomials; a bound stays this far beyond its samples.
_ROUNDING = 1e-8


@dataclass(frozen=True)
class _Samples:
    """Frequencies ω of the samples and of points between them, their angles θ and log-powers ln M²,
    and ν₀.
    """

    omega: FloatArray
    theta: FloatArray
    log_power: FloatArray
    centre: float


def fit_magnitude(
    omega: npt.ArrayLike,
    magnitude: npt.ArrayLike,
    *,
    order: int | None = None,
    bound: Bound = "above",
    sample_time: float | None = None,
    tolerance_db: float = 1.0,
) -> TransferFunction:
    """The transfer function of the given order whose magnitude is nearest to the samples in the
    worst decibel.

    Parameters
    ----------
    omega : array, shape (k,)
        Angular frequencies [rad/s], increasing, ≥ 0; in discrete time at most π/Ts.
    magnitude : array, shape (k,)
        Positive samples M. Between them M is taken as linear in (ln ω, ln M), and the bound holds
        there too.
    order : int or None
        Largest number of poles (and zeros). None: the smallest order that is within `tolerance_db`
        of the samples, or from which two more orders gain less than a tenth, at most 8.
    bound : {"above", "at", "below"}
        |W| ≥ M everywhere, |W| around M, or |W| ≤ M everywhere.
    sample_time : float or None
        Sample time [s] of W(z), None for W(s).

    Returns
    -------
    TransferFunction
        Stable, proper and minimum phase; its worst distance is `worst_distance_db`.

    Raises
    ------
    BadInput
        Fewer than two samples, magnitudes not positive, frequencies not increasing or beyond the
        Nyquist frequency.

    Examples
    --------
    >>> omega = np.geomspace(0.01, 100.0, 50)
    >>> truth = TransferFunction([2.0, 1.0], [1.0, 5.0])
    >>> W = fit_magnitude(omega, abs(truth.frequency_response(omega)), order=1, bound="at")
    >>> W.num.round(2).tolist(), W.den.round(2).tolist()
    ([2.0, 1.0], [1.0, 5.0])
    """
    omega, magnitude = _checked(omega, magnitude, order, bound, sample_time)
    samples = _samples(*between_samples(omega, magnitude, 1 if bound == "at" else 4), sample_time)
    fits: list[TransferFunction] = []
    distances: list[float] = []
    highest = _ORDERS_TRIED if order is None else order
    for ratio in _ratios(samples, range(highest + 1)):
        fits.append(_fit(samples, ratio, bound, sample_time))
        distances.append(worst_distance_db(fits[-1], omega, magnitude))
        if order is None and _is_enough(distances, tolerance_db):
            break
    if order is not None or min(distances) <= tolerance_db:
        return fits[int(np.argmin(distances))]
    # no order reaches the tolerance: the smallest within a tenth of the nearest
    near = [k for k, distance in enumerate(distances) if distance <= 1.1 * min(distances)]
    return fits[near[0]]


def _is_enough(distances: list[float], tolerance_db: float) -> bool:
    """Whether the search for an order ends: near enough, or two more orders gained less than a
    tenth.
    """
    if distances[-1] <= tolerance_db:
        return True
    return len(distances) > 4 and distances[-1] > 0.9 * distances[-3]


def worst_distance_db(
    weight: TransferFunction, omega: npt.ArrayLike, magnitude: npt.ArrayLike
) -> float:
    """max |20 log₁₀(|W|/M)| over the samples [dB]."""
    ratio = np.abs(weight.frequency_response(omega)) / np.asarray(magnitude, dtype=float)
    return float(20 * np.abs(np.log10(ratio)).max())


def between_samples(
    omega: FloatArray, magnitude: FloatArray, points: int = 4
) -> tuple[FloatArray, FloatArray]:
    """The samples and `points` − 1 more in every interval, linear in (ln ω, ln M).

    An interval from ω = 0 counts as constant at the larger of its ends.
    """
    fraction = np.arange(points) / points
    start, stop = omega[:-1, None], omega[1:, None]
    with np.errstate(divide="ignore"):
        ratio = np.where(start > 0, np.log(stop) - np.log(start), 0.0)
    between = np.where(
        start > 0, start * np.exp(fraction * ratio), start + fraction * (stop - start)
    )
    low, high = magnitude[:-1, None], magnitude[1:, None]
    level = np.where(
        start > 0,
        low * (high / low) ** fraction,
        np.where(fraction > 0, np.maximum(low, high), low),
    )
    return np.append(between.ravel(), omega[-1]), np.append(level.ravel(), magnitude[-1])


def _fit(
    samples: _Samples, ratio: _Ratio, bound: Bound, sample_time: float | None
) -> TransferFunction:
    zeros, poles = (_unwarp(_inner_roots(polynomial), samples, sample_time) for polynomial in ratio)
    shape = TransferFunction(np.real(np.poly(zeros)), np.real(np.poly(poles)), sample_time)
    distance = 0.5 * samples.log_power - np.log(np.abs(shape.frequency_response(samples.omega)))
    highest, lowest = float(distance.max()), float(distance.min())
    gain = {
        "above": highest + _ROUNDING,
        "below": lowest - _ROUNDING,
        "at": (highest + lowest) / 2,
    }[bound]
    return TransferFunction(shape.num * math.exp(gain), shape.den, sample_time)


def _ratios(samples: _Samples, orders: Iterable[int]) -> Iterator[_Ratio]:
    """The best N and D of each order, every search starting from the result before it."""
    middle = math.exp(
        (samples.log_power.max() + samples.log_power.min()) / 2 - samples.log_power.mean()
    )
    N, D = np.array([middle]), np.ones(1)
    for order in orders:
        missing = np.zeros(order + 1 - len(N))
        N, D = _best_ratio(samples, np.append(N, missing), np.append(D, missing))
        yield N, D


def _best_ratio(samples: _Samples, N: FloatArray, D: FloatArray) -> _Ratio:
    """Cosine coefficients of N and D with the smallest worst ratio t, by differential correction
    from a given pair.

    Each linear programme holds only some of the points; the worst of the others join it.
    """
    order = len(N) - 1
    power = np.exp(samples.log_power - samples.log_power.mean())
    basis = _cosines(samples.theta, order)
    grid = _cosines(np.sort(np.append(np.linspace(0.0, np.pi, _FINE), samples.theta)), order)
    chosen, watched = _spread(len(basis), _FIRST_POINTS), _spread(len(grid), 16 * (order + 1))
    t = _worst_ratio(basis @ N, power * (basis @ D))
    for _ in range(_MOST_CORRECTIONS if order else 0):
        corrected = _correction(basis[chosen], grid[watched], power[chosen], t, N, D)
        if corrected is None:
            break
        numerator, denominator = basis @ corrected[0], power * (basis @ corrected[1])
        dips = _dips(grid @ corrected[0], grid @ N) | _dips(grid @ corrected[1], grid @ D)
        worst = math.inf if dips.any() else _worst_ratio(numerator, denominator)
        joined = _violators(numerator, denominator, chosen)
        gained = math.log(t / worst) if math.isfinite(worst) else -math.inf
        if (
            gained <= _SMALLEST_GAIN
            and not (joined & ~chosen).any()
            and not (dips & ~watched).any()
        ):
            break
        chosen, watched = chosen | joined, watched | dips
        if gained > 0:
            t, (N, D) = worst, corrected
    return N, D


def _spread(size: int, number: int) -> npt.NDArray[np.bool_]:
    """A mask of `number` evenly spread points."""
    mask = np.zeros(size, dtype=bool)
    mask[np.linspace(0, size - 1, min(size, number)).astype(int)] = True
    return mask


def _dips(values: FloatArray, before: FloatArray) -> npt.NDArray[np.bool_]:
    """Local minima of values/before that fall below half of what a correction may shrink to."""
    ratio = values / before
    padded = np.pad(ratio, 1, constant_values=np.inf)
    return np.asarray(
        (ratio <= padded[:-2]) & (ratio <= padded[2:]) & (ratio < 0.5 * _SLOWEST_SHRINK)
    )


def _violators(
    numerator: FloatArray, denominator: FloatArray, chosen: npt.NDArray[np.bool_]
) -> npt.NDArray[np.bool_]:
    """Points whose ratio is a local extreme, and worse than that of every point of the
    programme.
    """
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = np.where(
            (numerator > 0) & (denominator > 0),
            np.abs(np.log(np.abs(numerator / denominator))),
            np.inf,
        )
    padded = np.pad(distance, 1, constant_values=-np.inf)
    peak = (distance >= padded[:-2]) & (distance >= padded[2:])
    return np.asarray(peak & (distance > distance[chosen].max() + _SMALLEST_GAIN))


def _worst_ratio(numerator: FloatArray, denominator: FloatArray) -> float:
    ratio = numerator / denominator
    return float(max(ratio.max(), 1 / ratio.min())) if (ratio > 0).all() else math.inf


def _correction(
    basis: FloatArray, grid: FloatArray, power: FloatArray, t: float, N: FloatArray, D: FloatArray
) -> _Ratio | None:
    """argmin δ over N', D' with N' − t M² D' ≤ δ M² D and M² D' − t N' ≤ δ N; every row is relative
    to the present N, D.
    """
    size = len(N)
    n, d = (basis @ N)[:, None], (basis @ D)[:, None]
    above = np.hstack([basis / (power[:, None] * d), -t * basis / d])
    below = np.hstack([-t * basis / n, power[:, None] * basis / n])
    fit = np.hstack([np.vstack([above, below]) / t, np.full((2 * len(power), 1), -1.0)])
    positive = np.zeros((2 * len(grid), 2 * size + 1))
    positive[: len(grid), :size] = -grid / (grid @ N)[:, None]
    positive[len(grid) :, size:-1] = -grid / (grid @ D)[:, None]
    floors = np.concatenate([_FLOOR * N[0] / (grid @ N), _FLOOR * D[0] / (grid @ D)])
    solution = optimize.linprog(
        np.eye(1, 2 * size + 1, 2 * size)[0],
        A_ub=np.vstack([fit, positive]),
        b_ub=np.concatenate([np.zeros(len(fit)), -np.maximum(_SLOWEST_SHRINK, floors)]),
        A_eq=np.eye(1, 2 * size + 1, size),
        b_eq=[1.0],
        bounds=(None, None),
        method="highs-ds",
    )
    return (solution.x[:size], solution.x[size:-1]) if solution.status == 0 else None


def _inner_roots(coefficients: FloatArray) -> ComplexArray:
    """Roots inside the unit circle of the minimum-phase factor of Σ c_k cos kθ > 0, as many as its
    degree.

    The sum is a Chebyshev series in x = cos θ = (z + 1/z)/2; each root x gives one z inside the
    circle.
    """
    lowest = float(
        (_cosines(np.linspace(0.0, np.pi, 4096), len(coefficients) - 1) @ coefficients).min()
    )
    lifted: FloatArray = coefficients.copy()
    lifted[0] += max(0.0, 0.5 * _FLOOR * abs(coefficients[0]) - lowest)
    lifted = np.asarray(
        chebyshev.chebtrim(lifted, 1e-14 * float(np.abs(lifted).max())), dtype=float
    )
    x = _in_conjugate_pairs(chebyshev.chebroots(lifted).astype(complex))
    root = np.sqrt(x - 1) * np.sqrt(x + 1)
    inner = np.where(np.abs(x - root) < np.abs(x + root), x - root, x + root)
    outside = np.abs(inner) >= 1 - 1e-9
    inner[outside] *= (1 - 1e-9) / np.abs(inner[outside])
    return np.concatenate([inner, np.zeros(len(coefficients) - len(lifted))])


def _in_conjugate_pairs(x: ComplexArray) -> ComplexArray:
    """The roots with those inside (−1, 1) moved off the real axis: between two of them the sum dips
    below nought by rounding.

    On the axis both would give a z of the same half of the unit circle, and the factor would not be
    real.
    """
    dips = np.sort(x[(x.imag == 0.0) & (np.abs(x.real) < 1.0)].real)
    unmoved = x[(x.imag != 0.0) | (np.abs(x.real) >= 1.0)]
    first, second = dips[: len(dips) // 2 * 2 : 2], dips[1::2]
    middle, half = 0.5 * (first + second), np.maximum(0.5 * (second - first), np.finfo(float).tiny)
    # one without a partner lies at an end
    alone = np.where(dips[len(second) * 2 :] < 0.0, -1.0, 1.0)
    return np.concatenate([unmoved, middle + 1j * half, middle - 1j * half, alone])


def _unwarp(roots: ComplexArray, samples: _Samples, sample_time: float | None) -> ComplexArray:
    """Roots in the angle's plane → roots in s, or in z."""
    s = samples.centre * (roots - 1) / (roots + 1)
    return np.asarray(s if sample_time is None else (1 + s) / (1 - s))


def _cosines(theta: FloatArray, order: int) -> FloatArray:
    return np.asarray(np.cos(np.multiply.outer(theta, np.arange(order + 1))))


def _samples(omega: FloatArray, magnitude: FloatArray, sample_time: float | None) -> _Samples:
    nu = (
        omega
        if sample_time is None
        else np.tan(np.minimum(omega * sample_time / 2, np.pi / 2 - 1e-12))
    )
    log_power = 2 * np.log(magnitude)
    inside = (nu > 0) & (nu < 1e9 * np.median(nu[nu > 0]))
    change = (
        np.abs(np.gradient(log_power[inside])) + 1e-6 if inside.sum() > 1 else np.ones(inside.sum())
    )
    centre = float(np.exp(np.average(np.log(nu[inside]), weights=change)))
    return _Samples(omega, 2 * np.arctan(nu / centre), log_power, centre)


def _checked(
    omega: npt.ArrayLike,
    magnitude: npt.ArrayLike,
    order: int | None,
    bound: str,
    sample_time: float | None,
) -> tuple[FloatArray, FloatArray]:
    omega, magnitude = np.asarray(omega, dtype=float), np.asarray(magnitude, dtype=float)
    if omega.ndim != 1 or omega.shape != magnitude.shape or len(omega) < 2:
        raise BadInput(
            f"fit_magnitude: {omega.shape} frequencies, {magnitude.shape} magnitudes; needs equally"
            " many, two or more"
        )
    if not np.isfinite(omega).all() or omega[0] < 0 or (np.diff(omega) <= 0).any():
        raise BadInput("fit_magnitude, omega: must be finite, ≥ 0 and increasing")
    if not np.isfinite(magnitude).all() or (magnitude <= 0).any():
        worst = int(np.argmin(np.where(np.isfinite(magnitude), magnitude, -np.inf)))
        raise BadInput(
            f"fit_magnitude, magnitude: is {magnitude[worst]:g} at {omega[worst]:g} rad/s; must be"
            " positive and finite"
        )
    if sample_time is not None:
        _check_nyquist(float(omega[-1]), sample_time)
    _check_choices(order, bound)
    return omega, magnitude


def _check_choices(order: int | None, bound: str) -> None:
    if order is not None and not 0 <= order <= _HIGHEST_ORDER:
        raise BadInput(f"fit_magnitude, order: is {order}; must lie between 0 and {_HIGHEST_ORDER}")
    if bound not in ("above", "at", "below"):
        raise BadInput(f"fit_magnitude, bound: {bound!r}; must be above, at or below")


def _check_nyquist(highest: float, sample_time: float) -> None:
    if not (sample_time > 0 and highest * sample_time <= np.pi * (1 + 1e-9)):
        raise BadInput(
            f"fit_magnitude: {highest:g} rad/s at sample time {sample_time} s; must not exceed"
            " the Nyquist frequency π/Ts"
        )
