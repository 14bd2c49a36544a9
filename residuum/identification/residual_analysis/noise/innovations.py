"""Innovations of coloured, heavy-tailed noise: A(q) v = e with e Student-t, one noise an output.

Real innovations have outliers (a step between two samples, a lost packet, a knock). With the t distribution each is one
unlikely sample; with the normal one a few of them set the variance, and every effect drowns in it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.residual_analysis.noise.coloured_noise import ColouredNoise, longest_memory, pole_radius
from residuum.identification.residual_analysis.noise.innovation_sums import autoregression
from residuum.identification.residual_analysis.policy.noise import DRIFT_MEMORY, NOISE_ORDER, NOISE_REWEIGHTINGS

Noises = tuple[ColouredNoise | None, ...]
"""The noise of each output (`innovation_variance` is the squared scale); None for an output that was not measured."""


def fit_noises(
    residuals: Sequence[FloatArray],
    order: int = NOISE_ORDER,
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
    x, starts = _end_to_end(signals)
    known = int(np.isfinite(x).sum())
    if known == 0:
        return None
    longest = max(map(len, signals))
    a, variance, turns = np.zeros(max(0, min(order, longest // 4, known // 20))), 0.0, NOISE_REWEIGHTINGS
    if near is not None and near.order == a.size:
        a, variance, turns = near.a, near.innovation_variance, NOISE_REWEIGHTINGS - 1
    radius = pole_radius(DRIFT_MEMORY if drifting else longest_memory(known, longest))
    a, variance = autoregression(x, starts, a, variance, turns, floor, radius)
    return ColouredNoise(a, variance, floor)


def _end_to_end(signals: Sequence[FloatArray]) -> tuple[FloatArray, npt.NDArray[np.int64]]:
    """Several signals in one, and where each of them starts in it and the last one ends."""
    return np.concatenate(signals), np.cumsum([0, *map(len, signals)])
