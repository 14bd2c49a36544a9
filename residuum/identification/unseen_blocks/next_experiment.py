"""The next experiment: extra sensors and other input profiles, by the power with which they tell
two structures apart.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.physics import Experiment, PhysicalModel
from residuum.identification.unseen_blocks.policy import (
    DISTINCTION_LEVEL,
    HELD_REACH,
    MOST_PROPOSALS,
    MOST_TIMES,
    POWER_WANTED,
)

# Held values: parameters that a model holds fixed, where the records ask for another value.
# A mass that is a tenth too large looks like an elasticity or a load. An estimate of what is free
# cannot mend it, and the likeliest effect stands in for it.

HELD = "value"
"""In the place of an effect's id: a parameter that the model fixes is free."""


@dataclass(frozen=True)
class HeldValue:
    """A parameter's value in the model, where it is fixed, and the one that the records ask for,
    with its standard deviation.

    Of the parameters in `indistinguishable_from` another value would do as much (a mass, or the
    area that drives it).
    """

    name: str
    held: float
    value: float
    std: float
    unit: str
    indistinguishable_from: tuple[str, ...]


def freed(model: PhysicalModel, names: Iterable[str]) -> PhysicalModel:
    """The model with these of its fixed parameters free, within reach of their values."""
    known = dict(model.parameters)
    for name in names:
        p = known[name]
        low, high = sorted(((1.0 - HELD_REACH) * p.value, (1.0 + HELD_REACH) * p.value))
        known[name] = replace(p, fixed=False, lower=max(low, p.lower), upper=min(high, p.upper))
    return replace(model, parameters=known)


_BOTH_WAYS = ("N", "N*m", "V", "A")
"""Units of inputs that a machine can usually reverse: a force, a torque, a voltage, a current; no
heater and no valve.
"""
Power = Callable[[Sequence[Experiment], int | None], float | None]
"""Of the test in these experiments, with one output more seen where that is asked; None when they
could not be simulated.
"""


@dataclass(frozen=True)
class NextExperiment:
    """Something to do, the candidates it separates, and the power with which it does."""

    do: str
    separates: tuple[str, ...]
    power: float


def distinguishing(
    separates: tuple[str, ...],
    model: PhysicalModel,
    experiments: Sequence[Experiment],
    power: Power,
) -> tuple[NextExperiment, ...]:
    """Signals that the model has and the records lack, and other profiles of its inputs, best
    first; then how much more of the same would do.
    """
    measured = np.any([e.measured for e in experiments], axis=0)
    powers = {
        f"also record {name} [{output.unit}]": power(experiments, o)
        for o, (name, output) in enumerate(model.outputs.items())
        if not measured[o]
    }
    powers |= {do: power(profile, None) for do, profile in _profiles(model, experiments).items()}
    proposals = [NextExperiment(do, separates, p) for do, p in powers.items() if p is not None]
    best = sorted(proposals, key=lambda p: -p.power)[:MOST_PROPOSALS]
    times = _times_as_much(power(experiments, None))
    more = (
        []
        if times is None
        else [NextExperiment(f"record {times} times as much of the same", separates, POWER_WANTED)]
    )
    return (*best, *more)


def power_of_test(r: FloatArray, J: FloatArray) -> float:
    """Power of the χ² test, at `DISTINCTION_LEVEL`, on what free parameters with slopes J (n, q)
    cannot absorb of a whitened difference r (n,).
    """
    size = np.linalg.norm(J, axis=0)
    u, s, _ = np.linalg.svd(J[:, size > 0] / size[size > 0], full_matrices=False)
    u = u[:, s > 1e-9 * s.max(initial=0.0)]
    residual = r - u @ (u.T @ r)
    return _exceeds(
        NormalDist().inv_cdf(1.0 - DISTINCTION_LEVEL / 2.0), float(np.sqrt(residual @ residual))
    )


def _times_as_much(power: float | None) -> int | None:
    """How many times the data would tell what these tell with this power, which grows with their
    number; None where they do, or where none would.
    """
    if power is None or not 0.0 < power < POWER_WANTED:
        return None
    normal = NormalDist()
    threshold = normal.inv_cdf(1.0 - DISTINCTION_LEVEL / 2.0)
    shift = threshold + normal.inv_cdf(power)
    times = ((threshold + normal.inv_cdf(POWER_WANTED)) / shift) ** 2 if shift > 0.0 else np.inf
    return int(np.ceil(times)) if times <= MOST_TIMES else None


def _exceeds(threshold: float, shift: float) -> float:
    """Probability of |z + shift| > threshold for normal z: with one degree of freedom this is the
    non-central χ² test's.
    """
    normal = NormalDist()
    return normal.cdf(shift - threshold) + normal.cdf(-shift - threshold)


def _profiles(
    model: PhysicalModel, experiments: Sequence[Experiment]
) -> Mapping[str, list[Experiment]]:
    """The records' duration driven otherwise, within the range of the inputs on record; one that
    only pushed may pull, too.

    None where there is nothing to drive.
    """
    if not model.inputs:
        return {}
    e = max(experiments, key=lambda e: e.n)
    low, high = e.U.min(axis=0), e.U.max(axis=0)
    phase = np.linspace(0.0, 1.0, e.n)[:, None]
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    cycles = {
        "drive slow triangles over the range of the input": (
            middle + half * (2.0 * np.abs(2.0 * ((3.0 * phase) % 1.0) - 1.0) - 1.0)
        ),
        "drive steps of many levels over the range of the input": (
            middle + half * np.sin(97.0 * np.floor(40.0 * phase) ** 2 + 1.0)
        ),
        "repeat at half the amplitude": middle + 0.5 * (e.U - middle),
    }
    one_way = (
        (low * high >= 0.0)
        & (low < high)
        & [signal.unit in _BOTH_WAYS for signal in model.inputs.values()]
    )
    if one_way.any():
        triangles = 2.0 * np.abs(2.0 * ((3.0 * phase) % 1.0) - 1.0) - 1.0
        peak = np.maximum(np.abs(low), np.abs(high))
        cycles["drive slow triangles both ways, forwards and backwards"] = np.where(
            one_way, peak * triangles, e.U
        )
    return {do: [replace(e, U=np.ascontiguousarray(U))] for do, U in cycles.items()}
