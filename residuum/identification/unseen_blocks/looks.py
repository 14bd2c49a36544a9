"""Looks at a proposal beside a structure: a glance from every first value, then the fit of the most promising.

Both kinds of glance are needed. Friction in a long oscillation shows on the whole record only, and there a wrong phase hides
everything else, which shows on short windows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residuum.identification.physics import Experiment, Key, PhysicalModel, Simulator
from residuum.identification.physics.effects.base import Effect
from residuum.identification.physics.model import find_effect
from residuum.identification.unseen_blocks.data import Data, Rung
from residuum.identification.unseen_blocks.following import Track
from residuum.identification.unseen_blocks.held_value import HELD
from residuum.identification.unseen_blocks.judged import Judged, judged
from residuum.identification.unseen_blocks.ladder import mean_error
from residuum.identification.unseen_blocks.policy import ABSURD, FOLLOWED_STARTS, GLANCED
from residuum.identification.unseen_blocks.proposals import beginnings, conditions_along
from residuum.identification.unseen_blocks.scale import Scale
from residuum.identification.unseen_blocks.structure import States, Structure, fitted

SHORT, LONG, SECOND = "short", "long", "second"


@dataclass(frozen=True, eq=False)
class Court:
    """What all structures of a level are judged by: the data, the rung of the judgement, the rung of short looks, the scale."""

    data: Data
    last: Rung
    middle: Rung
    scale: Scale

    def judge(self, structure: Structure, *, steps: int, tolerance: float) -> Judged | None:
        """The structure fitted on the last rung, and judged there; None where it diverges."""
        found = fitted(
            structure.model,
            self.last.parts,
            structure.states.get(self.last.windows),
            self.scale,
            steps=steps,
            tolerance=tolerance,
        )
        return None if found is None else judged(structure.at(self.last, found), found, self.last, self.data, self.scale)


@dataclass(frozen=True, eq=False)
class Glance:
    """A proposal beside a parent: by kind of look the error and the model after three steps; `sizes` are its first
    values, `along` is where the parent's filter went."""

    parent: Structure
    key: Key
    seen: Mapping[str, tuple[float, PhysicalModel]]
    sizes: Mapping[str, Sequence[float]]
    along: Track

    @property
    def keys(self) -> tuple[Key, ...]:
        """The parent's and its own."""
        return tuple(sorted((*self.parent.keys, self.key)))

    @property
    def hides(self) -> bool:
        """Whether it has states of its own: beside others it may do what it does not do alone."""
        _, model = next(iter(self.seen.values()))
        return len(Simulator(model).states) > len(Simulator(self.parent.model).states)


def glance(parent: Structure, key: Key, along: Track, court: Court, given: Track | None = None) -> Glance | None:
    """A step from each first value and two more from the best, on short windows and on the last rung; None where all diverge.

    `given` is the track of the model as it was given: what is missing may have driven the values that were fitted far away.
    """
    first = beginnings(key, along) + ([] if given is None else beginnings(key, given))
    sizes: dict[str, list[float]] = {}
    for model in first:
        for name, value in _values(model, key).items():
            sizes.setdefault(name, []).append(abs(value))
    seen: dict[str, tuple[float, PhysicalModel]] = {}
    looks = [(LONG, court.last.parts, parent.states[court.last.windows])]
    if court.middle is not court.last and not court.scale.nats:
        few, which = court.middle.thinned(GLANCED)
        looks.append((SHORT, few, parent.states[court.middle.windows][which]))
    for kind, parts, states in looks:
        each = sorted(_glimpsed(first, parts, states, parent, court), key=lambda one: one[0])[:FOLLOWED_STARTS]
        further = [_steps(model, parts, states, parent, court, 2) for _, model in each]
        again = [one for one in further if one is not None] or each
        again.sort(key=lambda one: one[0])
        if again:
            seen[kind] = again[0]
        if len(again) > 1 and court.scale.nats:  # small effects of the wrong shape mislead
            seen[SECOND] = again[1]
    return Glance(parent, key, seen, sizes, along) if seen else None


def _glimpsed(
    models: Sequence[PhysicalModel], parts: Sequence[Experiment], states: States, parent: Structure, court: Court
) -> list[tuple[float, PhysicalModel]]:
    """Errors after one step from each first value, and the models there."""
    each = [_steps(model, parts, states, parent, court, 1) for model in models]
    return [one for one in each if one is not None]


def _steps(
    model: PhysicalModel, parts: Sequence[Experiment], states: States, parent: Structure, court: Court, steps: int
) -> tuple[float, PhysicalModel] | None:
    found = fitted(
        model, parts, states, court.scale, steps=steps, tolerance=1e-3, substeps=_substeps(model, parts, parent, court)
    )
    return None if found is None else (mean_error(found, court.scale), found.model)


def _substeps(model: PhysicalModel, parts: Sequence[Experiment], parent: Structure, court: Court) -> list[int] | None:
    """Those of the parent, where the model has no states more that may be faster."""
    if len(Simulator(model).states) > len(Simulator(parent.model).states):
        return None
    return [max(parent.steps[court.last.windows])] * len(parts)


def look(seen: Glance, court: Court, *, any_value: bool = False) -> Judged | None:
    """The full fit, from the best of the short glances by way of the middle rung and from the best long ones; the best one
    judged.

    None where all diverge or, unless `any_value` will do, their values refuse them.
    """
    parent, best = seen.parent, None
    for kind, (_, model) in seen.seen.items():
        structure = Structure(seen.keys, model, parent.states, parent.steps)
        if kind == SHORT:
            states = parent.states[court.middle.windows]
            near = fitted(model, court.middle.parts, states, court.scale, steps=8, tolerance=1e-3)
            if near is None:
                continue
            structure = structure.at(court.middle, near)
        best = _lower(best, _fully(structure, seen, court, any_value), court)
    return best


def follow(models: Sequence[PhysicalModel], seen: Glance, states: Structure, court: Court) -> Judged | None:
    """The lowest of the full fits from other first values of what was glanced at."""
    best = None
    for model in models:
        best = _lower(best, _fully(Structure(seen.keys, model, states.states, states.steps), seen, court), court)
    return best


def _fully(structure: Structure, seen: Glance, court: Court, any_value: bool = False) -> Judged | None:
    found = court.judge(structure, steps=15, tolerance=1e-6 if court.scale.nats else 1e-4)
    if found is None or any_value:
        return found
    return None if _is_absurd(found.model, seen) or not _shows(found.model, seen, court) else found


def _lower(one: Judged | None, other: Judged | None, court: Court) -> Judged | None:
    """The one whose fit leaves less of what it has seen."""
    if one is None or other is None:
        return one or other
    return one if one.seen <= other.seen else other


def _values(model: PhysicalModel, key: Key) -> dict[str, float]:
    if key.effect == HELD:
        return {}
    use = next(use for use in model.effects if use.key == key)
    return {name: p.value for name, p in use.parameters.items()}


def _shows(model: PhysicalModel, seen: Glance, court: Court) -> bool:
    """Whether the effect can be told from an unknown load within a window: a far body on a soft spring is one."""
    if seen.key.effect == HELD or type(find_effect(seen.key.effect)).shows is Effect.shows:
        return True
    conditions = replace(conditions_along(seen.key, seen.along), duration=max(p.n * p.sample_time for p in court.last.parts))
    return find_effect(seen.key.effect).shows(_values(model, seen.key), conditions)


def _is_absurd(model: PhysicalModel, seen: Glance) -> bool:
    """Whether a value left all its first values: a ripple without a period is a load."""
    for name, value in _values(model, seen.key).items():
        known = [v for v in seen.sizes.get(name, ()) if v > 0]
        if known and (abs(value) > ABSURD * max(known) or 0 < abs(value) < min(known) / (100.0 * ABSURD)):
            return True
    return not np.all(np.isfinite(list(model.values.values())))
