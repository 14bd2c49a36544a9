"""What a search on blocks may propose, and what it has tried so far."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from residuum.identification.physics import Key
from residuum.identification.unseen_blocks.comparing import is_alike
from residuum.identification.unseen_blocks.following import Track
from residuum.identification.unseen_blocks.judged import Judged
from residuum.identification.unseen_blocks.looks import Court
from residuum.identification.unseen_blocks.policy import ONE_PHYSICS
from residuum.identification.unseen_blocks.proposals import special_of
from residuum.identification.unseen_blocks.structure import Structure


@dataclass(frozen=True)
class Wanted:
    """What may be proposed: the effects of these ids (None: all), learned curves, values that the
    model holds.
    """

    effects: tuple[str, ...] | None = None
    learned: bool = False
    held: bool = True


@dataclass(eq=False)
class Search:
    """What was tried.

    `base` is the model as it is, `best` with what joined, both judged by `court`; `every` structure
    that was judged there by its keys; `group` those that cannot be told from the best; `tried` how
    many proposals the last level had; `proposed` what was looked at.
    """

    court: Court
    base: Judged
    best: Judged
    along: Track | None
    every: dict[tuple[Key, ...], Judged] = field(default_factory=dict)
    group: list[Judged] = field(default_factory=list)
    tried: int = 1
    proposed: set[Key] = field(default_factory=set)


def with_only(search: Search, keys: Iterable[Key], whole: Judged | None = None) -> Judged | None:
    """A structure, by default the best one, with these of its effects alone; None where that
    diverges.
    """
    names, whole = tuple(sorted(keys)), whole or search.best
    if names not in search.every:
        model = whole.model
        for use in whole.model.effects:
            if use.key in whole.keys and use.key not in names:
                model = model.without_effect(use.label)
        fit = search.court.judge(
            Structure(names, model, whole.structure.states, whole.structure.steps),
            steps=15,
            tolerance=1e-5,
        )
        if fit is None:
            return None
        search.every[names] = fit
    return search.every[names]


# The best structure taken apart: in which order its effects take away what, and what does the
# same in the place of each.


def chain(search: Search, keys: Iterable[Key]) -> list[tuple[Key, Judged, Judged]]:
    """The effects `keys` of the best structure in the order in which each takes away most, with
    what was before and after it.
    """
    remaining, before, order = list(keys), search.base, []
    while remaining:
        trials = [(key, with_only(search, (*before.keys, key))) for key in remaining]
        known = [(key, trial) for key, trial in trials if trial is not None]
        if not known:
            break
        key, after = min(known, key=lambda trial: trial[1].cost)
        order.append((key, before, after))
        remaining.remove(key)
        before = after
    return order


def in_place_of(search: Search, key: Key, context: Sequence[Key]) -> list[Judged]:
    """What does the same in the place of one of the best structure's effects, the others kept; each
    as it is beside the others.
    """
    best, retained, scale = search.best, set(search.best.keys) - {key}, search.court.scale
    without = search.every.get(tuple(sorted(retained)))
    rivals = [
        o
        for o in search.every.values()
        if o.keys != best.keys and len(o.keys) == len(best.keys) and set(o.keys) > retained
    ]
    same = []
    for rival in rivals:
        stand_in = next(iter(set(rival.keys) - retained))
        if is_alike(rival, best, without, scale) or (
            not scale.nats and _are_one_physics(rival, best, without, (stand_in, key))
        ):
            same.append(with_only(search, (*context, stand_in), rival))
    return [rival for rival in same if rival is not None]


def _are_one_physics(
    rival: Judged, best: Judged, without: Judged | None, keys: tuple[Key, Key]
) -> bool:
    """Whether of two effects one generalises the other, and the one in the other's place takes away
    nearly as much.
    """
    related = special_of(keys[0]) == keys[1] or special_of(keys[1]) == keys[0]
    return (
        related
        and without is not None
        and without.cost - rival.cost > ONE_PHYSICS * (without.cost - best.cost)
    )
