"""Fits of a proposal beside a structure: a quick one from every first value, then a full one of the
most promising.

Both kinds of quick fit are needed. Friction in a long oscillation shows on the whole record only,
and there a wrong phase hides everything else, which shows on short windows.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np

from residuum.identification.errors import BadInput
from residuum.identification.physics import Key, PhysicalModel, Simulator
from residuum.identification.physics.effects.base import Effect
from residuum.identification.physics.estimation.gauss_newton import Fit
from residuum.identification.side_by_side import each_beside
from residuum.identification.unseen_blocks.cross_validation import (
    LONG,
    SHORT,
    CrossValidation,
    ValidatedFit,
)
from residuum.identification.unseen_blocks.policy import (
    ABSURD,
    FOLLOWED_STARTS,
    FULLY_FITTED,
    KEPT,
    PROMISING,
    RAN_OFF,
)
from residuum.identification.unseen_blocks.proposals import (
    beginnings,
    conditions_along,
    special_of,
    starts,
)
from residuum.identification.unseen_blocks.structure import (
    HELD,
    Structure,
    at_start,
    descended,
)
from residuum.identification.work import OutOfWork, left_out

if TYPE_CHECKING:
    from residuum.identification.unseen_blocks.data import Horizon
    from residuum.identification.unseen_blocks.following import Track


@dataclass(frozen=True, eq=False)
class QuickFit:
    """A proposal beside a parent: by kind of quick fit its best fits after a step or more, the
    lowest first; `sizes` are its first values, `along` is where the parent's filter went.
    """

    parent: Structure
    key: Key
    fits: Mapping[str, Sequence[Fit]]
    sizes: Mapping[str, Sequence[float]]
    along: Track

    @property
    def keys(self) -> tuple[Key, ...]:
        """The parent's and its own."""
        return tuple(sorted((*self.parent.keys, self.key)))

    def is_of(self, candidate: ValidatedFit, stand_in: Key | None) -> bool:
        """Whether a structure holds the same effects, but for another one in the place of the
        proposal.
        """
        retained = set(candidate.keys) - {stand_in}
        return stand_in in candidate.keys and retained == set(self.keys) - {self.key}

    def is_special_case_in(self, candidate: ValidatedFit) -> bool:
        """Whether the proposal is a special case of an effect of a structure, in its place."""
        return any(
            special_of(key) == self.key and self.is_of(candidate, key) for key in candidate.keys
        )

    @property
    def hides(self) -> bool:
        """Whether it has states of its own: beside others it may do what it does not do alone."""
        fits = next(iter(self.fits.values()))
        return len(fits[0].problem.simulator.states) > len(Simulator(self.parent.model).states)

    def error(self, kind: str) -> float:
        """Mean cost of a sample in the lowest fit of a kind."""
        return self.fits[kind][0].mean


def quick_fit(
    parent: Structure,
    key: Key,
    along: Track,
    validation: CrossValidation,
    given: Track | None = None,
) -> QuickFit | None:
    """One pass from each first value, and a step from those that promise most, on short windows and
    on the last horizon; None where all diverge.

    `given` is the track of the model as it was given: what is missing may have driven the values
    that were fitted far away.
    """
    first = beginnings(key, along) + ([] if given is None else beginnings(key, given))
    by_kind: dict[str, Sequence[Fit]] = {}
    for kind in validation.kinds:
        stepped = _stepped(first, parent, kind, validation)
        if stepped:
            by_kind[kind] = stepped
    if not by_kind:
        return None
    return QuickFit(parent, key, by_kind, _sizes(key, along, first, by_kind), along)


def _stepped(
    models: Sequence[PhysicalModel], parent: Structure, kind: str, validation: CrossValidation
) -> list[Fit]:
    """The models that promise most after a step, on the windows of a kind, the lowest first."""
    horizon, windows = validation.windows_of(kind)
    states = [parent.states[horizon.windows][k] for k in windows]
    steps = [parent.steps[horizon.windows][k] for k in windows]
    passes = [at_start(model, horizon, states, validation.scale, steps) for model in models]
    begun = [fit for fit in passes if fit is not None]
    # by the cost that a damped step promises: a whole one promises shifts in time too much
    begun.sort(key=lambda fit: fit.cost - fit.promised(*fit.step(damping=PROMISING)))
    stepped = [fit.descended(1, 0.0) for fit in begun[:FOLLOWED_STARTS]]
    return sorted(stepped, key=lambda fit: fit.cost)


def _sizes(
    key: Key, along: Track, first: Sequence[PhysicalModel], trial_fits: Mapping[str, Sequence[Fit]]
) -> dict[str, list[float]]:
    """Magnitudes of an effect's values: as they are proposed, regressed, and after a step."""
    models = [*first, *(fit.model for fits in trial_fits.values() for fit in fits)]
    known: list[Mapping[str, float]] = [] if key.effect == HELD else list(starts(key, along))
    known += [_values(model, key) for model in models]
    if not known:
        return {}
    return {name: [abs(values[name]) for values in known if name in values] for name in known[-1]}


def refined(trial: QuickFit) -> QuickFit:
    """The quick fit after two steps more."""
    by_kind: dict[str, Sequence[Fit]] = {}
    for kind, fits in trial.fits.items():
        further = [fit.descended(2, 1e-3) for fit in fits]
        by_kind[kind] = sorted(further, key=lambda fit: fit.cost)
    return replace(trial, fits=by_kind)


def full_fit(trial: QuickFit, validation: CrossValidation) -> ValidatedFit | None:
    """The full fit from the best of each kind of quick fit; the best one judged.

    None where all diverge, or their values refuse them.
    """
    nats, parent = validation.scale.nats, trial.parent
    candidates: list[Fit | None] = []
    for kind, fits in trial.fits.items():
        # in noise small effects of the wrong shape mislead: more than the lowest is followed
        for fit in fits[: FOLLOWED_STARTS if nats else 1]:
            if kind == LONG:
                candidates.append(fit)
                continue
            ends = [fit]
            if nats:  # where short windows end is a further place to begin
                ends.append(descended(fit, steps=15, tolerance=1e-4))
            candidates += [_on_last_horizon(end.model, parent, validation) for end in ends]
    known = [fit for fit in candidates if fit is not None]
    structure = Structure(trial.keys, parent.model, parent.states, parent.steps)
    return _lowest(known, structure, trial, validation)


def full_fit_or_left_out(trial: QuickFit, validation: CrossValidation) -> ValidatedFit | None:
    """The full fit; None, and told, where the work is over before it."""
    try:
        return full_fit(trial, validation)
    except OutOfWork:
        left_out(f"{trial.key.effect}@{trial.key.target}, followed to its end")
        return None


def _on_last_horizon(
    model: PhysicalModel, near: Structure, validation: CrossValidation
) -> Fit | None:
    windows = validation.last.windows
    states, steps = near.states.get(windows), near.steps.get(windows)
    return at_start(model, validation.last, states, validation.scale, steps)


def fit_from(
    models: Sequence[PhysicalModel], trial: QuickFit, near: Structure, validation: CrossValidation
) -> ValidatedFit | None:
    """The lowest of the full fits from other first values of what was fitted quickly."""
    begun = [_on_last_horizon(model, near, validation) for model in models]
    known = [fit for fit in begun if fit is not None]
    return _lowest(
        known, Structure(trial.keys, near.model, near.states, near.steps), trial, validation
    )


def _lowest(
    begun: Sequence[Fit], structure: Structure, trial: QuickFit, validation: CrossValidation
) -> ValidatedFit | None:
    """The lowest of the full fits from where these begin, judged; without those whose values refuse
    them.
    """
    tolerance = 1e-6 if validation.scale.nats else 1e-4
    fits = [descended(fit, steps=15, tolerance=tolerance) for fit in begun]
    put_back = [called_back(fit, structure, validation) for fit in fits]
    fits += [fit for fit in put_back if fit is not None]
    good = [fit for fit in fits if not _is_refused(fit.model, trial, validation)]
    return validation.validate_fit(structure, min(good, key=lambda fit: fit.cost)) if good else None


def called_back(fit: Fit, near: Structure, validation: CrossValidation) -> Fit | None:
    """The fit once more with the model's values that ran off put back to where they were given;
    None where none did.

    What is missing drives a value away (a resistance to infinity), and from there nothing draws it
    back when the effect is there.
    """
    given, model = validation.data.model.parameters, fit.model
    off = {
        name: p.value
        for name, p in given.items()
        if not p.fixed
        and p.value != 0.0
        and abs(model.parameters[name].value) > RAN_OFF * abs(p.value)
    }
    begun = _on_last_horizon(model.with_values(off), near, validation) if off else None
    if begun is None:
        return None
    return descended(begun, steps=15, tolerance=1e-6 if validation.scale.nats else 1e-4)


def _is_refused(model: PhysicalModel, trial: QuickFit, validation: CrossValidation) -> bool:
    return _is_absurd(model, trial) or not shows(model, trial.along, validation.last)


def _values(model: PhysicalModel, key: Key) -> dict[str, float]:
    if key.effect == HELD:
        return {}
    use = next(use for use in model.effects if use.key == key)
    return {name: p.value for name, p in use.parameters.items()}


def shows(model: PhysicalModel, along: Track, horizon: Horizon) -> bool:
    """Whether each effect can be told from an unknown load within a window of a horizon.

    A far body on a spring so soft that no window sees it swing is told from none, nor is a second
    store of heat that does not fill within a window.
    """
    duration = max(part.n * part.sample_time for part in horizon.parts)
    # most effects show in any window; conditions along the track are found only for those that ask
    asked = [use for use in model.effects if type(use.effect).shows is not Effect.shows]
    return all(
        use.effect.shows(
            _values(model, use.key), replace(conditions_along(use.key, along), duration=duration)
        )
        for use in asked
    )


def _is_absurd(model: PhysicalModel, trial: QuickFit) -> bool:
    """Whether a value lies far beyond all its first values, where the effect is another one: a
    ripple whose period is longer than the travel is a load.
    """
    for name, value in _values(model, trial.key).items():
        known = [size for size in trial.sizes.get(name, ()) if size > 0]
        if not known:
            continue
        # sizes shrink to nothing where an effect is not there: that is no other effect
        smallest = min(known) / (100.0 * ABSURD)
        if abs(value) > ABSURD * max(known) or 0 < abs(value) < smallest:
            return True
    return not np.all(np.isfinite(list(model.values.values())))


# Which of many quick fits are refined, and which proposals are worth one beside others.


def best_of_each(quick_fits: Collection[QuickFit], count: int) -> list[QuickFit]:
    """So many of each kind of quick fit."""
    top: dict[tuple[Key, ...], QuickFit] = {}
    for kind in (SHORT, LONG):
        top |= {trial.keys: trial for trial in _by_error(quick_fits, kind)[:count]}
    return list(top.values())


def at_other_places(
    lead: ValidatedFit,
    by_keys: Mapping[tuple[Key, ...], ValidatedFit],
    quick_fits: Collection[QuickFit],
    validation: CrossValidation,
) -> list[Callable[[], ValidatedFit | None]]:
    """Full fits, to be made, of an effect of a structure at its other places: from their own first
    values those that were not fitted fully, and each from where the structure's effect is.

    Places that exchange what they hold (rooms and their floor) show an effect of one in the other
    one, too: which it is, errors after a step or three do not tell.
    """
    trials = [
        trial
        for key in lead.keys
        for trial in quick_fits
        if trial.key.effect == key.effect != HELD and trial.is_of(lead, key)
    ]
    others = best_of_each([t for t in trials if t.keys not in by_keys], FULLY_FITTED)
    return [
        *(partial(full_fit_or_left_out, t, validation) for t in each_beside(refined, others)),
        *_moved(lead, trials, validation),
    ]


def _moved(
    lead: ValidatedFit, trials: Sequence[QuickFit], validation: CrossValidation
) -> list[Callable[[], ValidatedFit | None]]:
    """Full fits of a balance's effect at other places, begun in the sizes that it has at its own:
    what a neighbour shows of it points to them, and from first values that nothing points to a fit
    may end elsewhere.
    """
    tasks: list[Callable[[], ValidatedFit | None]] = []
    for use in lead.model.effects:
        if use.effect.place != "balance" or use.key not in lead.keys:
            continue
        less = lead.model.without_effect(use.label)
        values = {name: p.value for name, p in use.parameters.items()}
        for trial in trials:
            if trial.key.effect != use.id or not trial.is_of(lead, use.key):
                continue
            try:
                model = less.with_effect(*trial.key, values)
            except BadInput:  # sizes that this place cannot have
                continue
            tasks.append(partial(fit_from, [model], trial, lead.structure, validation))
    return tasks


def worth_beside_others(quick_fits: Collection[QuickFit]) -> set[Key]:
    """Proposals worth a quick fit beside others: the best of the first level, and those that hide
    alone (own states, no slope yet).
    """
    viable = {trial.key for trial in quick_fits if trial.hides}
    for kind in (SHORT, LONG):
        ranked = _by_error(quick_fits, kind)
        viable |= {trial.key for trial in ranked[:KEPT]}
        if ranked:
            # without a slope no step changed anything: the error is that of the model as it is,
            # which is the usual one, for most proposals change little
            usual = float(np.median([trial.error(kind) for trial in ranked]))
            viable |= {
                trial.key for trial in ranked if abs(trial.error(kind) - usual) <= 1e-6 * usual
            }
    return viable


def _by_error(quick_fits: Iterable[QuickFit], kind: str) -> list[QuickFit]:
    """Those that were fitted in this way, the lowest error first."""
    of_kind = [trial for trial in quick_fits if kind in trial.fits]
    return sorted(of_kind, key=lambda trial: trial.error(kind))


# Where windows begin in the states that no output shows: where the filter went.


def with_unseen_states(parent: Structure, along: Track, validation: CrossValidation) -> Structure:
    """The structure whose windows of a quick fit begin where the filter went, in the states that
    no output shows.

    No fit moves these: the position of an axis of which the speed is measured is 0 at the begin of
    every window, and no stop is where the axis met it.
    """
    horizon, names = validation.middle, list(Simulator(parent.model).states)
    unseen = _unseen_states(parent, validation.last)
    if not unseen or horizon.windows not in parent.states:
        return parent
    rows = along.X[validation.data.rows(horizon)[horizon.starts[:-1]]]
    filtered = [{n: float(x[names.index(n)]) for n in unseen} for x in rows]
    states = [
        {**known, **more}
        for known, more in zip(parent.states[horizon.windows], filtered, strict=True)
    ]
    return replace(parent, states={**parent.states, horizon.windows: states})


def _unseen_states(parent: Structure, last: Horizon) -> list[str]:
    """States whose first values no measured output feels, on the first window of a horizon."""
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
