"""Effects that generalise others: tried from where those fit, and those from where they do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.start_values import inside_bounds
from residuum.identification.discrepancy.fitting.structure_comparison import likelier, rival_of, schwarz
from residuum.identification.discrepancy.fitting.structure_fits import refit
from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.policy.acceptance import ACCEPT
from residuum.identification.discrepancy.policy.likelihood import LOWER_TOP
from residuum.identification.discrepancy.policy.trials import GENERALISED_SHARE
from residuum.identification.discrepancy.screening.score_test import Screen
from residuum.identification.discrepancy.searching.soundness import at_estimate, is_sound
from residuum.identification.physics import Experiment, Key, PhysicalModel, candidates
from residuum.identification.physics.model import find_effect
from residuum.identification.side_by_side import side_by_side

FloatArray = npt.NDArray[np.float64]


def that_say_more(refitted: dict[Key, Structure]) -> dict[Key, Structure]:
    """All but effects whose estimate is that of a special one that lies near. Where a machine sticks and slides the likelihood
    has steps, and a maximum is higher by chance alone.
    """
    found = dict(refitted)
    for key, general in refitted.items():
        effect = find_effect(key.effect)
        special = refitted.get(Key(effect.generalises, key.target))
        if special is None or special is general or special.log_likelihood < general.log_likelihood - LOWER_TOP:
            continue
        label = f"{general.label_of(key)}."
        values = {n.removeprefix(label): v for n, v in general.model.values.items() if n.startswith(label)}
        doubts = dict(zip(general.parameters, general.std.tolist(), strict=True))
        std = {n: doubts.get(f"{label}{n}", 0.0) for n in values}
        if not effect.says_more(values, std):
            del found[key]
    return found


def grown(screen: Screen, pairs: Sequence[Key], refitted: Mapping[Key, Structure]) -> dict[Key, Structure]:
    """Effects that generalise one that fits well, refitted from its estimate: from nothing they may not be reached."""
    best, experiments, rival = screen.base, screen.experiments, rival_of(refitted.values())
    well = max(ACCEPT, GENERALISED_SHARE * (rival.log_likelihood - best.log_likelihood))
    starts: list[tuple[PhysicalModel, Sequence[FloatArray]]] = []
    for id, target in pairs:
        special = refitted.get(Key(find_effect(id).generalises, target))
        if special is None or special.log_likelihood - best.log_likelihood < well:
            continue
        known = best.model.with_values({n: v for n, v in special.model.values.items() if n in best.model.all_parameters})
        initial = special.initial if find_effect(id).generalises == id else best.initial
        each = _grown_starts(id, target, special, experiments)
        starts += [(known.with_effect(id, target, inside_bounds(known, id, target, values)), initial) for values in each]
    structures = side_by_side(lambda one: refit(best, one[0], experiments, initial=one[1], rival=rival), starts)
    found: dict[Key, Structure] = {}
    for (model, _), structure in zip(starts, structures, strict=True):
        key = model.effects[-1].key
        if structure is not None and is_sound(structure, key, screen):
            found = likelier(found, {key: structure})
    return found


def simplified(screen: Screen, refitted: Mapping[Key, Structure]) -> dict[Key, Structure]:
    """Effects refitted from the estimate of one that generalises them, where that one does better: they may have been stuck, or
    not been among the likeliest to first order.
    """
    best, experiments = screen.base, screen.experiments
    found: dict[Key, Structure] = {}
    for (id, target), general in refitted.items():
        key = Key(find_effect(id).generalises, target)
        special, label = found.get(key, refitted.get(key)), general.label_of(Key(id, target))
        reached = best.log_likelihood + ACCEPT if special is None else schwarz(special, best)
        if key not in candidates(best.model, [key[0]] if key[0] else []) or schwarz(general, best) <= reached:
            continue
        own = {n.removeprefix(f"{label}."): v for n, v in general.model.values.items() if n.startswith(f"{label}.")}
        values = find_effect(id).specialised(own, screen.conditions(find_effect(id), target))
        if not values:
            continue
        known = {n: v for n, v in general.model.values.items() if n in best.model.all_parameters}
        model = best.model.with_values(known)
        model = model.with_effect(*key, inside_bounds(model, *key, values))
        again = refit(best, model, experiments, initial=general.initial)
        higher = again is not None and (special is None or again.log_likelihood > special.log_likelihood)
        if again is not None and higher and is_sound(again, key, screen):
            found[key] = again
    return found


def _grown_starts(id: str, target: str, special: Structure, experiments: Sequence[Experiment]) -> Sequence[Mapping[str, float]]:
    longest = int(np.argmax([e.n for e in experiments]))
    effect = find_effect(id)
    return effect.grown(*at_estimate(special, Key(effect.generalises, target), experiments, longest, effect))
