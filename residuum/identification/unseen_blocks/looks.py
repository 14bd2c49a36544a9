"""Looks at a proposal beside a structure: a glance from every first value, then the fit of the most
promising.

Both kinds of glance are needed. Friction in a long oscillation shows on the whole record only, and
there a wrong phase hides everything else, which shows on short windows.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.physics import Key, PhysicalModel, Simulator
from residuum.identification.physics.effects.base import Effect
from residuum.identification.physics.estimation.gauss_newton import Fit
from residuum.identification.unseen_blocks.data import Data, Rung
from residuum.identification.unseen_blocks.following import Track
from residuum.identification.unseen_blocks.judged import Judged, judged
from residuum.identification.unseen_blocks.next_experiment import HELD
from residuum.identification.unseen_blocks.policy import (
    ABSURD,
    FOLLOWED_STARTS,
    GLANCED,
    LONG_LOOK,
    PROMISING,
    RAN_OFF,
)
from residuum.identification.unseen_blocks.proposals import beginnings, conditions_along, starts
from residuum.identification.unseen_blocks.scale import Scale
from residuum.identification.unseen_blocks.structure import Structure, at_start, descended, fitted

SHORT, LONG = "short", "long"


@dataclass(frozen=True, eq=False)
class Court:
    """What all structures of a level are judged by: the data, the rung of the judgement, the rung
    of short looks, the scale, and what the model as it is leaves in each window of that rung
    (`there`, mean squares; None: not known).
    """

    data: Data
    last: Rung
    middle: Rung
    scale: Scale
    there: FloatArray | None = None

    @cached_property
    def short(self) -> tuple[Rung, Sequence[int]]:
        """What a look at short windows sees, and which of the windows those are."""
        return self.middle.thinned(GLANCED, self.there)

    @property
    def kinds(self) -> tuple[str, ...]:
        """The looks that there are: long records are looked at in short windows alone."""
        many = self.last.starts[-1] > LONG_LOOK
        if self.middle is self.last:
            return (LONG,)
        return (SHORT,) if many else (LONG, SHORT)

    def judge(self, structure: Structure, *, steps: int, tolerance: float) -> Judged | None:
        """The structure fitted on the last rung, and judged there; None where it diverges."""
        k = self.last.windows
        known, taken = structure.states.get(k), structure.steps.get(k)
        fit = fitted(
            structure.model,
            self.last,
            known,
            self.scale,
            steps=steps,
            tolerance=tolerance,
            substeps=taken,
        )
        return None if fit is None else self.judge_fit(structure, fit)

    def begun(self, structure: Structure, model: PhysicalModel | None = None) -> Fit | None:
        """A structure that was found on the last rung, or a model that has more than it, at its own
        values there; None where that diverges.
        """
        k = self.last.windows
        return at_start(
            model or structure.model, self.last, structure.states[k], self.scale, structure.steps[k]
        )

    def judge_fit(self, structure: Structure, fit: Fit) -> Judged | None:
        """The structure judged by a fit on the last rung."""
        return judged(structure.at(self.last, fit), fit, self.last, self.data, self.scale)


@dataclass(frozen=True, eq=False)
class Glance:
    """A proposal beside a parent: by kind of look its best fits after a step or more, the lowest
    first; `sizes` are its first values, `along` is where the parent's filter went.
    """

    parent: Structure
    key: Key
    seen: Mapping[str, Sequence[Fit]]
    sizes: Mapping[str, Sequence[float]]
    along: Track

    @property
    def keys(self) -> tuple[Key, ...]:
        """The parent's and its own."""
        return tuple(sorted((*self.parent.keys, self.key)))

    @property
    def hides(self) -> bool:
        """Whether it has states of its own: beside others it may do what it does not do alone."""
        fits = next(iter(self.seen.values()))
        return len(fits[0].problem.simulator.states) > len(Simulator(self.parent.model).states)

    def error(self, kind: str) -> float:
        """Mean cost of a sample in the lowest fit of a kind."""
        return self.seen[kind][0].mean


def glance(
    parent: Structure, key: Key, along: Track, court: Court, given: Track | None = None
) -> Glance | None:
    """One pass from each first value, and a step from those that promise most, on short windows and
    on the last rung; None where all diverge.

    `given` is the track of the model as it was given: what is missing may have driven the values
    that were fitted far away.
    """
    first = beginnings(key, along) + ([] if given is None else beginnings(key, given))
    by_kind: dict[str, Sequence[Fit]] = {}
    for kind in court.kinds:
        rung, windows = (court.last, range(len(court.last.parts))) if kind == LONG else court.short
        states = [parent.states[rung.windows][k] for k in windows]
        steps = [parent.steps[rung.windows][k] for k in windows]
        begun = [
            fit
            for model in first
            if (fit := at_start(model, rung, states, court.scale, steps)) is not None
        ]
        begun.sort(key=lambda fit: fit.cost - fit.promised(*fit.step(damping=PROMISING)))
        if stepped := [fit.descended(1, 0.0) for fit in begun[:FOLLOWED_STARTS]]:
            by_kind[kind] = sorted(stepped, key=lambda fit: fit.cost)
    return (
        Glance(parent, key, by_kind, _sizes(key, along, first, by_kind), along) if by_kind else None
    )


def _sizes(
    key: Key, along: Track, first: Sequence[PhysicalModel], looks: Mapping[str, Sequence[Fit]]
) -> dict[str, list[float]]:
    """Magnitudes of an effect's values: as they are proposed, regressed, and after a step."""
    models = [*first, *(fit.model for fits in looks.values() for fit in fits)]
    known = [
        *(starts(key, along) if key.effect != HELD else ()),
        *(_values(model, key) for model in models),
    ]
    return (
        {name: [abs(values[name]) for values in known if name in values] for name in known[-1]}
        if known
        else {}
    )


def followed_on(view: Glance) -> Glance:
    """The glance after two steps more."""
    by_kind = {kind: [fit.descended(2, 1e-3) for fit in fits] for kind, fits in view.seen.items()}
    return replace(
        view, seen={kind: sorted(fits, key=lambda fit: fit.cost) for kind, fits in by_kind.items()}
    )


def look(view: Glance, court: Court) -> Judged | None:
    """The full fit from the best of each kind of glance; the best one judged.

    None where all diverge, or their values refuse them.
    """
    candidates: list[Fit] = []
    for kind, fits in view.seen.items():
        # small effects of the wrong shape mislead
        for fit in fits[: FOLLOWED_STARTS if court.scale.nats else 1]:
            ends = (
                [fit, descended(fit, steps=15, tolerance=1e-4)]
                if court.scale.nats and kind == SHORT
                else [fit]
            )
            rung_fits = (
                ends
                if kind == LONG
                else [_on_the_last_rung(end.model, view.parent, court) for end in ends]
            )
            candidates += [rung_fit for rung_fit in rung_fits if rung_fit is not None]
    return _lowest(
        candidates,
        Structure(view.keys, view.parent.model, view.parent.states, view.parent.steps),
        view,
        court,
    )


def _on_the_last_rung(model: PhysicalModel, near: Structure, court: Court) -> Fit | None:
    k = court.last.windows
    return at_start(model, court.last, near.states.get(k), court.scale, near.steps.get(k))


def follow(
    models: Sequence[PhysicalModel], view: Glance, near: Structure, court: Court
) -> Judged | None:
    """The lowest of the full fits from other first values of what was glanced at."""
    fits = [fit for model in models if (fit := _on_the_last_rung(model, near, court)) is not None]
    return _lowest(fits, Structure(view.keys, near.model, near.states, near.steps), view, court)


def _lowest(
    begun: Sequence[Fit], structure: Structure, view: Glance, court: Court
) -> Judged | None:
    """The lowest of the full fits from where these begin, judged; without those whose values refuse
    them.
    """
    tolerance = 1e-6 if court.scale.nats else 1e-4
    fits = [descended(fit, steps=15, tolerance=tolerance) for fit in begun]
    fits += [back for fit in fits if (back := called_back(fit, structure, court)) is not None]
    good = [fit for fit in fits if not _is_refused(fit.model, view, court)]
    return court.judge_fit(structure, min(good, key=lambda fit: fit.cost)) if good else None


def called_back(fit: Fit, near: Structure, court: Court) -> Fit | None:
    """The fit once more with the model's values that ran off put back to where they were given;
    None where none did.

    What is missing drives a value away (a resistance to infinity), and from there nothing draws it
    back when the effect is there.
    """
    given, model = court.data.model.parameters, fit.model
    off = {
        name: p.value
        for name, p in given.items()
        if not p.fixed
        and p.value != 0.0
        and abs(model.parameters[name].value) > RAN_OFF * abs(p.value)
    }
    begun = _on_the_last_rung(model.with_values(off), near, court) if off else None
    return (
        None
        if begun is None
        else descended(begun, steps=15, tolerance=1e-6 if court.scale.nats else 1e-4)
    )


def _is_refused(model: PhysicalModel, view: Glance, court: Court) -> bool:
    return _is_absurd(model, view) or not shows(model, view.along, court.last)


def _values(model: PhysicalModel, key: Key) -> dict[str, float]:
    if key.effect == HELD:
        return {}
    use = next(use for use in model.effects if use.key == key)
    return {name: p.value for name, p in use.parameters.items()}


def shows(model: PhysicalModel, along: Track, rung: Rung) -> bool:
    """Whether each effect can be told from an unknown load within a window of a rung: a far body on
    a soft spring is one, and a second store that never fills.
    """
    duration = max(part.n * part.sample_time for part in rung.parts)
    asked = [use for use in model.effects if type(use.effect).shows is not Effect.shows]
    return all(
        use.effect.shows(
            _values(model, use.key), replace(conditions_along(use.key, along), duration=duration)
        )
        for use in asked
    )


def _is_absurd(model: PhysicalModel, view: Glance) -> bool:
    """Whether a value left all its first values: a ripple without a period is a load."""
    for name, value in _values(model, view.key).items():
        known = [v for v in view.sizes.get(name, ()) if v > 0]
        if known and (
            abs(value) > ABSURD * max(known) or 0 < abs(value) < min(known) / (100.0 * ABSURD)
        ):
            return True
    return not np.all(np.isfinite(list(model.values.values())))
