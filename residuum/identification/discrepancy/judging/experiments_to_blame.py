"""What is missing, where the way in which the records were cut, or their inputs taken between samples, may be to blame."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from itertools import pairwise

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.judged_experiments import experiments_and_base
from residuum.identification.discrepancy.fitting.structure_fits import fit_structure
from residuum.identification.discrepancy.fitting.structures import Structure, times_its_innovations
from residuum.identification.discrepancy.policy.acceptance import ALIKE
from residuum.identification.discrepancy.searching.search import search
from residuum.identification.discrepancy.searching.search_state import Search
from residuum.identification.physics import Experiment, Key, PhysicalModel, Simulator, find_effect
from residuum.identification.record import Record
from residuum.identification.residual_analysis.feedback import feeds_back
from residuum.identification.residual_analysis.input_timing import turned_timing
from residuum.identification.residual_analysis.policy.noise import NOISE_ALONE, NOTHING_LEFT, SLOW
from residuum.identification.residual_analysis.policy.records import FINER_FALL, FINER_WINDOWS, TIMING_GAIN, TIMING_TURNS
from residuum.identification.work import Tell, part_of

FloatArray = npt.NDArray[np.float64]
Turned = tuple[list[Experiment], Structure]
"""Experiments with the other input timing, and the base on them."""


def at_turned_timing(found: Search, experiments: list[Experiment]) -> Turned | None:
    """The other input timing, where what was found is likelier there, or needs no shift.

    The timing was chosen with a model that lacked something. A delay or lag that is missing then makes up for half a sample, and
    so may effects that were found beside it; one by less than a sample may be no more than the wrong choice. Where more than
    noise is left of whatever else was found, or a shift would lessen it, the wrong timing may be what is left (half a sample, to
    two bodies on a spring).
    """
    late = _shifts(found)
    doubtful = bool(found.accepted) and _may_be_late(found)
    if not (late or found.timing or doubtful):
        return None
    best, turned = found.best, turned_timing(experiments)
    if any(e.hold.any() for e in turned) and feeds_back(best.model, experiments, _errors(best, experiments)):
        return None
    for model, more in _asked_of_the_other_timing(found, late, doubtful):
        complete = fit_structure(model, turned, found.base.initial, drifting=best.drifting)
        if complete is not None and complete.log_likelihood > best.log_likelihood - best.penalty(complete) + more:
            base = fit_structure(_without(found.base, found.timing), turned, found.base.initial)
            return None if base is None else (turned, base)
    return None


def _asked_of_the_other_timing(found: Search, late: Sequence[Key], doubtful: bool) -> list[tuple[PhysicalModel, float]]:
    """Models that may do with fewer effects at the other timing, and the log-likelihood that each has to exceed."""
    best = found.best
    tried = [(_without(best, found.timing), -ALIKE)] if found.timing else []
    if late:
        others = [key for key in found.accepted if key not in late]
        tried += [(_without(best, others), ALIKE), (best.model, ALIKE)]
    elif doubtful:
        tried += [(best.model, TIMING_GAIN)]
    return tried


def _shifts(found: Search) -> list[Key]:
    """The shifts in time that were accepted as physics."""
    return [key for key in found.accepted if find_effect(key[0]).shifts]


def _may_be_late(found: Search) -> bool:
    """Whether more than noise is left, or a shift in time that was not accepted would do plainly better."""
    tried = found.alternatives[len(found.accepted) :]
    shifts = [s.log_likelihood for looked in tried for (id, _), s in looked.items() if find_effect(id).shifts]
    better = max(shifts, default=-np.inf) > found.best.log_likelihood + TIMING_GAIN
    return times_its_innovations(found.best) > NOISE_ALONE or better


def _errors(structure: Structure, experiments: Sequence[Experiment]) -> list[FloatArray]:
    """What the structure leaves of the outputs at every sample, an array an experiment."""
    simulator = Simulator(structure.model)
    return simulator.run_each(experiments, structure.initial, simulator.p(), substeps=structure.substeps).errors_of_each


def _without(structure: Structure, keys: Sequence[Key]) -> PhysicalModel:
    """A structure's model without those of these effects that it has."""
    model = structure.model
    for use in model.effects:
        model = model.without_effect(use.label) if use.key in keys else model
    return model


class _Timing:
    """Whether the other input timing is to be taken, asked once of what was found last."""

    def __init__(self, experiments: list[Experiment]) -> None:
        self._experiments = experiments
        self._asked: Structure | None = None
        self._answer: Turned | None = None

    def turned(self, found: Search) -> Turned | None:
        """The other timing; None where this one stands, as it does where noise alone is left and no shift is wanted."""
        if self._asked is not found.best:
            doubtful = bool(_shifts(found)) or _may_be_late(found)
            self._asked, self._answer = found.best, at_turned_timing(found, self._experiments) if doubtful else None
        return self._answer

    def late(self, found: Search) -> bool:
        """Whether the other timing is to be taken now, for more effects would only make up for it: little is left, or no shift
        was found that might.
        """
        return not (_shifts(found) and times_its_innovations(found.best) > NOTHING_LEFT) and self.turned(found) is not None


def searched(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    effects: Iterable[str] | None,
    tell: Tell,
    first: Turned | None = None,
) -> tuple[Search, list[Experiment], int]:
    """What is missing, the experiments that say so, and how many times finer than usual they are cut.

    It begins at `first`, the usual experiments and the model as it is on them, where these are known.

    Over a window a machine that holds on what it lacks (a cog, a friction) takes another course at the least difference of its
    first state, and no structure reaches the top of its likelihood. Over a shorter one it does not.
    """
    wanted = None if effects is None else tuple(effects)

    def found_on(
        base: Structure, experiments: list[Experiment], begin: float, end: float, limit: float = np.inf
    ) -> tuple[Search, list[Experiment]]:
        told = part_of(tell, begin, end)

        def astray(found: Search) -> bool:
            return times_its_innovations(found.best) > limit

        for _ in range(TIMING_TURNS):
            timing = _Timing(experiments)
            found = search(base, experiments, nominal=model, effects=wanted, leave=astray, late=timing.late, tell=told)
            again = timing.turned(found)
            if again is None:
                return found, experiments
            experiments, base = again
        return search(base, experiments, nominal=model, effects=wanted, leave=astray, tell=told), experiments

    tell(0.0, "estimating the model as it is")
    usual, base = first or experiments_and_base(model, records, mapping)
    cut = any(after.follows(before) for before, after in pairwise(usual))
    found, experiments = found_on(base, usual, 0.27, 0.6, limit=SLOW if cut else np.inf)
    left = times_its_innovations(found.best)
    if cut and left > SLOW:
        tell(0.6, "estimating the model over shorter windows")
        finely, finely_base = experiments_and_base(model, records, mapping, FINER_WINDOWS)
        other, finely = found_on(finely_base, finely, 0.65, 0.9)
        if times_its_innovations(other.best) < FINER_FALL * left:
            return other, finely, FINER_WINDOWS
        found, experiments = found_on(base, usual, 0.9, 1.0)
    return found, experiments, 1
