"""Growing a structure: effects join while the data want one more, and give way to others that do more together."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from residuum.identification.discrepancy.fitting.structure_comparison import (
    mean_ratio,
    schwarz,
    simulates_no_worse,
    within_a_sample,
)
from residuum.identification.discrepancy.fitting.structure_fits import in_likelier_order, refit
from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.policy.acceptance import (
    ACCEPT,
    ACCEPT_MORE,
    ALIKE,
    PLAIN_GAIN,
    PLAINLY_LESS,
    READING_FALL,
)
from residuum.identification.discrepancy.policy.likelihood import HIGHER, LOWER_TOP
from residuum.identification.discrepancy.screening.score_test import Screen
from residuum.identification.discrepancy.searching.evidence import preferred, relative_evidence, tempered_gain
from residuum.identification.discrepancy.searching.holding_up import held_out_errors, holds_up
from residuum.identification.discrepancy.searching.looks import Task
from residuum.identification.discrepancy.searching.search_state import Asked, Search, evidence_asked, never
from residuum.identification.discrepancy.searching.trials import followed, polished
from residuum.identification.physics import Experiment, Key, find_effect


def grow(found: Search, task: Task, late: Asked = never) -> None:
    """Add effects while the evidence wants one more; what the last step tried stands after those of the accepted ones.

    Where a shift in time was accepted it ends if that is too `late`: at the other input timing fewer effects may do.
    """
    del found.before[len(found.accepted) :], found.alternatives[len(found.accepted) :]
    while len(found.accepted) < task.most_effects and _one_more(found, task, late):
        pass


def _one_more(found: Search, task: Task, late: Asked) -> bool:
    """Take the step that the evidence wants; whether another may follow."""
    refitted, screen = _step(found, task)
    _leave_to_the_noise(refitted, found.best)
    key = _wanted(found, refitted, task.experiments)
    if key is not None and _is_timing(key, refitted, found.best, task.experiments):
        found.timing.append(key)
        _stand_on(found, refitted[key])
        return not (found.accepted and late(found))
    if key is not None and (higher := _climbed_without(refitted[key], key, found, task.experiments)):
        _stand_on(found, higher)
        return True
    found.before.append(found.best)
    found.alternatives.append(refitted)
    if key is None:
        return False
    if not holds_up(found, key, refitted[key], task.experiments):
        found.refuted.append(key)
        return False
    refitted[key] = in_likelier_order(followed(screen, key, refitted[key]), key, task.experiments)
    found.best = refitted[key]
    found.accepted.append(key)
    return not (find_effect(key.effect).shifts and late(found))


def _wanted(found: Search, refitted: dict[Key, Structure], experiments: Sequence[Experiment]) -> Key | None:
    """The candidate whose evidence against adding nothing is enough, or that takes most of the error away; None where none is."""
    key, wins = winner(refitted, found.best, evidence_asked(found, ACCEPT_MORE if found.accepted else ACCEPT))
    if wins:
        return key
    plain = _rare_but_plain(found, refitted, experiments)
    if plain is not None:
        found.plain.append(plain)
    return plain


def _stand_on(found: Search, structure: Structure) -> None:
    """Go on from a structure without a step of its own; the base is that too where nothing was accepted yet."""
    found.best = structure
    found.base = found.base if found.accepted else structure


def _climbed_without(structure: Structure, key: Key, found: Search, experiments: Sequence[Experiment]) -> Structure | None:
    """The structure without its new effect, climbed from where that led to, when it ends higher than where it was left.

    The likelihood of what sticks and slides has many tops; any effect may lead from a lower one to a higher, and would seem
    missing. The first effect is believed where it gains more than that; a later one may have found the place of those before.
    """
    before = found.best.log_likelihood
    if not found.accepted and structure.log_likelihood > before + LOWER_TOP:
        return None
    less = without(structure, key, experiments)
    return less if less is not None and less.log_likelihood > before + HIGHER else None


def _leave_to_the_noise(refitted: dict[Key, Structure], best: Structure) -> None:
    """Take out the quantisation that is likeliest of all and yet lowers no error plainly. Noise larger than its steps carries
    the reading over them, so it is a part of that noise.
    """
    while (key := preferred(refitted, best)) is not None and find_effect(key[0]).of_the_reading:
        if simulates_no_worse(refitted[key], best, READING_FALL):
            break
        del refitted[key]


def winner(refitted: Mapping[Key, Structure], before: Structure, asked: float) -> tuple[Key | None, bool]:
    """The preferred candidate, and whether its evidence against adding nothing is enough.

    Where it is not, of those whose own is: of two that few moments tell apart the one with fewer parameters is preferred, and
    may be wanted by those few alone.
    """
    nothing = relative_evidence(refitted, before)[1]
    if -nothing >= asked:
        return preferred(refitted, before), True
    wanted = {key: s for key, s in refitted.items() if tempered_gain(s, before) - s.penalty(before) >= asked}
    key = preferred(wanted, before)
    return (preferred(refitted, before), False) if key is None else (key, True)


def _step(found: Search, task: Task) -> tuple[dict[Key, Structure], Screen]:
    look = task.look(found.best)
    if not found.accepted:
        found.screened = {s.key: s for s in look.tested}
    return dict(look.refitted), look.screen


def _is_timing(winner: Key, refitted: Mapping[Key, Structure], before: Structure, experiments: Sequence[Experiment]) -> bool:
    """Whether a shift in time by less than a sample wins, and no physics that would do the same lies close."""
    evidence, _ = relative_evidence(refitted, before)
    close = [winner, *(key for key, value in evidence.items() if value > -ALIKE)]
    return all(within_a_sample(refitted[key], key, experiments) for key in close)


def _rare_but_plain(found: Search, refitted: dict[Key, Structure], experiments: Sequence[Experiment]) -> Key | None:
    """The likeliest effect where few moments speak for it (a stop, a limit). Estimated in full, it takes most of the error
    away on data not used.

    Tempering makes each moment worth two units, whatever it shows; an error that vanishes elsewhere too is no lucky moment.
    """
    inside = {key: s for key, s in refitted.items() if preferred({key: s}, found.best) is not None}
    key = max(inside, key=lambda each: schwarz(inside[each], found.best), default=None)
    if key is None or schwarz(inside[key], found.best) - found.best.log_likelihood < evidence_asked(found, PLAIN_GAIN):
        return None
    refitted[key] = polished(refitted[key], experiments)
    errors = held_out_errors(found.best, refitted[key], experiments)
    return key if errors is not None and mean_ratio(errors[1], errors[0]) < PLAINLY_LESS else None


def without(structure: Structure, key: Key, experiments: Sequence[Experiment]) -> Structure | None:
    """The structure re-estimated without one of its effects, whose part one that generalises it takes; None when it diverges."""
    label, values = structure.label_of(key), structure.model.values
    others = [use for use in structure.model.effects if use.target == key[1] and use.label != label]
    heirs = [use for use in others if use.effect.generalises == key[0]]
    parts = {f"{use.label}.{n}": values[f"{label}.{n}"] for use in heirs for n in use.effect.sizes if f"{label}.{n}" in values}
    less = structure.model.without_effect(label).with_values({n: values[n] + part for n, part in parts.items()})
    return refit(structure, less, experiments)
