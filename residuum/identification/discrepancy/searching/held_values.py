"""Held values: parameters that the model holds fixed, where another value does more than the effects that were found.

A mass that is a tenth too large looks like an elasticity or a load. An estimate of what is free cannot mend it, and the likeliest
effect stands in for it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from residuum.identification.discrepancy.fitting.structure_comparison import schwarz, simulates_no_worse
from residuum.identification.discrepancy.fitting.structure_fits import refit
from residuum.identification.discrepancy.fitting.structures import NO_RIVAL, Rival, Structure, times_its_innovations
from residuum.identification.discrepancy.policy.acceptance import ACCEPT, ALIKE, HELD_STANDARD_DEVIATIONS
from residuum.identification.discrepancy.searching.search_state import Search, evidence_asked
from residuum.identification.physics import Experiment, PhysicalModel
from residuum.identification.residual_analysis.policy.noise import NOISE_ALONE
from residuum.identification.side_by_side import side_by_side
from residuum.identification.unseen_blocks.held_value import HeldValue, freed


def wrongly_held(found: Search, experiments: Sequence[Experiment]) -> list[str]:
    """Fixed parameters of which each does more, freed, than the last effects that were found, or is wanted beside them: the
    likeliest, and those that cannot be told from it.

    It takes the place of effects where it is likelier, its own price paid, than all of them; a tie is an effect's. Beside them it
    is wanted only where more than noise is left.
    """
    steps = found.before[: len(found.accepted)]
    steps += [found.best] if times_its_innovations(found.best) > NOISE_ALONE else []
    names = [n for n, p in found.base.model.parameters.items() if p.fixed and p.value != 0.0]
    tried = side_by_side(lambda one: _with_free(one[0], one[1], found, experiments), [(s, n) for s in steps for n in names])
    likelier = sorted((one for one in tried if one is not None), reverse=True)
    return list(dict.fromkeys(name for score, name in likelier if score > likelier[0][0] - ALIKE))


def _with_free(before: Structure, name: str, found: Search, experiments: Sequence[Experiment]) -> tuple[float, str] | None:
    """Schwarz's criterion of the structure with one parameter free, where that does more than what was found."""
    mark = schwarz(found.best, found.base) + (evidence_asked(found, ACCEPT) if before is found.best else ACCEPT)
    rival = NO_RIVAL if before is found.best else Rival(mark)
    free = refit(before, freed(before.model, [name]), experiments, rival=rival)
    if free is None or schwarz(free, found.base) < mark or name in free.at_bound or not simulates_no_worse(free, before):
        return None
    k, held = free.parameters.index(name), before.model.parameters[name].value
    plain = np.isfinite(free.std[k]) and abs(free.model.values[name] - held) > HELD_STANDARD_DEVIATIONS * free.std[k]
    return (schwarz(free, found.base), name) if plain else None


def held_values(model: PhysicalModel, groups: Sequence[Sequence[str]], best: Structure) -> tuple[HeldValue, ...]:
    """What was freed, the first of each group: its value in the model, and in what was found."""
    std, known = dict(zip(best.parameters, best.std.tolist(), strict=True)), model.parameters
    return tuple(
        HeldValue(n, known[n].value, best.model.values[n], std[n], known[n].unit, tuple(others)) for n, *others in groups
    )
