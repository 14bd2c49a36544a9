"""Looks at a proposal beside a structure: a glance from every first value, then the fit of the most
promising.

Both kinds of glance are needed. Friction in a long oscillation shows on the whole record only, and
there a wrong phase hides everything else, which shows on short windows.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from residuum.identification.physics import Key, PhysicalModel, Simulator
from residuum.identification.physics.effects.base import Effect
from residuum.identification.physics.estimation.gauss_newton import Fit
from residuum.identification.unseen_blocks.judged import LONG, SHORT, Court, Judged
from residuum.identification.unseen_blocks.policy import (
    ABSURD,
    FOLLOWED_STARTS,
    KEPT,
    PROMISING,
    RAN_OFF,
)
from residuum.identification.unseen_blocks.proposals import beginnings, conditions_along, starts
from residuum.identification.unseen_blocks.structure import (
    HELD,
    Structure,
    at_start,
    descended,
)

if TYPE_CHECKING:
    from residuum.identification.unseen_blocks.data import Rung
    from residuum.identification.unseen_blocks.following import Track


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
        passes = [at_start(model, rung, states, court.scale, steps) for model in first]
        begun = [fit for fit in passes if fit is not None]
        # by the cost that a damped step promises: a whole one promises shifts in time too much
        begun.sort(key=lambda fit: fit.cost - fit.promised(*fit.step(damping=PROMISING)))
        stepped = [fit.descended(1, 0.0) for fit in begun[:FOLLOWED_STARTS]]
        if stepped:
            by_kind[kind] = sorted(stepped, key=lambda fit: fit.cost)
    if not by_kind:
        return None
    return Glance(parent, key, by_kind, _sizes(key, along, first, by_kind), along)


def _sizes(
    key: Key, along: Track, first: Sequence[PhysicalModel], looks: Mapping[str, Sequence[Fit]]
) -> dict[str, list[float]]:
    """Magnitudes of an effect's values: as they are proposed, regressed, and after a step."""
    models = [*first, *(fit.model for fits in looks.values() for fit in fits)]
    known: list[Mapping[str, float]] = [] if key.effect == HELD else list(starts(key, along))
    known += [_values(model, key) for model in models]
    if not known:
        return {}
    return {name: [abs(values[name]) for values in known if name in values] for name in known[-1]}


def followed_on(view: Glance) -> Glance:
    """The glance after two steps more."""
    seen: dict[str, Sequence[Fit]] = {}
    for kind, fits in view.seen.items():
        further = [fit.descended(2, 1e-3) for fit in fits]
        seen[kind] = sorted(further, key=lambda fit: fit.cost)
    return replace(view, seen=seen)


def look(view: Glance, court: Court) -> Judged | None:
    """The full fit from the best of each kind of glance; the best one judged.

    None where all diverge, or their values refuse them.
    """
    nats, parent = court.scale.nats, view.parent
    candidates: list[Fit | None] = []
    for kind, fits in view.seen.items():
        # in noise small effects of the wrong shape mislead: more than the lowest is followed
        for fit in fits[: FOLLOWED_STARTS if nats else 1]:
            if kind == LONG:
                candidates.append(fit)
                continue
            ends = [fit]
            if nats:  # where short windows end is a further place to begin
                ends.append(descended(fit, steps=15, tolerance=1e-4))
            candidates += [_on_the_last_rung(end.model, parent, court) for end in ends]
    known = [fit for fit in candidates if fit is not None]
    structure = Structure(view.keys, parent.model, parent.states, parent.steps)
    return _lowest(known, structure, view, court)


def _on_the_last_rung(model: PhysicalModel, near: Structure, court: Court) -> Fit | None:
    windows = court.last.windows
    states, steps = near.states.get(windows), near.steps.get(windows)
    return at_start(model, court.last, states, court.scale, steps)


def follow(
    models: Sequence[PhysicalModel], view: Glance, near: Structure, court: Court
) -> Judged | None:
    """The lowest of the full fits from other first values of what was glanced at."""
    begun = [_on_the_last_rung(model, near, court) for model in models]
    known = [fit for fit in begun if fit is not None]
    return _lowest(known, Structure(view.keys, near.model, near.states, near.steps), view, court)


def _lowest(
    begun: Sequence[Fit], structure: Structure, view: Glance, court: Court
) -> Judged | None:
    """The lowest of the full fits from where these begin, judged; without those whose values refuse
    them.
    """
    tolerance = 1e-6 if court.scale.nats else 1e-4
    fits = [descended(fit, steps=15, tolerance=tolerance) for fit in begun]
    put_back = [called_back(fit, structure, court) for fit in fits]
    fits += [fit for fit in put_back if fit is not None]
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
    if begun is None:
        return None
    return descended(begun, steps=15, tolerance=1e-6 if court.scale.nats else 1e-4)


def _is_refused(model: PhysicalModel, view: Glance, court: Court) -> bool:
    return _is_absurd(model, view) or not shows(model, view.along, court.last)


def _values(model: PhysicalModel, key: Key) -> dict[str, float]:
    if key.effect == HELD:
        return {}
    use = next(use for use in model.effects if use.key == key)
    return {name: p.value for name, p in use.parameters.items()}


def shows(model: PhysicalModel, along: Track, rung: Rung) -> bool:
    """Whether each effect can be told from an unknown load within a window of a rung.

    A far body on a spring so soft that no window sees it swing is told from none, nor is a second
    store of heat that does not fill within a window.
    """
    duration = max(part.n * part.sample_time for part in rung.parts)
    # most effects show in any window; conditions along the track are found only for those that ask
    asked = [use for use in model.effects if type(use.effect).shows is not Effect.shows]
    return all(
        use.effect.shows(
            _values(model, use.key), replace(conditions_along(use.key, along), duration=duration)
        )
        for use in asked
    )


def _is_absurd(model: PhysicalModel, view: Glance) -> bool:
    """Whether a value lies far beyond all its first values, where the effect is another one: a
    ripple whose period is longer than the travel is a load.
    """
    for name, value in _values(model, view.key).items():
        known = [size for size in view.sizes.get(name, ()) if size > 0]
        if not known:
            continue
        # sizes shrink to nothing where an effect is not there: that is no other effect
        smallest = min(known) / (100.0 * ABSURD)
        if abs(value) > ABSURD * max(known) or 0 < abs(value) < smallest:
            return True
    return not np.all(np.isfinite(list(model.values.values())))


# Which of many glances are followed, and which proposals are worth a look beside others.


def best_of_each(glances: Collection[Glance], count: int) -> list[Glance]:
    """So many of each kind of look."""
    top: dict[tuple[Key, ...], Glance] = {}
    for kind in (SHORT, LONG):
        top |= {view.keys: view for view in _by_error(glances, kind)[:count]}
    return list(top.values())


def worth_beside_others(glances: Collection[Glance]) -> set[Key]:
    """Proposals worth a look beside others: the best of the first level, and those that hide alone
    (own states, no slope yet).
    """
    viable = {view.key for view in glances if view.hides}
    for kind in (SHORT, LONG):
        ranked = _by_error(glances, kind)
        viable |= {view.key for view in ranked[:KEPT]}
        if ranked:
            # without a slope no step changed anything: the error is that of the model as it is,
            # which is the usual one, for most proposals change little
            usual = float(np.median([view.error(kind) for view in ranked]))
            viable |= {view.key for view in ranked if abs(view.error(kind) - usual) <= 1e-6 * usual}
    return viable


def _by_error(glances: Iterable[Glance], kind: str) -> list[Glance]:
    """Those that were looked at in this way, the lowest error first."""
    seen = [view for view in glances if kind in view.seen]
    return sorted(seen, key=lambda view: view.error(kind))


# Where windows begin in the states that no output shows: where the filter went.


def with_unseen_states(parent: Structure, along: Track, court: Court) -> Structure:
    """The structure whose windows of a short look begin where the filter went, in the states that
    no output shows.

    No fit moves these: the position of an axis of which the speed is measured is 0 at the begin of
    every window, and no stop is where the axis met it.
    """
    rung, names = court.middle, list(Simulator(parent.model).states)
    unseen = _unseen_states(parent, court.last)
    if not unseen or rung.windows not in parent.states:
        return parent
    rows = along.X[court.data.rows(rung)[rung.starts[:-1]]]
    filtered = [{n: float(x[names.index(n)]) for n in unseen} for x in rows]
    states = [
        {**known, **more} for known, more in zip(parent.states[rung.windows], filtered, strict=True)
    ]
    return replace(parent, states={**parent.states, rung.windows: states})


def _unseen_states(parent: Structure, last: Rung) -> list[str]:
    """States whose first values no measured output feels, on the first window of a rung."""
    simulator, part = Simulator(parent.model), last.parts[0]
    names = [f"initial:{name}" for name in simulator.free_states]
    x0 = simulator.x0({**parent.states[last.windows][0], **part.known})
    if not names:
        return []
    steps = parent.steps[last.windows][0]
    run = simulator.run_vectors(part, x0, simulator.p(), slopes=names, substeps=steps)
    if run.dY is None:
        return []
    # a slope of exactly zero: no equation leads from the state to a measured output
    is_felt = np.any(run.dY[:, part.measured], axis=(0, 1))
    return [name for name, felt in zip(simulator.free_states, is_felt, strict=True) if not felt]
