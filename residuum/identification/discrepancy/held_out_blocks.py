"""Blocks kept aside: stretches of the records that a model follows from where the measurements show the machine to be.

A likelihood of single samples believes that one structure is exact. The world never is one of our structures; then the scatter
between blocks of time, not the number of samples, is what a difference of two models has to stand above. Every second stretch
estimates, the others judge. Each begins at the smoothed states, so that nothing but the model's own terms can explain what
happens in it: free first states would imitate whatever is missing.

References
----------
A. Vehtari, A. Gelman, J. Gabry, Stat. Comput. 27 (2017) 1413 (paired differences and their standard errors);
M. C. Kennedy, A. O'Hagan, J. R. Stat. Soc. B 63 (2001) 425 (a model is wrong by more than noise).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.deadline import in_time
from residuum.identification.discrepancy.track import Track, joined_spare
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.physics import Experiment, PhysicalModel, Settings, Simulator, estimate, windows
from residuum.identification.physics.simulate.kalman import Filter, first_noise, noise_floor

FloatArray = npt.NDArray[np.float64]

_BLOCKS = (60, 30, 15)
"""Stretches that the records are cut into: fewer, hence longer, where the shorter ones do not show the model's error."""
_SHORTEST, _LONGEST = 20, 600
"""Samples of a stretch."""
_MOSTLY = 0.5
"""Part of an output's power that one block may hold."""
_SHOWN = 10.0
"""Times the measurement noise that an error over a stretch has to stand to be judged."""
_REFIT, _LOOK = 15, 6
"""Gauss–Newton steps of a candidate that is judged, and of one of its starts."""
_MOST, _GLANCED = 12_000, 3_000
"""Samples of all stretches, and of those on which a start is looked at."""


@dataclass(frozen=True, eq=False)
class Blocks:
    """Stretches of the experiments that begin on the track of `model`: those that `train`, and those that `test`."""

    model: PhysicalModel
    train: list[Experiment]
    test: list[Experiment]
    track: Track
    noise: FloatArray

    @property
    def samples(self) -> int:
        """Length of a stretch."""
        return self.test[0].n

    @property
    def few(self) -> Blocks:
        """The same with some of the training blocks alone, evenly spread."""
        total = sum(part.n for part in self.train)
        return replace(self, train=self.train[:: max(1, round(total / _GLANCED))])

    @property
    def turned(self) -> Blocks:
        """The same with what trains and what tests exchanged."""
        return replace(self, train=self.test, test=self.train)


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
        """These blocks, and then the other's."""
        return Errors(np.concatenate([self.power, other.power]), np.concatenate([self.count, other.count]))

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
        alone = largest[0] > _MOSTLY * largest.sum(axis=0)
        return np.where(alone, largest[min(1, len(largest) - 1)], np.inf)


def blocks_on_track(model: PhysicalModel, experiments: Sequence[Experiment]) -> Blocks | None:
    """The experiments in blocks that begin on the model's track; None where the filter diverges or the records are too short.

    The stretches are as short as show the model's error: at least `_SHOWN` times the noise of an output.
    """
    kalman, simulator = Filter(model, first_noise(model, list(experiments))), Simulator(model)
    found = [kalman.run(e, simulator.x0(e.known)) for e in experiments]
    if not all(np.all(np.isfinite(s.X)) for s in found):
        return None
    lacks = {
        b: np.concatenate([s.missing[b].value if b in s.missing else np.zeros(len(s.X)) for s in found]) for b in model.balances
    }
    U, Y = np.concatenate([e.U for e in experiments]), np.concatenate([e.Y for e in experiments])
    spare = joined_spare(experiments)
    along = Track(replace(experiments[0], U=U, Y=Y, known={}, spare=spare), np.concatenate([s.X for s in found]), lacks)
    noise, total = np.nan_to_num(noise_floor(Y)), sum(e.n for e in experiments)
    blocks = None
    for count in _BLOCKS:
        samples = int(np.clip(total // count, _SHORTEST, _LONGEST))
        parts = _stretches(simulator.states, experiments, [s.X for s in found], samples)
        if len(parts) < 6:
            break
        parts = _thinned(parts, max(1, total // _MOST))
        blocks = Blocks(model, parts[::2], parts[1::2], along, noise)
        trained = fitted(model, blocks)
        errors = None if trained is None else errors_on(trained[0], blocks)
        if errors is None or errors.stands_out(noise, _SHOWN) or samples == _LONGEST:
            break
    return blocks


def _stretches(states: Sequence[str], experiments: Sequence[Experiment], X: Sequence[FloatArray], n: int) -> list[Experiment]:
    parts = []
    for e, along in zip(experiments, X, strict=True):
        for part in windows(e, min(n, e.n)):
            row = round((part.t0 - e.t0) / e.sample_time)
            if 2 * part.n > n:
                parts.append(replace(part, known=dict(zip(states, along[row].tolist(), strict=False)), block=1))
    return parts


def _thinned(parts: list[Experiment], every: int) -> list[Experiment]:
    """Neighbours in pairs, of which one trains and the other tests, one pair of so many."""
    return [part for k, part in enumerate(parts) if (k // 2) % every == 0] if len(parts) > 30 else parts


def _measured(parts: Sequence[Experiment]) -> FloatArray:
    return np.concatenate([part.Y for part in parts])


def errors_on(model: PhysicalModel, blocks: Blocks) -> Errors | None:
    """The model's errors on the blocks kept aside, its effects' own states settled at each begin; None where it diverges."""
    simulator, test = Simulator(model), blocks.test
    initial, p = [simulator.x0(part.known) for part in test], simulator.p()
    try:
        steps = simulator.substeps_each(test, initial, p)
        residuals = simulator.run_each(test, initial, p, substeps=steps).errors_of_each
    except NotIdentifiable:
        return None
    known = [np.isfinite(part.Y) for part in blocks.test]
    if not all(np.all(np.isfinite(r[there])) for r, there in zip(residuals, known, strict=True)):
        return None
    power = np.array([np.nansum(r**2, axis=0) for r in residuals])
    return Errors(power, np.array([there.sum(axis=0) for there in known], dtype=float))


def fitted(model: PhysicalModel, blocks: Blocks, *, look: bool = False) -> tuple[PhysicalModel, float] | None:
    """The model at its least simulation error on the training blocks, with that error's weighted sum of squares.

    None where it diverges. A first `look` takes fewer steps.
    """
    in_time()
    if not model.free:
        return model, np.inf
    settings = Settings(iterations=_LOOK if look else _REFIT, tolerance=1e-3)
    try:
        found = estimate(model, blocks.train, settings=settings)
    except (NotIdentifiable, BadInput, NotImplementedError):
        return None
    residuals: FloatArray = np.concatenate(found.residuals)
    spread = np.array([np.std(y[np.isfinite(y)]) if np.isfinite(y).any() else 0.0 for y in _measured(blocks.train).T])
    weights = np.divide(1.0, spread, out=np.zeros_like(spread), where=spread > 0)
    return found.model, float(np.nansum((residuals * weights) ** 2))


def cross_judged(model: PhysicalModel, blocks: Blocks) -> tuple[PhysicalModel, Errors] | None:
    """The model estimated on the training blocks and tested on the others, and the other way round: its errors on all of them.

    Every block is judged once by a model that has not seen it; None where one of the two diverges.
    """
    first = fitted(model, blocks)
    second = None if first is None else fitted(first[0], blocks.turned)
    if first is None or second is None:
        return None
    errors, others = errors_on(first[0], blocks), errors_on(second[0], blocks.turned)
    return None if errors is None or others is None else (first[0], errors.beside(others))


@dataclass(frozen=True)
class Remaining:
    """What a model leaves on the blocks kept aside.

    `share` of the power of the model that the blocks were cut with, `times_noise` the largest RMS error over its measurement
    noise, and the stretch of time `where` (from, to) [s] in which most of it lies.
    """

    share: float
    times_noise: float
    where: tuple[float, float]


def remaining_on(model: PhysicalModel, blocks: Blocks) -> Remaining | None:
    """What the model, estimated on the training blocks, leaves on the others; None where it diverges."""
    base, trained = cross_judged(blocks.model, blocks), cross_judged(model, blocks)
    if base is None or trained is None:
        return None
    after = trained[1]
    power = after.relative(base[1])
    worst = [*blocks.test, *blocks.train][int(np.argmax(power))]
    times = after.rms / np.where(blocks.noise > 0, blocks.noise, np.nan)
    largest = float(np.nanmax(times)) if np.isfinite(times).any() else float("inf")
    return Remaining(float(power.sum()), largest, (worst.t0, worst.t0 + worst.n * worst.sample_time))
