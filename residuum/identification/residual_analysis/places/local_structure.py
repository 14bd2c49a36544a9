"""Is a model's error larger at some place than noise is anywhere: near standstill, at one end of
the travel, after a step?

Noise of any colour has innovations that are alike at all places. So their mean square in a bin of a
signal (speed, position, input, temperature, time) is that of all times χ²(n)/n. A bin far above
that, in which the error itself stands far above that of the quiet half of the record, is structure.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.special import chdtrc

from residuum.array_types import FloatArray
from residuum.identification.linear_models.recursive_filter import all_pole
from residuum.identification.residual_analysis.noise import fit_coloured_noise, stretches
from residuum.identification.residual_analysis.places.locate import Axis
from residuum.identification.residual_analysis.policy import (
    BINS_OF_AN_AXIS,
    COUNTED_IN_A_PLACE,
    FEWEST_FOR_A_PLACE,
    LOCAL_LEVEL,
    LOCAL_OUTLIER,
    LOCAL_TIMES_NOISE,
    NOISE_ORDER,
    SIGNAL_MEMORIES,
)

# Features: simple functions of a model's noise-free signals that a structured error may follow.

Shape = Callable[[FloatArray], FloatArray]


def _step(z: FloatArray) -> FloatArray:
    return np.tanh(z / 0.03)


_ODD: tuple[Shape, ...] = (
    lambda z: z,
    _step,
    lambda z: z * np.abs(z),
    lambda z: z * np.exp(-((z / 0.15) ** 2)),
    np.abs,
)
_SMOOTH: tuple[Shape, ...] = (lambda z: z, np.square, lambda z: z**3)
_SHAPES: Mapping[str, tuple[Shape, ...]] = {
    "velocity": _ODD,
    "current": _ODD[:3],
    "input": (*_ODD[:3], np.square),
    "position": (*_SMOOTH, lambda z: np.sin(2 * np.pi * z), lambda z: np.cos(2 * np.pi * z)),
    "temperature": _SMOOTH,
    "level": (*_SMOOTH, lambda z: np.sqrt(np.abs(z))),
}


def features(axes: Sequence[Axis]) -> FloatArray:
    """Shapes of every axis that has some for its kind, each through three first-order lags, and a
    constant; shape (n, q).

    Signals are scaled by their largest magnitude first, so a shape means the same for every unit.
    """
    n = axes[0].values.shape[0]
    columns = [np.ones(n)]
    for axis in axes:
        largest = float(np.nanmax(np.abs(axis.values), initial=0.0))
        # what rests has columns too: it may move in another record
        scaled = np.nan_to_num(axis.values) / (largest or 1.0)
        columns += [
            _lagged(shape(scaled), pole)
            for shape in _SHAPES.get(axis.kind, ())
            for pole in SIGNAL_MEMORIES
        ]
    return np.stack(columns, axis=1)


def _lagged(x: FloatArray, pole: float) -> FloatArray:
    return x if pole == 0 else all_pole([1.0, -pole], (1.0 - pole) * x)


@dataclass(frozen=True)
class LocalStructure:
    """Where the error stands out most: `axis`, from `low` to `high`, `times_noise` there, and the
    p-value of all places.
    """

    axis: str
    low: float
    high: float
    times_noise: float
    p_value: float

    @property
    def present(self) -> bool:
        """Whether noise does not stand there."""
        return self.p_value < LOCAL_LEVEL and self.times_noise > LOCAL_TIMES_NOISE


def local_structure(
    residuals: Sequence[FloatArray], axes: Sequence[Sequence[Axis]], step: float = 0.0
) -> LocalStructure | None:
    """The place where one output's error stands out most; None where the records are too short or
    their quiet half has no noise.

    Parameters
    ----------
    residuals : sequence of arrays, shapes (n_r,)
        Measured minus modelled output, one array a record; NaN where missing.
    axes : sequence of sequence of Axis
        The signals of each record, the same in all.
    step : float
        The step of a coarse reading: noise that it hides is no larger.

    Notes
    -----
    Fails where noise itself depends on the place (a reading that gets coarser with speed); blind to what is spread evenly.
    """
    known = [np.isfinite(r) for r in residuals]
    r = np.concatenate(
        [residual[finite] for residual, finite in zip(residuals, known, strict=True)]
    )
    if r.size < FEWEST_FOR_A_PLACE:
        return None
    quiet = max(1.4826 * float(np.median(np.abs(r - np.median(r)))), step / np.sqrt(12.0))
    innovations = _innovations(residuals, known)
    usual = 1.4826 * float(np.median(np.abs(innovations)))
    if quiet <= 0.0 or usual <= 0.0:
        return None
    error = np.clip(r - np.median(r), -LOCAL_OUTLIER * quiet, LOCAL_OUTLIER * quiet) ** 2
    power = np.clip(innovations, -LOCAL_OUTLIER * usual, LOCAL_OUTLIER * usual) ** 2
    best: LocalStructure | None = None
    names = [axis.name for axis in axes[0]]
    for k, name in enumerate(names):
        values = np.concatenate(
            [record_axes[k].values[finite] for record_axes, finite in zip(axes, known, strict=True)]
        )
        loudest = _loudest_place(power, error, values, BINS_OF_AN_AXIS * len(names))
        if loudest is not None:
            low, high, p_value, mean = loudest
            place = LocalStructure(name, low, high, float(np.sqrt(mean)) / quiet, p_value)
            best = place if best is None else max(best, place, key=_telling)
    return best


def _telling(place: LocalStructure) -> tuple[bool, float]:
    """Places where noise does not stand before others, the loudest first."""
    certain = place.p_value < LOCAL_LEVEL
    return certain, place.times_noise if certain else -place.p_value


def _loudest_place(
    power: FloatArray, error: FloatArray, values: FloatArray, looks: int
) -> tuple[float, float, float, float] | None:
    """(from, to, p-value of the innovations' `power`, mean square `error`) of the bin that stands
    out most; None where the signal does not move.
    """
    edges = np.unique(
        np.quantile(values[np.isfinite(values)], np.linspace(0.0, 1.0, BINS_OF_AN_AXIS + 1))
    )
    if len(edges) < 3:
        return None
    place = np.clip(np.searchsorted(edges, values, side="right") - 1, 0, len(edges) - 2)
    count = np.bincount(place, minlength=len(edges) - 1).astype(float)
    loud, mean = (
        np.bincount(place, z, minlength=len(edges) - 1) / np.maximum(count, 1.0)
        for z in (power, error)
    )
    freedom = np.maximum(count * COUNTED_IN_A_PLACE, 1.0)
    chance = np.minimum(chdtrc(freedom, freedom * loud / float(power.mean())) * looks, 1.0)
    chance[count == 0] = 1.0
    worst = (
        int(np.argmax(np.where(chance < LOCAL_LEVEL, mean, -1.0)))
        if np.any(chance < LOCAL_LEVEL)
        else int(np.argmin(chance))
    )
    return float(edges[worst]), float(edges[worst + 1]), float(chance[worst]), float(mean[worst])


def _innovations(
    residuals: Sequence[FloatArray], known: Sequence[npt.NDArray[np.bool_]]
) -> FloatArray:
    """What each sample's past does not predict of it, sample by sample of those that are there; 0
    where nothing went before.
    """
    parts = [
        residual[part]
        for residual, finite in zip(residuals, known, strict=True)
        for part in stretches(finite)
    ]
    noise = fit_coloured_noise(parts, min(NOISE_ORDER, max(map(len, parts)) // 20))
    padded = []
    for part in parts:
        e = noise.whiten(part)
        padded.append(np.concatenate([np.zeros(len(part) - len(e)), e]))
    return np.concatenate(padded)
