"""Advice: how large an effect would have had to be to be seen, and which experiment tells apart
what this one cannot.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from statistics import NormalDist
from typing import TYPE_CHECKING

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.physics import Experiment, Key, PhysicalModel, Simulator
from residuum.identification.physics.model import find_effect
from residuum.identification.side_by_side import side_by_side
from residuum.identification.unseen_blocks.policy import (
    DISTINCTION_LEVEL,
    MOST_PROPOSALS,
    MOST_TIMES,
    POWER_WANTED,
    SENSOR_NOISE,
    TIE,
    WORTH_SEPARATING,
)
from residuum.identification.unseen_blocks.proposals import proposed, starts
from residuum.identification.unseen_blocks.scale import Scale, of_noise
from residuum.identification.unseen_blocks.structure import HELD

if TYPE_CHECKING:
    from residuum.identification.unseen_blocks.cross_validation import ValidatedFit
    from residuum.identification.unseen_blocks.following import Track
    from residuum.identification.unseen_blocks.tried import Search, Wanted
    from residuum.identification.unseen_blocks.verdict import Candidate


@dataclass(frozen=True)
class Undetectable:
    """Smallest size of an effect's leading parameter that would have been accepted, in `unit`."""

    effect: str
    balance: str
    smallest_visible: dict[str, float]
    unit: str


def noise_of(validated: ValidatedFit, search: Search) -> Scale:
    """Nats of the noise that a structure leaves."""
    last = search.validation.last
    return of_noise(
        np.split(validated.errors, last.starts[1:-1]), last, search.validation.data.measured
    )


def undetectable(
    search: Search, wanted: Wanted, along: Track | None, named: Collection[Key]
) -> tuple[Undetectable, ...]:
    """For every effect with a size that is not `named`: the size s whose ½·I·s² nats would be
    enough.

    `named` are those that joined and what does the same in their place. I is the information on the
    size beside the free parameters, in the noise that the best structure leaves.
    """
    if along is None:
        return ()
    every = proposed(search.best.model, wanted.effects, None, learned=False, held=False)
    keys = [key for key in every if key not in named and find_effect(key.effect).sizes]
    scale = noise_of(search.best, search)
    undetected = side_by_side(lambda key: _smallest(key, search, scale, along, len(keys)), keys)
    return tuple(effect for effect in undetected if effect is not None)


def _smallest(
    key: Key, search: Search, scale: Scale, along: Track, count: int
) -> Undetectable | None:
    effect = find_effect(key.effect)
    first = starts(key, along)
    if not first:
        return None
    size, start = effect.sizes[0], first[-1]
    # where the size is zero, its slope tells how far a small one would be seen
    try:
        model = search.best.model.with_effect(*key, effect.at_rest(start))
        at = model.effects[-1]
        information = _information(model, f"{at.label}.{size}", search, scale)
    except BadInput:
        return None
    if not information > 0.0:
        return None
    # what an effect has to gain to join in nats: the price of the choice among so many, the odds of
    # a tie, and its parameters
    parameters = sum(not p.fixed for p in at.parameters.values())
    needed = np.log(max(count, 1)) + TIE + scale.price * parameters
    return Undetectable(
        key.effect,
        key.target,
        {size: float(np.sqrt(2.0 * needed / information))},
        at.parameters[size].unit,
    )


def _information(model: PhysicalModel, name: str, search: Search, scale: Scale) -> float:
    """On one parameter, the free ones of the best structure projected out; none where they do all
    that it does, or its slopes grow without bounds.
    """
    last, simulator = search.validation.last, Simulator(model)
    states = search.best.structure.states[last.windows]
    initial = [simulator.x0({n: v for n, v in s.items() if n in simulator.states}) for s in states]
    steps = search.best.structure.steps[last.windows]
    columns = [name, *search.best.model.free]
    runs = simulator.run_each(last.parts, initial, simulator.p(), slopes=columns, substeps=steps)
    if runs.dY is None or not runs.bounded:
        return 0.0
    # slopes may overflow where the best structure is near diverging: then nothing is known
    with np.errstate(over="ignore", invalid="ignore"):
        J = scale.whitened(runs.dY * scale.weights[:, None], last.starts.tolist())
        J = J[:, scale.weights > 0.0].reshape(-1, len(columns))
        size = np.linalg.norm(J, axis=0)
    if not np.all(np.isfinite(size)):
        return 0.0
    # I = |j − Q Qᵀ j|² of the effect's slope j, Q an orthonormal basis of the free parameters'
    # slopes
    Q, R = np.linalg.qr(J[:, 1:][:, size[1:] > 0.0] / size[1:][size[1:] > 0.0])
    Q = Q[:, np.abs(np.diag(R)) > 1e-9]
    residual = J[:, 0] - Q @ (Q.T @ J[:, 0])
    own = float(residual @ residual)
    return own if own > 1e-9 * float(size[0]) ** 2 else 0.0


def next_experiments(search: Search, candidates: Sequence[Candidate]) -> tuple[NextExperiment, ...]:
    """Extra sensors and other input profiles, best first, for the leading candidate and what it
    cannot be told from.

    Both structures are simulated; the difference of their signals in units of noise, what their own
    free parameters can absorb taken out, is the non-centrality of a χ² test that tells them apart.
    """
    pair = _rivals(search, candidates)
    if pair is None:
        return ()
    (key, first), (rival, second) = pair
    scale = noise_of(first, search)

    def power(experiments: Sequence[Experiment], only: int | None) -> float | None:
        return _power(first, second, experiments, scale, only)

    return distinguishing(
        (key.effect, rival.effect), first.model, search.validation.data.experiments, power
    )


def _rivals(
    search: Search, candidates: Sequence[Candidate]
) -> tuple[tuple[Key, ValidatedFit], tuple[Key, ValidatedFit]] | None:
    if not candidates:
        return None
    first = candidates[0]
    # both alone beside the model as it is: what else joined would be in one of them only
    alone = {
        validated.keys[0]: validated
        for validated in search.every.values()
        if len(validated.keys) == 1
    }
    rivals = [
        candidate
        for candidate in candidates[1:]
        if _is_worth_separating(candidate, first)
        and candidate.key in alone
        and candidate.key != first.key
    ]
    if not rivals or first.key not in alone or rivals[0].key.effect == HELD:
        return None
    rival = rivals[0].key
    return (first.key, alone[first.key]), (rival, alone[rival])


def _is_worth_separating(candidate: Candidate, first: Candidate) -> bool:
    """Whether a candidate of the first step may be what the leading one is taken for."""
    alike = candidate.key in first.alike
    return candidate.step == 0 and (alike or candidate.probability > WORTH_SEPARATING)


def _power(
    a: ValidatedFit,
    b: ValidatedFit,
    experiments: Sequence[Experiment],
    scale: Scale,
    only: int | None,
) -> float | None:
    """Power of the test on what the second structure's parameters cannot absorb; None when it could
    not be simulated.
    """
    simulator_a, simulator_b = Simulator(a.model), Simulator(b.model)
    differences, slopes = [], []
    for e in experiments:
        Y_a = simulator_a.run_vectors(e, simulator_a.x0(_first(a)), simulator_a.p()).Y
        run = simulator_b.run_vectors(
            e, simulator_b.x0(_first(b)), simulator_b.p(), slopes=b.model.free
        )
        if run.dY is None or not (np.all(np.isfinite(Y_a)) and run.finite):
            return None
        weights = scale.weights.copy()
        if only is not None:  # a sensor that is not there yet: its noise is a part of its signal
            rms = float(np.sqrt(np.mean(Y_a[:, only] ** 2)))
            weights[only] = 1.0 / (SENSOR_NOISE * max(rms, 1e-300))
        differences.append(scale.whitened((Y_a - run.Y) * weights, [0, e.n]).ravel())
        white_slopes = scale.whitened(run.dY * weights[:, None], [0, e.n])
        slopes.append(white_slopes.reshape(-1, run.dY.shape[2]))
    return power_of_test(np.concatenate(differences), np.concatenate(slopes))


def _first(validated: ValidatedFit) -> dict[str, float]:
    """First states of the first window on the last horizon; those that it fixes stay."""
    states = validated.structure.states[min(validated.structure.states)]
    return dict(states[0])


# The next experiment: extra sensors and other input profiles, by the power with which they tell two
# structures apart.

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
    if times is None:
        return tuple(best)
    more = f"record {times} times as much of the same"
    return (*best, NextExperiment(more, separates, POWER_WANTED))


def power_of_test(r: FloatArray, J: FloatArray) -> float:
    """Power of the χ² test, at `DISTINCTION_LEVEL`, on what free parameters with slopes J (n, q)
    cannot absorb of a whitened difference r (n,).
    """
    # r − U Uᵀ r with an orthonormal basis U of the slopes
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
    # the shift of the test's normal variable grows with the root of the number of samples
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
    # three periods between −1 and 1; forty levels, by a fixed sequence that looks random, so that
    # every answer proposes the same
    triangles = 2.0 * np.abs(2.0 * ((3.0 * phase) % 1.0) - 1.0) - 1.0
    levels = np.sin(97.0 * np.floor(40.0 * phase) ** 2 + 1.0)
    cycles = {
        "drive slow triangles over the range of the input": middle + half * triangles,
        "drive steps of many levels over the range of the input": middle + half * levels,
        "repeat at half the amplitude": middle + 0.5 * (e.U - middle),
    }
    reversible = [signal.unit in _BOTH_WAYS for signal in model.inputs.values()]
    one_way = (low * high >= 0.0) & (low < high) & reversible
    if one_way.any():
        peak = np.maximum(np.abs(low), np.abs(high))
        both_ways = np.where(one_way, peak * triangles, e.U)
        cycles["drive slow triangles both ways, forwards and backwards"] = both_ways
    return {do: [replace(e, U=np.ascontiguousarray(U))] for do, U in cycles.items()}
