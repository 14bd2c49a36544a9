"""Looks at the catalogue: all candidates on top of a structure, screened and the likeliest refitted; none is tried twice."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.policy.likelihood import SAME
from residuum.identification.discrepancy.policy.trials import NEAR
from residuum.identification.discrepancy.screening.score_test import Screen, Screened
from residuum.identification.discrepancy.searching.trials import trials
from residuum.identification.physics import Experiment, Key, PhysicalModel, candidates, find_effect


@dataclass(frozen=True)
class Task:
    """What one search is about: data, the model with its nominal values, effects to consider, how many to refit and to accept.

    `tell` hears of every look at the catalogue; `looks` are those that were taken, by the effects in the model; `shot` are
    structures that were found over short stretches, for the looks from which one effect leads there.
    """

    experiments: Sequence[Experiment]
    nominal: PhysicalModel | None
    wanted: tuple[str, ...] | None
    refits: int
    most_effects: int
    tell: Callable[[str], None] = field(default=lambda _doing: None)
    looks: dict[frozenset[str], Look] = field(default_factory=dict)
    shot: list[Structure] = field(default_factory=list)

    def look(self, structure: Structure, without: Key | None = None) -> Look:
        """All candidates on top of a structure, or all but one; those that were tried there before are not tried again."""
        effects = frozenset(use.label for use in structure.model.effects)
        pairs = [pair for pair in self.candidates(structure) if pair != without]
        look = self.looks.get(effects)
        if look is None or not look.is_from(structure):
            look = self.looks[effects] = Look(Screen(structure, self.experiments, self.origin(structure)))
        if new := [pair for pair in pairs if pair not in look.tried]:
            beside = ", ".join(use.id for use in structure.model.effects)
            self.tell("trying the effects of the catalogue" + (f" beside {beside}" if beside else ""))
            look.add(*trials(look.screen, new, self.refits), new)
        look.add(self._one_effect_away(structure, pairs, look.refitted), (), ())
        return look

    def _one_effect_away(
        self, structure: Structure, pairs: Sequence[Key], known: Mapping[Key, Structure]
    ) -> dict[Key, Structure]:
        """Of the structures found over short stretches those with one effect more, where likelier than what is `known`."""
        here = _effects(structure)
        found: dict[Key, Structure] = {}
        for other in self.shot:
            more = _effects(other) - here
            if len(more) == 1 and _effects(other) > here and (key := next(iter(more))) in pairs:
                likelier = key not in known or other.log_likelihood > known[key].log_likelihood
                found |= {key: other} if likelier else {}
        return found

    def candidates(self, structure: Structure) -> list[Key]:
        """Those that the structure does not have yet."""
        fitting: list[Key] = list(candidates(structure.model, self.wanted))
        return fitting if self.wanted is not None else [key for key in fitting if find_effect(key[0]).exact]

    def origin(self, structure: Structure) -> PhysicalModel:
        """The structure's model, at its nominal values where the estimation led some of them away."""
        if self.nominal is None or not strayed(self.nominal, structure, NEAR):
            return structure.model
        values = self.nominal.values
        return structure.model.with_values({n: values[n] for n in structure.parameters if n in self.nominal.parameters})


@dataclass(eq=False)
class Look:
    """Candidates on top of one structure: as screened, refitted, and which were tried."""

    screen: Screen
    refitted: dict[Key, Structure] = field(default_factory=dict)
    tested: list[Screened] = field(default_factory=list)
    tried: set[Key] = field(default_factory=set)

    def is_from(self, structure: Structure) -> bool:
        """Whether the structure is the one that was looked from, to what the likelihood can tell."""
        base = self.screen.base
        return base.drifting == structure.drifting and abs(base.log_likelihood - structure.log_likelihood) < SAME

    def add(self, refitted: Mapping[Key, Structure], tested: Iterable[Screened], tried: Iterable[Key]) -> None:
        """What else was tried there."""
        self.refitted |= refitted
        self.tested += tested
        self.tried |= set(tried)


def _effects(structure: Structure) -> set[Key]:
    return {use.key for use in structure.model.effects}


def strayed(nominal: PhysicalModel, structure: Structure, factor: float) -> list[str]:
    """Free parameters that lie farther than this factor from their nominal values."""
    known = {n: p.value for n, p in nominal.parameters.items() if n in structure.parameters and p.value != 0.0}
    return [n for n, value in known.items() if not 1.0 / factor < abs(structure.model.values[n] / value) < factor]
