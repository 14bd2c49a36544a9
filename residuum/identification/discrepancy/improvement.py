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
    """One line of the history. It says what was added (None: the model as it was, `-id`: dropped),
    the held-out error after it, and what remains on unseen blocks then, where it was asked.
    """

    added: str | None
    error: float
    remaining: Remaining | None = None


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
        ids = [step.added for step in self.history]
        return [
            use for use in self.model.effects if use.id in ids and _ERROR_AFTER in use.provenance
        ]

    def candidate(self, use: EffectUse) -> Candidate | None:
        """An effect that was added, as `explain` judged it on the rest; None where it was asked
        for.
        """
        candidates = () if self.explanation is None else self.explanation.candidates
        return next((c for c in candidates if c.key == use.key), None)


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
        use = next((u for u in model.effects if u.id == after.added), None)
        # Dropped again beside what joined later.
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
