"""Innovations of coloured, heavy-tailed noise: A(q) v = e with e Student-t, one noise an output.

Real innovations have outliers (a step between two samples, a lost packet, a knock). With the t distribution each is one
unlikely sample; with the normal one a few of them set the variance, and every effect drowns in it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from scipy.special import gammaln

from residuum.identification.discrepancy.coloured_noise import ColouredNoise, forgetting, longest_memory
from residuum.identification.discrepancy.innovation_sums import FREEDOM, reweighted, scale_of, squared_scale

FloatArray = npt.NDArray[np.float64]

ORDER = 12
"""Of the autoregressive noise."""
_REWEIGHTINGS = 3
_NORMAL = FREEDOM / (FREEDOM - 2.0)
"""Variance of t-distributed innovations over their squared scale."""
_DRIFT = 1e6
"""Samples over which drifting noise forgets: longer than any record, short enough to be stable."""

Noises = tuple[ColouredNoise | None, ...]
"""The noise of each output (`innovation_variance` is the squared scale); None for an output that was not measured."""


def fit_noises(
    residuals: Sequence[FloatArray],
    order: int = ORDER,
    *,
    drifting: bool = False,
    near: Noises | None = None,
    reading: FloatArray | None = None,
) -> Noises:
    """The noise of every output's residuals (one array (n, outputs) an experiment, NaN where missing).

    Noise that is `drifting` may be integrated (a load that walks at random); other noise forgets within the data.
    Autoregression by iteratively reweighted least squares, the maximum likelihood of t-distributed innovations; a noise it
    is `near` saves one turn. `reading` are the variances of what coarse steps hide of each output.
    """
    signals = [[r[:, o] for r in residuals] for o in range(residuals[0].shape[1])]
    known = [None] * len(signals) if near is None else near
    floors = np.zeros(len(signals)) if reading is None else reading
    each = zip(signals, known, floors.tolist(), strict=True)
    return tuple(_fit(signal, order, drifting, noise, floor) for signal, noise, floor in each)


def _fit(signals: list[FloatArray], order: int, drifting: bool, near: ColouredNoise | None, floor: float) -> ColouredNoise | None:
    known = sum(int(np.isfinite(v).sum()) for v in signals)
    if known == 0:
        return None
    longest = max(len(v) for v in signals)
    a, variance, turns = np.zeros(max(0, min(order, longest // 4, known // 20))), 0.0, _REWEIGHTINGS
    if near is not None and near.order == a.size:
        a, variance, turns = near.a, near.innovation_variance, _REWEIGHTINGS - 1
    x, starts = np.concatenate(signals), np.cumsum([0, *map(len, signals)])
    a, variance = reweighted(x, starts, a, variance, turns, floor)
    limited = forgetting(a, _DRIFT if drifting else longest_memory(known, longest))
    return ColouredNoise(limited, variance if limited is a else scale_of(x, starts, limited, variance))


def scale(e: FloatArray, near: float = 0.0) -> float:
    """Maximum-likelihood scale of t-distributed innovations, sought from the squared scale `near` on (0: anywhere)."""
    return float(np.sqrt(squared_scale(e, near)))


def likelihood_weights(e: FloatArray, variance: float) -> FloatArray:
    """Weight of each innovation of an experiment in the likelihood's normal equations.

    (ν + 1)/(ν + e²/s²) over s². The first sample is no innovation but a sum of many, and normal: without its stationary
    density an initial state that decays as the noise does would cost nothing, whatever its size.
    """
    weights = (FREEDOM + 1.0) / (FREEDOM + e**2 / variance) / variance
    weights[:1] = 1.0 / (_NORMAL * variance)
    return np.asarray(weights)


def log_density(e: FloatArray, s: float) -> FloatArray:
    """Log density of t-distributed innovations of scale s."""
    constant = gammaln((FREEDOM + 1) / 2) - gammaln(FREEDOM / 2) - 0.5 * np.log(FREEDOM * np.pi) - np.log(s)
    return np.asarray(constant - 0.5 * (FREEDOM + 1) * np.log1p((e / s) ** 2 / FREEDOM))


def pointwise_log_likelihood(residuals: Sequence[FloatArray], noises: Noises) -> FloatArray:
    """Log-likelihood of each sample at the best scale, outputs one after the other; 0 where a measurement is missing.

    It is exact: the first samples of an experiment have the stationary density of the noise.
    """
    found = []
    for o, noise in enumerate(noises):
        if noise is None:
            continue
        each = [noise.innovations(r[:, o]) for r in residuals]
        known = np.concatenate([e[np.isfinite(e)] for e in each])
        if known.size:
            s = scale(known, noise.innovation_variance)
            found += [_log_likelihoods(e, s) - np.isfinite(e) * noise.log_spreads(len(e)) for e in each]
    return np.concatenate(found)


def _log_likelihoods(e: FloatArray, s: float) -> FloatArray:
    known = np.isfinite(e)
    values = np.where(known, log_density(np.where(known, e, 0.0), s), 0.0)
    if known[0]:
        values[0] = -0.5 * (np.log(2.0 * np.pi * _NORMAL * s**2) + e[0] ** 2 / (_NORMAL * s**2))
    return values
