"""Effects of which one is a special case of another: each is tried from where the other one fits."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from functools import partial

from residuum.identification.physics import Key
from residuum.identification.side_by_side import each_beside
from residuum.identification.unseen_blocks.following import Track, followed
from residuum.identification.unseen_blocks.judged import Judged
from residuum.identification.unseen_blocks.looks import Glance, follow
from residuum.identification.unseen_blocks.policy import BEAM
from residuum.identification.unseen_blocks.proposals import generalised, grown, special_of, specialised
from residuum.identification.unseen_blocks.structure import Structure
from residuum.identification.unseen_blocks.tried import Search


def related(
    found: Search, here: Mapping[tuple[Key, ...], Judged], glances: Mapping[tuple[Key, ...], Glance]
) -> dict[tuple[Key, ...], Judged]:
    """Effects that generalise one of the best, or are it with many minima side by side, followed from where that one fits, and
    special cases from where the general one does. From nothing they may not be reached, or end on the way; and what joined first
    as the general case may be a special one beside another.
    """
    tasks = []
    for one in sorted(here.values(), key=lambda one: one.cost)[:BEAM]:
        general = [seen for seen in glances.values() if _is_for(seen, one, generalised(seen.key))]
        special = [
            seen for seen in glances.values() if any(special_of(k) == seen.key and _is_for(seen, one, k) for k in one.keys)
        ]
        plain = [k for k in one.keys if special_of(k) in found.proposed.difference(one.keys, (seen.key for seen in special))]
        if not (general or special or plain):
            continue
        along = followed(one.model, found.court.data, one.errors, found.court.last)
        if along is not None:
            each = [(seen, grown(seen.key, along)) for seen in general] + [
                (seen, specialised(seen.key, along)) for seen in special
            ]
            tasks += [partial(follow, models, seen, one.structure, found.court) for seen, models in each if models]
            tasks += [partial(_in_place, one.structure, k, along, found) for k in plain]
    led = each_beside(lambda task: task(), tasks)
    better: dict[tuple[Key, ...], Judged] = {}
    for end in led:
        known = None if end is None else better.get(end.keys, here.get(end.keys))
        if end is not None and (known is None or end.seen < known.seen):
            better[end.keys] = end
    return better


def _in_place(whole: Structure, key: Key, along: Track, found: Search) -> Judged | None:
    """The structure with the special case in the place of an effect, where it was not tried."""
    special = special_of(key)
    if special is None:
        return None
    keys, models = tuple(sorted({*whole.keys, special} - {key})), specialised(special, along)
    if keys in found.every or not models:
        return None
    return found.court.judge(replace(whole, keys=keys, model=models[0]), steps=15, tolerance=1e-6)


def _is_for(seen: Glance, one: Judged, other: Key | None) -> bool:
    """Whether a structure holds what was glanced at, but for another effect in the place of the new one."""
    return other in one.keys and set(one.keys) - {other} == set(seen.keys) - {seen.key}
