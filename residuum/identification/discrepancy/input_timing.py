"""Whether inputs were held over their sample or moved evenly to the next one: what the data say."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from residuum.identification.discrepancy.averaged import averaged
from residuum.identification.discrepancy.prediction_windows import in_windows
from residuum.identification.discrepancy.structures import Structure, base_structure
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import Experiment, PhysicalModel, match
from residuum.identification.record import Record


def experiments_and_base(
    model: PhysicalModel, records: Sequence[Record], mapping: Mapping[str, str] | None, most: int
) -> tuple[list[Experiment], Structure]:
    """Experiments of at most about `most` samples, and the model re-estimated on them, at the likelier input timing.

    The two conventions differ by half a sample; the wrong one looks like a delay or a lag of that size.
    """
    model, experiments = match(model, records, mapping)
    tried = []
    for linear in (False, True):
        turned = [replace(e, hold=1.0 - e.hold) if linear else e for e in experiments]
        reduced = in_windows(model, averaged(turned, most))
        try:
            tried.append((reduced, base_structure(model, reduced)))
        except NotIdentifiable:
            if linear and not tried:
                raise
    return max(tried, key=lambda pair: pair[1].log_likelihood)
