"""Blocks kept aside: parts of the records that judge a model which has not seen them.

A likelihood of single samples believes that one structure is exact. The world never is one of our structures; then the scatter
between blocks of time, not the number of samples, is what a difference of two models has to stand above. Every second block
estimates, the others judge, and then the other way round.

References
----------
A. Vehtari, A. Gelman, J. Gabry, Stat. Comput. 27 (2017) 1413 (paired differences and their standard errors);
M. C. Kennedy, A. O'Hagan, J. R. Stat. Soc. B 63 (2001) 425 (a model is wrong by more than noise).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.policy.blocks import DOMINANT, ESTIMATED, ESTIMATED_ON_ALL, LOOKED_AT
from residuum.identification.discrepancy.track import Track
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.physics import Estimate, Experiment, PhysicalModel, Settings, Simulator, estimate
from residuum.identification.work import go_on

FloatArray = npt.NDArray[np.float64]


Spans = list[tuple[int, int, int]]
"""Begin and end of pieces of an experiment, and the block that each belongs to."""


@dataclass(frozen=True, eq=False)
class Fold:
    """What estimates, and what judges: `spans` are the pieces of each experiment in `test`, each of one of so many `blocks`.

    Where the first states are not known (a whole run), `train` and `test` are the same runs with other samples measured, and the
    states that were estimated go with the parameters.
    """

    train: list[Experiment]
    test: list[Experiment]
    spans: list[Spans]
    blocks: int

    @property
    def whole(self) -> bool:
        """Whether the first states are estimated."""
        return not self.train[0].known


@dataclass(frozen=True, eq=False)
class Fitted:
    """A model estimated on a fold, its first states there, and the weighted sum of squares that it leaves."""

    model: PhysicalModel
    initial: list[FloatArray]
    cost: float


@dataclass(frozen=True, eq=False)
class Blocks:
    """Blocks of the experiments: two folds, in each of which the other half judges.

    `looked` is what a first look estimates on: whole runs with every sample, or some of the first fold's stretches. `base` is the
    model estimated on that. `track` is what the model's filter saw, `states` (n, states) an experiment where the machine went: as
    the model is simulated where it follows the records, else as the filter saw it. `noise` is each output's measurement noise.
    """

    base: Fitted
    looked: Fold
    folds: tuple[Fold, Fold]
    track: Track
    states: list[FloatArray]
    noise: FloatArray


@dataclass(frozen=True, eq=False)
class Errors:
    """A model's simulation error on the blocks kept aside.

    `power` (blocks, outputs): sums of squares; `count` (blocks, outputs): samples; outputs that were never measured have none.
    """

    power: FloatArray
    count: FloatArray

    @property
    def rms(self) -> FloatArray:
        """Of each output over all blocks."""
        count = self.count.sum(axis=0)
        return np.sqrt(np.divide(self.power.sum(axis=0), count, out=np.full(len(count), np.nan), where=count > 0))

    def beside(self, other: Errors) -> Errors:
        """Those of the pieces that judged here, and of the other's."""
        return Errors(self.power + other.power, self.count + other.count)

    def stands_out(self, noise: FloatArray, times: float) -> bool:
        """Whether an output's error is so many times its measurement noise."""
        return bool(np.any(self.rms > times * noise))

    def relative(self, base: Errors) -> FloatArray:
        """Power of each block, outputs in units of the base's mean power, in sum one for the base itself; shape (blocks,).

        A block that holds most of an output's power by itself (a beginning that nothing explains) would decide alone; it counts
        there as the next largest does.
        """
        power, limits = base.power, base.limits
        total = np.minimum(power, limits).sum(axis=0)
        seen = total > 0.0
        return np.asarray((np.minimum(self.power, limits)[:, seen] / total[seen]).sum(axis=1) / max(int(seen.sum()), 1))

    @property
    def limits(self) -> FloatArray:
        """Of each output the power above which a block is no more than one of many, shape (outputs,)."""
        largest = np.sort(self.power, axis=0)[::-1]
        alone = largest[0] > DOMINANT * largest.sum(axis=0)
        return np.where(alone, largest[min(1, len(largest) - 1)], np.inf)


def estimated(
    model: PhysicalModel, experiments: Sequence[Experiment], settings: Settings, initial: Sequence[FloatArray] | None = None
) -> Estimate | None:
    """The estimate; None where the model diverges, nothing can be estimated, or the estimate is too stiff for the integrator."""
    try:
        found = estimate(model, experiments, settings=settings, initial=initial)
    except (NotIdentifiable, BadInput, NotImplementedError):
        return None
    simulator = Simulator(found.model)
    return found if simulator.resolves(experiments, found.initial, simulator.p(), found.substeps) else None


def errors_on(found: Fitted, fold: Fold) -> Errors | None:
    """The model's errors on the blocks that judge, its effects' own states settled at each begin; None where it diverges."""
    simulator, test = Simulator(found.model), fold.test
    initial, p = found.initial if fold.whole else [simulator.x0(part.known) for part in test], simulator.p()
    try:
        steps = simulator.substeps_each(test, initial, p)
        residuals = simulator.run_each(test, initial, p, substeps=steps).errors_of_each
    except NotIdentifiable:
        return None
    power, count = np.zeros((2, fold.blocks, len(found.model.outputs)))
    for e, r, spans in zip(test, residuals, fold.spans, strict=True):
        for begin, end, block in spans:
            known, error = np.isfinite(e.Y[begin:end]), r[begin:end]
            if not np.all(np.isfinite(error[known])):
                return None
            power[block] += np.nansum(error**2, axis=0)
            count[block] += known.sum(axis=0)
    return Errors(power, count)


def fitted(model: PhysicalModel, fold: Fold, *, look: bool = False, initial: Sequence[FloatArray] | None = None) -> Fitted | None:
    """The model at its least simulation error on what estimates; None where it diverges. A first `look` takes fewer steps.

    Of a whole run the first states are sought from `initial` on, where they are known roughly.
    """
    go_on()
    if not model.free and not fold.whole:
        return Fitted(model, [], np.inf)
    found = estimated(model, fold.train, LOOKED_AT if look else ESTIMATED, initial)
    if found is None:
        return None
    residuals, Y = np.concatenate(found.residuals), np.concatenate([part.Y for part in fold.train])
    spread = np.array([np.std(y[np.isfinite(y)]) if np.isfinite(y).any() else 0.0 for y in Y.T])
    weights = np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > 0)
    return Fitted(found.model, found.initial, float(np.nansum((residuals * weights) ** 2)))


def cross_judged(found: Fitted | None, blocks: Blocks) -> tuple[Fitted, Errors] | None:
    """The model estimated on either half of the blocks and judged on the other, from where a first look `found` it: its errors on
    all of them.

    Every block is judged once by a model that has not seen it; None where one of the two diverges.
    """
    if found is None:
        return None
    first, second = (fitted(found.model, fold, initial=found.initial if fold.whole else None) for fold in blocks.folds)
    if first is None or second is None:
        return None
    errors, others = errors_on(first, blocks.folds[0]), errors_on(second, blocks.folds[1])
    return None if errors is None or others is None else (found, errors.beside(others))


def looked_at(model: PhysicalModel, blocks: Blocks) -> Fitted | None:
    """A model with effects more than the blocks' own, estimated on what a first look takes; None where it diverges."""
    whole = blocks.looked.whole
    return fitted(model, blocks.looked, look=True, initial=_first_states(blocks.base, model) if whole else None)


def estimated_on_all(blocks: Blocks) -> Estimate | None:
    """The blocks' model estimated on all of them together; None where it diverges or has nothing free."""
    base, whole = blocks.base, blocks.looked.whole
    experiments = blocks.looked.train if whole else [part for fold in blocks.folds for part in fold.test]
    if not base.model.free:
        return None
    return estimated(base.model, experiments, ESTIMATED_ON_ALL, base.initial if whole else None)


def _first_states(base: Fitted, model: PhysicalModel) -> list[FloatArray]:
    """The base's first states in the order of a model with other effects, whose own states begin where its kernel sets them."""
    states, simulator = Simulator(base.model).states, Simulator(model)
    found = []
    for known in base.initial:
        x = simulator.x0({})
        for name, value in zip(states, known.tolist(), strict=True):
            if name in simulator.states:
                x[simulator.states.index(name)] = value
        found.append(x)
    return found
