"""What may be missing, and where each begins: effects of the catalogue, forgotten inputs,
couplings, learned curves, held values.

A proposal is a key and models to begin with; who judges them does not ask what they are. A
forgotten input is a column of the records that the model does not use. It is proposed where what a
balance lacks resembles it, beside the balance's own terms, and where it says something that the
outputs do not: a reference, a filtered or differentiated output resembles whatever is missing in a
loop, and acts on nothing. A held value is a parameter that the model fixes: a mass that is a tenth
too large looks like an elasticity or a load.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import zip_longest

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.physics import EffectUse, Key, PhysicalModel, candidates, conditions_at
from residuum.identification.physics.effects import STRUCTURAL
from residuum.identification.physics.effects.base import Conditions, Effect
from residuum.identification.physics.model import find_effect, idle_inputs, is_curve, place_of
from residuum.identification.unseen_blocks.following import Track, beside, own_terms, regressed
from residuum.identification.unseen_blocks.policy import (
    COLUMNS_TRIED,
    CURVE_KNOTS,
    MOST_CURVES,
    RESEMBLES,
    SHAPES,
    STARTS_LOOKED_AT,
    TOLD_BY_OUTPUTS,
)
from residuum.identification.unseen_blocks.scale import innovations
from residuum.identification.unseen_blocks.structure import HELD, freed


def proposed(
    model: PhysicalModel,
    wanted: Iterable[str] | None,
    along: Track | None,
    *,
    learned: bool,
    held: bool,
) -> list[Key]:
    """Everything that may join the model; `wanted` restricts the effects.

    What acts at times that nobody recorded may have been something else: it is proposed only where
    it is asked for.
    """
    keys = candidates(model, wanted)
    if wanted is None:
        keys = [key for key in keys if model.records(key)]
    # curves fit anywhere: they are proposed only where a signal explains what a balance lacks
    keys = [key for key in keys if not is_curve(key.effect)]
    if learned and along is not None:
        keys += _curves(model, along)
    if held:
        keys += [
            Key(HELD, name) for name, p in model.parameters.items() if p.fixed and p.value != 0.0
        ]
    return keys


def beginnings(key: Key, along: Track) -> list[PhysicalModel]:
    """The track's model with what is proposed: where it vanishes, and regressed on what its balance
    lacked; each shape once.

    A shift in time begins as it is given: nothing near none of it says how far to go.
    """
    if key.effect == HELD:
        return [freed(along.model, [key.target])]
    effect = find_effect(key.effect)
    begins_at_zero = effect.vanishes and not effect.shifts
    models: list[PhysicalModel] = []
    for start in _unlike_starts(key, along, begins_at_zero):
        try:
            regression = regressed(key, start, along)
            if regression is not None:
                models.append(regression[1])
            # a learned curve is nothing but its regression: at rest it has no shape
            if not is_curve(effect.id) or regression is None:
                first = effect.at_rest(start) if begins_at_zero else start
                models.append(along.model.with_effect(*key, first))
        except BadInput:
            continue
    return [canonical(model) for model in models]


def _unlike_starts(key: Key, along: Track, begins_at_zero: bool) -> list[Mapping[str, float]]:
    """First values of an effect, the first of each shape; where it begins at zero its sizes are
    none of its shape.
    """
    sizes = find_effect(key.effect).sizes if begins_at_zero else ()
    shapes: list[Mapping[str, float]] = []
    unlike = []
    for start in starts(key, along):
        shape = {name: value for name, value in start.items() if name not in sizes}
        if shape not in shapes and len(shapes) < SHAPES:
            shapes.append(shape)
            unlike.append(start)
    return unlike


def grown(key: Key, special: Track) -> list[PhysicalModel]:
    """Models with an effect in the place of one that it generalises, begun near where that one was
    found and followed.
    """
    effect = find_effect(key.effect)
    special_key = Key(effect.generalises, key.target)
    use = next(use for use in special.model.effects if use.key == special_key)
    # the special case goes: beside the general one it would have nothing left to do
    less = special.model.without_effect(use.label)
    values = {name: p.value for name, p in use.parameters.items()}
    try:
        return [
            canonical(less.with_effect(*key, v))
            for v in effect.grown(values, conditions_along(key, special))
        ]
    except BadInput:
        return []


def specialised(key: Key, general: Track) -> list[PhysicalModel]:
    """Models with a special case in the place of the effect that generalises it, begun where that
    one was found and followed.
    """
    uses = [
        use
        for use in general.model.effects
        if use.target == key.target
        and use.effect.generalises == key.effect
        and use.id != key.effect
    ]
    models = []
    for use in uses:
        less = general.model.without_effect(use.label)
        values = {name: p.value for name, p in use.parameters.items()}
        try:
            conditions = conditions_along(Key(use.id, use.target), general)
            special = use.effect.specialised(values, conditions)
            if special:
                models.append(canonical(less.with_effect(*key, special)))
        except BadInput:
            continue
    return models


def generalised(key: Key) -> Key | None:
    """The effect that a proposed one is grown from, at its place; itself, where its error has many
    minima side by side.
    """
    special = "" if key.effect == HELD else find_effect(key.effect).generalises
    return Key(special, key.target) if special else None


def special_of(key: Key) -> Key | None:
    """The other effect that a proposed one generalises, at its place."""
    special = generalised(key)
    return None if special == key else special


def starts(key: Key, along: Track) -> list[Mapping[str, float]]:
    """First values of an effect, those of each thing that it follows in turn."""
    effect = find_effect(key.effect)
    by_lack = [
        list(effect.starts(conditions_along(key, along, missing)))
        for missing in _lacks(effect, key.target, along)
    ]
    # in turn: of the few that are looked at each thing has its first ones
    turns = [start for turn in zip_longest(*by_lack) for start in turn if start is not None]
    return [start for k, start in enumerate(turns) if start not in turns[:k]][:STARTS_LOOKED_AT]


def _lacks(effect: Effect, target: str, along: Track) -> list[FloatArray | None]:
    """What is missing, along the longest record, in each way in which the effect's first values
    follow it.
    """
    lacks: list[FloatArray | None] = []
    for signal in effect.follows:
        if signal == "lack":
            lacks.append(along.missing[place_of(target)][along.longest])
        else:
            errors = along.errors[along.longest][:, along.experiment.measured].T
            lacks += [innovations(e) if signal == "innovations" else e for e in errors]
    return lacks or [None]


def conditions_along(key: Key, along: Track, missing: FloatArray | None = None) -> Conditions:
    """What is known where the effect may act, along the longest record."""
    effect, rows = find_effect(key.effect), along.longest
    e = replace(along.experiment, U=along.experiment.U[rows], Y=along.experiment.Y[rows], spare={})
    return conditions_at(
        along.model, effect, key.target, e, np.ascontiguousarray(along.X[rows]), missing
    )


def canonical(model: PhysicalModel) -> PhysicalModel:
    """The model with the terms of its balances in one order, so that {A, B} and {B, A} are one
    kernel, which takes 60 to 150 ms to compile; stages of a path stay, for their order counts.
    """
    return replace(model, effects=tuple(sorted(model.effects, key=_rank)))


def _rank(use: EffectUse) -> tuple[int, str, str, int]:
    place = use.effect.place != "balance"
    return (1, "", "", 0) if place else (0, use.target, use.id, use.instance)


def forgotten_columns(model: PhysicalModel, along: Track) -> list[str]:
    """Spare columns that what a balance lacks resembles, the most alike first."""
    own = _told_by_outputs(along)
    taken = {*model.states, *model.parameters, *model.inputs, *model.balances}
    # a column that the outputs tell is a reference or a filtered output, and acts on nothing
    columns = {
        name: spare.values
        for name, spare in along.experiment.spare.items()
        if name not in taken
        and _share_of(own, spare.values - spare.values.mean()) < TOLD_BY_OUTPUTS
    }
    bases = {balance: own_terms(model, balance, along) for balance in model.balances}
    alike = {
        name: max(_alike(basis, along.missing[balance], column) for balance, basis in bases.items())
        for name, column in columns.items()
    }
    resembling = [name for name in alike if alike[name] > RESEMBLES]
    return sorted(resembling, key=lambda name: -alike[name])[:COLUMNS_TRIED]


def without_idle(model: PhysicalModel, like: PhysicalModel) -> PhysicalModel:
    """The model without the inputs that were added to it and that nothing uses; `like` is what it
    was before.
    """
    idle = idle_inputs(model)
    return model.with_inputs_of(
        name for name in model.inputs if name in like.inputs or name not in idle
    )


def _told_by_outputs(along: Track) -> FloatArray:
    """Orthonormal basis of the measured outputs, the states and their slopes."""
    Y = along.experiment.Y[:, along.experiment.measured]
    signals = np.column_stack([np.nan_to_num(Y, nan=0.0), along.X])
    # slopes, too: a differentiated output is what a controller feeds back
    every = np.column_stack([signals, np.gradient(signals, axis=0)])
    every = every - every.mean(axis=0)
    scaled = every / np.maximum(np.linalg.norm(every, axis=0), 1e-300)
    u, s, _ = np.linalg.svd(scaled, full_matrices=False)
    return np.asarray(u[:, s > 1e-9 * s[0]])


def _share_of(basis: FloatArray, v: FloatArray) -> float:
    power = float(v @ v)
    return float(np.sum((basis.T @ v) ** 2)) / power if power > 0 else 1.0


def _alike(basis: FloatArray, lack: FloatArray, signal: FloatArray) -> float:
    """Part of the lack's power beside the balance's own terms that the signal explains there."""
    residual, own = beside(basis, lack), beside(basis, signal)
    power = float(residual @ residual) * float(own @ own)
    return float(residual @ own) ** 2 / power if power > 0 else 0.0


def _curves(model: PhysicalModel, along: Track) -> list[Key]:
    """Learned curves: the signals of which a smooth function explains most of what a balance
    lacks.
    """
    present = {use.key for use in model.effects}
    learned = [id for id in STRUCTURAL if is_curve(id)]
    moving = _moving_signals(model, along)
    ranked = []
    for balance in model.balances:
        basis = own_terms(model, balance, along)
        for name, signal in moving.items():
            keys = [Key(id, f"{balance}({name})") for id in learned]
            new = [key for key in keys if key not in present]
            if new:
                share = _explained(basis, along.missing[balance], signal)
                ranked += [(share, key) for key in new]
    return [key for share, key in sorted(ranked, reverse=True)[:MOST_CURVES] if share > 0.0]


def _moving_signals(model: PhysicalModel, along: Track) -> dict[str, FloatArray]:
    """States and inputs along the track, those that change."""
    signals = dict(zip(model.states, along.X.T, strict=False))
    signals |= dict(zip(model.inputs, along.experiment.U.T, strict=False))
    return {name: signal for name, signal in signals.items() if np.ptp(signal) > 0}


def _explained(basis: FloatArray, lack: FloatArray, signal: FloatArray) -> float:
    """Part of the lack on every second stretch that a curve over the signal, fitted on the others,
    takes away.
    """
    at = np.unique(np.quantile(signal, np.linspace(0.0, 1.0, CURVE_KNOTS)))
    if len(at) < 3:
        return 0.0
    hats: Sequence[FloatArray] = [np.interp(signal, at, row) for row in np.eye(len(at))]
    every = np.column_stack([basis, *hats])
    # ten stretches fit, ten judge: neighbouring samples would tell each other
    aside = (np.arange(len(lack)) * 20 // len(lack)) % 2 == 1
    weights = np.linalg.lstsq(every[~aside], lack[~aside], rcond=1e-6)[0]
    power = float(lack[aside] @ lack[aside])
    left = lack[aside] - every[aside] @ weights
    return 1.0 - float(left @ left) / power if power > 0 else 0.0
