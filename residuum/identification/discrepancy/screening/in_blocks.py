"""A structure and its experiments sampled once a block, for first looks: integrated in fewer steps."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.structure_fits import visible
from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.physics import Experiment, Simulator

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Sampled:
    """A structure, its experiments, its states at their samples, (n, states) each, and the most integration steps a sample that
    can be seen.
    """

    base: Structure
    experiments: list[Experiment]
    X: list[FloatArray]
    most_substeps: int


def at_every_sample(base: Structure, experiments: Sequence[Experiment]) -> Sampled:
    """The structure simulated as it was estimated."""
    simulator = Simulator(base.model)
    runs = simulator.run_each(experiments, base.initial, simulator.p(), substeps=base.substeps)
    return Sampled(base, list(experiments), [run.X for run in runs], visible(base))


def in_blocks(every: Sampled) -> Sampled:
    """The structure, the experiments and the structure's states `X` there with one sample in the middle of every block.

    Signals move little within a block (that is how `averaged` chose it), so inputs are replaced by their means. What this
    does to the structure's own simulation is put into the outputs: it leaves the same residuals as at every sample, and what
    an effect changes beside it is right to second order. As they are where a block is one sample, and where the
    structure diverges in steps so long.
    """
    base, experiments, X = every.base, every.experiments, every.X
    block = max(e.block for e in experiments)
    if block == 1:
        return every
    simulator = Simulator(base.model)
    initial, p = [x[_middle(e)] for e, x in zip(experiments, X, strict=True)], simulator.p()
    coarse = [
        replace(e, U=_inputs(e), Y=r, sample_time=e.sample_time * e.block, t0=e.t0 + _middle(e) * e.sample_time, block=1)
        for e, r in zip(experiments, base.residuals, strict=True)
    ]
    steps = simulator.modal_substeps(coarse, initial, p)
    slopes = [*base.parameters, *(f"initial:{name}" for name in simulator.free_states)]
    runs = simulator.run_each(coarse, initial, p, slopes=slopes, substeps=steps)
    if not runs.bounded:
        return every
    q = len(base.parameters)
    found = replace(
        base,
        initial=initial,
        substeps=tuple(steps),
        by_parameters=[run.dY[:, :, :q] for run in runs if run.dY is not None],
        by_states=[run.dY[:, :, q:] for run in runs if run.dY is not None],
    )
    there = [replace(e, Y=run.Y + e.Y) for e, run in zip(coarse, runs, strict=True)]
    return Sampled(found, there, [run.X for run in runs], every.most_substeps * block)


def _middle(experiment: Experiment) -> int:
    return (experiment.block - 1) // 2


def _inputs(experiment: Experiment) -> FloatArray:
    """Means over the blocks of inputs that move evenly, and over the steps from one middle to the next of those that are held."""
    last = np.repeat(experiment.U[-1:], experiment.block, axis=0)
    held = experiment.means(np.concatenate([experiment.U, last])[_middle(experiment) :])
    moving = experiment.means(experiment.U)
    return np.where(experiment.hold > 0.0, moving, held[: len(moving)])
