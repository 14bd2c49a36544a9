"""What a search has tried and accepted so far."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.drifting_load import bears_a_drifting_load
from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.policy.acceptance import ALIKE
from residuum.identification.discrepancy.screening.score_test import Screened
from residuum.identification.discrepancy.searching.evidence import relative_evidence
from residuum.identification.physics import Key

FloatArray = npt.NDArray[np.float64]


@dataclass(eq=False)
class Search:
    """The structures that were tried.

    Attributes
    ----------
    base : Structure
        The model as it is, re-estimated.
    best : Structure
        Base plus the accepted effects.
    screened : mapping
        First-order result of every candidate against the base.
    accepted : list
        The effects that joined, one a step.
    before, alternatives : lists
        For each accepted effect the structure of the others, and candidate → the refitted structure with that candidate added;
        then those of the step that found no more.
    refuted : list
        Effects that the likelihood wanted, but whose held-out error rose: the search ends there.
    held_out : mapping
        Effect → held-out RMS errors of the outputs (before, with it), for those that were accepted or refuted.
    timing : list
        Delays and lags shorter than a sample that the data want: how the record was taken, not physics. They are in `best`.
    plain : list
        Accepted effects that few moments speak for, by what they take away elsewhere: tempered evidence does not say it.
    """

    base: Structure
    best: Structure
    count: int
    screened: dict[Key, Screened] = field(default_factory=dict)
    before: list[Structure] = field(default_factory=list)
    alternatives: list[dict[Key, Structure]] = field(default_factory=list)
    accepted: list[Key] = field(default_factory=list)
    refuted: list[Key] = field(default_factory=list)
    held_out: dict[Key, tuple[FloatArray, FloatArray]] = field(default_factory=dict)
    timing: list[Key] = field(default_factory=list)
    plain: list[Key] = field(default_factory=list)

    @property
    def drifting(self) -> bool:
        """Whether an unknown load or offset that drifts is taken to be there, whatever else is."""
        return self.base.drifting or bears_a_drifting_load(self.base)

    def values_of(self, key: Key) -> dict[str, float]:
        """Every parameter, by full name, where an accepted effect, or one that was tried instead, was estimated last."""
        tried = [alternatives[key] for alternatives in self.alternatives[: len(self.accepted)] if key in alternatives]
        return (tried[-1] if tried and key not in self.timing else self.best).model.values

    def alike(self, key: Key) -> list[Key]:
        """An accepted effect, and those that the experiments cannot tell from it, the likeliest first."""
        if key not in self.accepted:
            return [key]
        step = self.accepted.index(key)
        structures = self.alternatives[step]
        scores, _ = relative_evidence(structures, self.before[step])
        others = [k for k in structures if k != key and scores[key] - scores[k] < ALIKE and k not in self.accepted]
        return [key, *sorted(others, key=lambda k: -scores[k])]


def evidence_asked(found: Search, beyond: float) -> float:
    """Evidence that an effect needs: so much beyond the logarithm of how many there are to choose from."""
    return float(np.log(max(found.count, 1))) + beyond


Asked = Callable[[Search], bool]
"""A question about what was found so far."""


def never(_found: Search) -> bool:
    """For those who know of no fault in the experiments."""
    return False
