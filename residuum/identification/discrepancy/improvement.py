"""What an improvement is: the model with provenance, and how its error on data kept aside fell."""

from __future__ import annotations

import datetime
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from residuum.identification.discrepancy.explain import Explanation
from residuum.identification.physics import EffectUse, PhysicalModel
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.verdict import Candidate, Quantity, Remaining
from residuum.identification.work import Work

# Keys of an effect's provenance: the held-out error with it, and the standard deviation of a
# parameter.
_ERROR_AFTER, _STD = "error_after", "std_"


@dataclass(frozen=True)
class Step:
    """One line of the history. It says what was added (None: the model as it was; a parameter that
    was freed), the held-out error after it, what remains on unseen blocks then, and `at` which
    place an effect joined.
    """

    added: str | None
    error: float
    remaining: Remaining | None = None
    at: str | None = None

    def joined(self, model: PhysicalModel) -> EffectUse | None:
        """The effect of this line in a model, the last of its kind at its place; None where it is
        none, or was dropped again beside what joined later.
        """
        uses = [use for use in model.effects if (use.id, use.target) == (self.added, self.at)]
        return uses[-1] if uses else None


@dataclass(frozen=True, eq=False)
class Improvement:
    """The improved model with provenance, and how its error on held-out data (`aside`) fell, in
    `error_unit` of `output`.

    `refused` are effects that `explain` names, and that did not join since the error would have
    risen; where none joined, nothing is to be written. `work` is what it took, and what was not
    tried.
    """

    model: PhysicalModel
    history: tuple[Step, ...]
    verdict: str
    output: str
    error_unit: str
    explanation: Explanation | None
    aside: str
    refused: tuple[str, ...] = ()
    work: Work = field(default_factory=Work)

    @property
    def helps(self) -> bool:
        """Whether it is worth writing: not where all that was named would make the model worse."""
        return not self.refused or len(self.history) > 1

    @property
    def added(self) -> list[EffectUse]:
        """The effects that joined and stayed, estimated on everything; `quantities_of` tells their
        sizes.
        """
        joined = [step.joined(self.model) for step in self.history]
        return [use for use in joined if use is not None]

    def candidate(self, use: EffectUse) -> Candidate | None:
        """An effect that was added, as `explain` judged it on the rest; None where it was asked
        for, or joined beside values that `explain` would free.
        """
        if self.explanation is None or use.key not in self.explanation.found.best.keys:
            return None
        # what joined later is a rival of the first step, too
        judged = [c for c in self.explanation.candidates if c.key == use.key]
        return max(judged, key=lambda candidate: candidate.step, default=None)


def with_provenance(
    model: PhysicalModel,
    std: Mapping[str, float],
    records: Sequence[Record],
    history: Sequence[Step],
    output: str,
    unit: str,
) -> PhysicalModel:
    """Each effect with its records, date, held-out error before and after, and the standard
    deviation of its parameters.
    """
    for before, after in pairwise(history):
        use = after.joined(model)
        if use is None:
            continue
        note = {
            "records": ", ".join(record.source for record in records),
            "date": datetime.datetime.now(datetime.UTC).date().isoformat(),
            "output": output,
            "error_before": before.error,
            _ERROR_AFTER: after.error,
            "error_unit": unit,
        }
        note |= {
            # What the records did not determine has no deviation, and JSON no infinity.
            _STD + n: float(s)
            for n in use.parameters
            if np.isfinite(s := std.get(f"{use.label}.{n}", np.nan))
        }
        model = model.with_provenance(use.label, note)
    return model


def quantities_of(use: EffectUse) -> dict[str, Quantity]:
    """The parameters of an effect that was added, with their standard deviations: 0 where held,
    infinite where undetermined.
    """
    doubts = {
        # An effect whose file says no deviation may have any.
        n: 0.0 if p.fixed else float(use.provenance.get(_STD + n, np.inf))
        for n, p in use.parameters.items()
    }
    return {n: Quantity(p.value, doubts[n], p.unit) for n, p in use.parameters.items()}
