"""The input timing that suits what was found: the timing of the data was chosen before anything was."""

from __future__ import annotations

from operator import itemgetter

from residuum.identification.unseen_blocks.coarser import one_turned, turned
from residuum.identification.unseen_blocks.data import Data
from residuum.identification.unseen_blocks.ladder import innovations_on
from residuum.identification.unseen_blocks.tried import Search


def at_the_timing_it_suits(found: Search) -> Data | None:
    """The data at the other input timing, where the best structure fits better there; None where it does not, or nothing drives
    the machine.
    """
    court = found.court
    if not found.best.model.inputs:
        return None
    here = _innovations(found, court.data)
    others = [(_innovations(found, data), data) for data in (turned(court.data), *one_turned(court.data))]
    there, data = min(others, key=itemgetter(0))
    return data if there < here else None


def _innovations(found: Search, data: Data) -> float:
    court = found.court
    rung = court.last if data is court.data else data.rung(court.last.windows)
    return innovations_on(rung, found.best.model, found.best.structure, court.scale)
