"""A term of a balance as a curve over a signal: what is missing there, and what an effect would
add.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.physics import Experiment, Key, PhysicalModel, Simulator, estimate
from residuum.identification.record import Record
from residuum.identification.residual_analysis.locate import Axis, signal_axes

_FEWEST = 5
_EFFECT_BINS = 80


@dataclass(frozen=True, eq=False)
class Binned:
    """Centres of bins, and the mean and standard deviation of what lies in each, shape (bins,)."""

    at: FloatArray
    mean: FloatArray
    scatter: FloatArray


def binned(x: FloatArray, y: FloatArray, bins: int) -> Binned:
    """y in bins of x, shape (n,) each, sparse bins left out.

    Half of the edges are quantiles and half are evenly spaced: rest and steady speed hold most
    samples, yet the way between them is where the shape is.
    """
    known = np.isfinite(x) & np.isfinite(y)
    x, y = x[known], y[known]
    if x.size == 0:
        return Binned(np.zeros(0), np.zeros(0), np.zeros(0))
    shares = np.linspace(0, 1, bins // 2 + 1)
    edges = np.unique(np.concatenate([np.quantile(x, shares), x.min() + shares * np.ptp(x)]))
    index = np.clip(np.searchsorted(edges, x, side="right") - 1, 0, max(len(edges) - 2, 0))
    count = np.bincount(index)
    full = count >= _FEWEST
    total = np.maximum(count, 1)
    centre, mean, square = (np.bincount(index, weights=w) / total for w in (x, y, y**2))
    return Binned(centre[full], mean[full], np.sqrt(np.maximum(square - mean**2, 0.0))[full])


def joined(axes: Sequence[Sequence[Axis]]) -> list[Axis]:
    """The axes of several records, one record after the other."""
    by_signal = zip(*axes, strict=True)
    return [
        Axis(
            same[0].name, same[0].unit, same[0].kind, np.concatenate([axis.values for axis in same])
        )
        for same in by_signal
    ]


def telling(axes: Sequence[Axis], term: FloatArray, bins: int) -> Axis:
    """The axis over which a curve takes away most of the term's power, shape (n,); the first of
    equals.
    """
    return max(axes, key=lambda axis: _told(binned(axis.values, term, bins), axis.values, term))


def _told(curve: Binned, x: FloatArray, term: FloatArray) -> float:
    """Part of the term's power that the curve tells of other samples than those it was drawn from
    (every second one).
    """
    if len(curve.at) < 2:
        return 0.0
    # halves that lie in each other: both see all places and times
    rows = np.flatnonzero(np.isfinite(x) & np.isfinite(term))
    drawn, held_out = rows[::2], rows[1::2]
    half = binned(x[drawn], term[drawn], len(curve.at))
    power = float(np.sum((term[held_out] - term[held_out].mean()) ** 2))
    if len(half.at) < 2 or not power > 0.0:
        return 0.0
    # on the samples that the curve has not seen: a curve of many bins follows the noise of its own
    missed = term[held_out] - np.interp(x[held_out], half.at, half.mean)
    return 1.0 - float(np.sum(missed**2)) / power


def effect_curves(
    model: PhysicalModel,
    experiments: Sequence[Experiment],
    key: Key,
    values: Mapping[str, float],
    records: Sequence[Record] | None = None,
) -> Iterator[tuple[Axis, Binned]]:
    """What an effect of these values would add to its balance, over every axis of the model's
    simulation with it.

    Nothing for an effect on the path of an input or output, or one with which the model diverges.
    """
    if key.target not in model.balances:
        return
    with_it = model.with_effect(*key, values)
    use = with_it.effects[-1]
    term = f"{key.target}.{use.id}" + (f"#{use.instance}" if use.instance > 1 else "")
    try:
        simulation = estimate(with_it, experiments, free=())
    except BadInput:
        return
    simulator = Simulator(with_it)
    X = [
        simulator.run_vectors(e, x0, simulator.p()).X
        for e, x0 in zip(experiments, simulation.initial, strict=True)
    ]
    value = np.concatenate(
        [simulator.look(e, x)[term] * np.ones(e.n) for e, x in zip(experiments, X, strict=True)]
    )
    known = [None] * len(X) if records is None else records
    for axis in joined(
        [signal_axes(with_it, e, x, r) for e, x, r in zip(experiments, X, known, strict=True)]
    ):
        curve = binned(axis.values, value, _EFFECT_BINS)
        if len(curve.at):
            yield axis, curve
