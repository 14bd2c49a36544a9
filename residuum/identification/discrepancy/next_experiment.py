"""The next experiment: what would tell apart the candidates that this one cannot?"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from statistics import NormalDist

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.policy.answers import DISTINCTION_LEVEL, MOST_PROPOSALS, SENSOR_NOISE, WORTH_SEPARATING
from residuum.identification.discrepancy.search_state import Search
from residuum.identification.discrepancy.structures import Structure
from residuum.identification.physics import Experiment, Key, Simulator
from residuum.identification.unseen_blocks.advice import NextExperiment
from residuum.identification.unseen_blocks.candidate import Candidate

FloatArray = npt.NDArray[np.float64]


def next_experiments(
    found: Search, candidates: Sequence[Candidate], experiments: Sequence[Experiment]
) -> tuple[NextExperiment, ...]:
    """Extra sensors and other input profiles, best first, for the leading candidate and what it cannot be told from.

    Both structures are simulated; the difference of their signals in units of noise, what their own free parameters can
    absorb taken out, is the non-centrality of a χ² test at level `DISTINCTION_LEVEL` that tells them apart.
    """
    pair = _rivals(found, candidates)
    if pair is None:
        return ()
    first, second = pair
    names = (candidates[0].effect, second[0])
    a, b = found.alternatives[0][first], found.alternatives[0][second]
    proposals = []
    sensors = _sensors(a, b, experiments)
    for name, seen in sensors.items():
        proposals.append(NextExperiment(f"also record {name}", names, seen))
    for do, profile in _profiles(experiments).items():
        power = _power(_difference(a, b, profile))
        if power is not None:
            proposals.append(NextExperiment(do, names, power))
    return tuple(sorted(proposals, key=lambda p: -p.power)[:MOST_PROPOSALS])


def _rivals(found: Search, candidates: Sequence[Candidate]) -> tuple[Key, Key] | None:
    if not candidates or not found.alternatives:
        return None
    first = candidates[0].key
    others = [c.key for c in candidates[1:] if c.step == 0 and c.effect in candidates[0].indistinguishable_from]
    others += [c.key for c in candidates[1:] if c.step == 0 and c.probability > WORTH_SEPARATING]
    rival = next((key for key in others if key in found.alternatives[0] and key != first), None)
    return (first, rival) if rival is not None and first in found.alternatives[0] else None


def _sensors(a: Structure, b: Structure, experiments: Sequence[Experiment]) -> dict[str, float]:
    """Power of each signal that the model has and the records lack."""
    measured = np.any([e.measured for e in experiments], axis=0)
    outputs = [(name, o) for o, name in enumerate(a.model.outputs) if not measured[o]]
    found = {}
    for name, o in outputs:
        power = _power(_difference(a, b, experiments, only=o))
        if power is not None:
            found[f"{name} [{a.model.outputs[name].unit}]"] = power
    return found


def _difference(
    a: Structure, b: Structure, experiments: Sequence[Experiment], only: int | None = None
) -> list[tuple[FloatArray, FloatArray]]:
    """Whitened difference of the two structures' outputs and its derivatives by the second's parameters, per experiment."""
    found = []
    for e, x, y in zip(experiments, a.initial, b.initial, strict=False):
        one, two = Simulator(a.model), Simulator(b.model)
        left = one.run_vectors(e, x, one.p()).Y
        run = two.run_vectors(e, y, two.p(), slopes=b.parameters)
        if run.dY is None or not (np.all(np.isfinite(left)) and run.finite):
            return []
        rows, designs = [], []
        for o in range(left.shape[1]):
            noise = b.noises[o]
            if noise is not None:
                scale = np.sqrt(noise.innovation_variance)
                rows.append(noise.whiten(e.means(left[:, o] - run.Y[:, o])) / scale)
                designs.append(noise.whiten(e.means(run.dY[:, o])) / scale)
            elif o == only:
                scale = SENSOR_NOISE * max(float(np.sqrt(np.mean(left[:, o] ** 2))), 1e-300)
                rows.append((left[:, o] - run.Y[:, o]) / scale)
                designs.append(run.dY[:, o] / scale)
        found.append((np.concatenate(rows), np.concatenate(designs)))
    return found


def _power(parts: Sequence[tuple[FloatArray, FloatArray]]) -> float | None:
    """Power of the χ² test on what the second structure's parameters cannot absorb; None when it could not be simulated."""
    if not parts:
        return None
    r, J = np.concatenate([p[0] for p in parts]), np.concatenate([p[1] for p in parts])
    scale = np.linalg.norm(J, axis=0)
    u, s, _ = np.linalg.svd(J[:, scale > 0] / scale[scale > 0], full_matrices=False)
    u = u[:, s > 1e-9 * s.max(initial=0.0)]
    rest = r - u @ (u.T @ r)
    return _exceeds(NormalDist().inv_cdf(1.0 - DISTINCTION_LEVEL / 2.0), float(np.sqrt(rest @ rest)))


def _exceeds(threshold: float, shift: float) -> float:
    """Probability of |z + shift| > threshold for normal z: with one degree of freedom this is the non-central χ² test's."""
    normal = NormalDist()
    return normal.cdf(shift - threshold) + normal.cdf(-shift - threshold)


def _profiles(experiments: Sequence[Experiment]) -> Mapping[str, list[Experiment]]:
    """The records' duration driven otherwise, within the range of the inputs on record."""
    e = max(experiments, key=lambda e: e.n)
    low, high = e.U.min(axis=0), e.U.max(axis=0)
    phase = np.linspace(0.0, 1.0, e.n)[:, None]
    middle, half = 0.5 * (low + high), 0.5 * (high - low)
    cycles = {
        "drive slow triangles over the range of the input": middle
        + half * (2.0 * np.abs(2.0 * ((3.0 * phase) % 1.0) - 1.0) - 1.0),
        "drive steps of many levels over the range of the input": middle
        + half * np.sin(97.0 * np.floor(40.0 * phase) ** 2 + 1.0),
        "repeat at half the amplitude": middle + 0.5 * (e.U - middle),
    }
    return {do: [replace(e, U=np.ascontiguousarray(U))] for do, U in cycles.items()}
