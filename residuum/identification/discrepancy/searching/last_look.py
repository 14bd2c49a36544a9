"""A last look at what a search found: is each effect, where it was estimated last, still one that the records show?"""

from __future__ import annotations

from collections.abc import Sequence

from residuum.identification.discrepancy.fitting.structure_comparison import within_a_sample
from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.searching.growth import without
from residuum.identification.discrepancy.searching.search_state import Search
from residuum.identification.discrepancy.searching.soundness import shows
from residuum.identification.physics import Experiment, Key


def keep_what_shows(found: Search, experiments: Sequence[Experiment]) -> None:
    """Take out of a search, and of what was tried beside, the effects whose last estimate can be told from no unknown load.

    An effect is looked at when it joins; what joins later moves it, and a stop may end where the machine always leans on it: a
    spring under a stop's name. What the data wanted under that name counts as refuted.
    """
    for key in list(found.accepted):
        if _is_there(key, found.best, experiments):
            continue
        others = without(found.best, key, experiments)
        if others is None:
            continue
        at = found.accepted.index(key)
        for steps in (found.accepted, found.before, found.alternatives):
            del steps[at]
        found.best = others
        found.refuted.append(key)
    found.alternatives[:] = [
        {key: s for key, s in tried.items() if key in found.accepted or _is_there(key, s, experiments)}
        for tried in found.alternatives
    ]


def _is_there(key: Key, structure: Structure, experiments: Sequence[Experiment]) -> bool:
    return within_a_sample(structure, key, experiments) or shows(structure, key, experiments)
