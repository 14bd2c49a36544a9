"""The next experiment: what would tell apart the candidates that this one cannot?"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.searching.search_state import Search
from residuum.identification.physics import Experiment, Key, Simulator
from residuum.identification.unseen_blocks.candidate import Candidate
from residuum.identification.unseen_blocks.next_experiment import NextExperiment, distinguishing, power_of_test
from residuum.identification.unseen_blocks.policy import SENSOR_NOISE, WORTH_SEPARATING

FloatArray = npt.NDArray[np.float64]


def next_experiments(
    found: Search, candidates: Sequence[Candidate], experiments: Sequence[Experiment]
) -> tuple[NextExperiment, ...]:
    """Extra sensors and other input profiles, best first, for the leading candidate and what it cannot be told from.

    Both structures are simulated; the difference of their signals in units of noise, what their own free parameters can
    absorb taken out, is the non-centrality of a χ² test that tells them apart.
    """
    pair = _rivals(found, candidates)
    if pair is None:
        return ()
    first, second = pair
    a, b = found.alternatives[0][first], found.alternatives[0][second]

    def power(tried: Sequence[Experiment], only: int | None) -> float | None:
        parts = _difference(a, b, tried, only)
        return power_of_test(*(np.concatenate(each) for each in zip(*parts, strict=True))) if parts else None

    return distinguishing((candidates[0].effect, second[0]), a.model, experiments, power)


def _rivals(found: Search, candidates: Sequence[Candidate]) -> tuple[Key, Key] | None:
    if not candidates or not found.alternatives:
        return None
    first = candidates[0].key
    others = [c.key for c in candidates[1:] if c.step == 0 and c.effect in candidates[0].indistinguishable_from]
    others += [c.key for c in candidates[1:] if c.step == 0 and c.probability > WORTH_SEPARATING]
    rival = next((key for key in others if key in found.alternatives[0] and key != first), None)
    return (first, rival) if rival is not None and first in found.alternatives[0] else None


def _difference(
    a: Structure, b: Structure, experiments: Sequence[Experiment], only: int | None
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
