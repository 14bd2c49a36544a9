"""Features: simple functions of a model's noise-free signals that a structured error may follow."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.linear_models.recursive_filter import all_pole
from residuum.identification.residual_analysis.places.locate import Axis
from residuum.identification.residual_analysis.policy.noise import SIGNAL_MEMORIES

Shape = Callable[[FloatArray], FloatArray]


def _step(z: FloatArray) -> FloatArray:
    return np.tanh(z / 0.03)


_ODD: tuple[Shape, ...] = (lambda z: z, _step, lambda z: z * np.abs(z), lambda z: z * np.exp(-((z / 0.15) ** 2)), np.abs)
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
    """Shapes of every axis that has some for its kind, each through three first-order lags, and a constant; shape (n, q).

    Signals are scaled by their largest magnitude first, so a shape means the same for every unit.
    """
    n = axes[0].values.shape[0]
    columns = [np.ones(n)]
    for axis in axes:
        largest = float(np.nanmax(np.abs(axis.values), initial=0.0))
        scaled = np.nan_to_num(axis.values) / (largest or 1.0)  # what rests has columns too: it may move in another record
        columns += [_lagged(shape(scaled), pole) for shape in _SHAPES.get(axis.kind, ()) for pole in SIGNAL_MEMORIES]
    return np.stack(columns, axis=1)


def _lagged(x: FloatArray, pole: float) -> FloatArray:
    return x if pole == 0 else all_pole([1.0, -pole], (1.0 - pole) * x)
