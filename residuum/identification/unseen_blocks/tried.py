"""What a search on blocks may propose, and what it has tried so far."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from residuum.identification.physics import Key
from residuum.identification.unseen_blocks.following import Track
from residuum.identification.unseen_blocks.judged import Judged
from residuum.identification.unseen_blocks.looks import Court
from residuum.identification.unseen_blocks.structure import Structure


@dataclass(frozen=True)
class Wanted:
    """What may be proposed: the effects of these ids (None: all), learned curves, values that the model holds."""

    effects: tuple[str, ...] | None = None
    learned: bool = False
    held: bool = True


@dataclass(eq=False)
class Search:
    """What was tried.

    `base` is the model as it is, `best` with what joined, both judged by `court`; `every` structure that was judged there by
    its keys; `group` those that cannot be told from the best; `tried` how many proposals the last level had; `proposed` what was
    looked at.
    """

    court: Court
    base: Judged
    best: Judged
    along: Track | None
    every: dict[tuple[Key, ...], Judged] = field(default_factory=dict)
    group: list[Judged] = field(default_factory=list)
    tried: int = 1
    proposed: set[Key] = field(default_factory=set)


def with_only(found: Search, keys: Iterable[Key], whole: Judged | None = None) -> Judged | None:
    """A structure, by default the best one, with these of its effects alone; None where that diverges."""
    names, whole = tuple(sorted(keys)), whole or found.best
    if names not in found.every:
        model = whole.model
        for use in whole.model.effects:
            if use.key in whole.keys and use.key not in names:
                model = model.without_effect(use.label)
        one = found.court.judge(Structure(names, model, whole.structure.states, whole.structure.steps), steps=15, tolerance=1e-5)
        if one is None:
            return None
        found.every[names] = one
    return found.every[names]
