"""Pairs of effects that gain together only: on a motor whose loss stood for its friction, friction
and drag.

Each effect has slopes of its own where it is at rest beside a structure. With the errors e of the
structure, the slopes T of its values and of both effects (first states projected out, the outputs
in units of what they leave), and H_f = T_fᵀT_f and g_f = T_fᵀe_f of each fold of blocks f, a pair
leaves on unseen blocks about

    Σ_f |e_f|² − 2 δ_fᵀ g_f + δ_fᵀ H_f δ_f,    δ_f = (Σ_{k≠f} H_k + d·diag Σ H)⁻¹ Σ_{k≠f} g_k.

All pairs are ranked by that without a further simulation; those that promise most are fitted and
judged like any structure.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, islice
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.physics import Key, PhysicalModel
from residuum.identification.physics.estimation.least_squares import solve_scaled
from residuum.identification.physics.model import find_effect
from residuum.identification.side_by_side import each_beside
from residuum.identification.unseen_blocks.cross_validation import (
    CrossValidation,
    Equations,
    ValidatedFit,
    equations,
    normal_equations,
    steps_without,
)
from residuum.identification.unseen_blocks.policy import EACH_IN_PAIRS, PAIR_DAMPING, PAIRS_FITTED
from residuum.identification.unseen_blocks.proposals import canonical, starts
from residuum.identification.unseen_blocks.structure import HELD, Structure

if TYPE_CHECKING:
    from residuum.identification.unseen_blocks.following import Track


@dataclass(frozen=True, eq=False)
class _Slopes:
    """Of an effect at rest with these first values: names of its parameters that are estimated, and
    slopes (rows, outputs, q).
    """

    key: Key
    values: dict[str, float]
    names: list[str]
    columns: FloatArray


@dataclass(frozen=True, eq=False)
class _NormalEquations:
    """H (folds, q, q) and g (folds, q) of a structure's own values and of all effects at rest;
    `own` are the columns of those values, `columns` those of each effect.
    """

    H: FloatArray
    g: FloatArray
    own: npt.NDArray[np.intp]
    columns: Sequence[npt.NDArray[np.intp]]

    @classmethod
    def of(
        cls, own: Equations, slopes: Sequence[_Slopes], validation: CrossValidation
    ) -> _NormalEquations:
        """Those of a fit's equations and of effects beside it, the outputs in the scale's units."""
        scale = validation.scale
        unit = (
            np.ones(own.errors.shape[1]) if scale.unit is None else np.maximum(scale.unit, 1e-300)
        )
        # units are of power: slopes and errors are divided by their roots
        columns = [own.slopes, *(trial.columns for trial in slopes)]
        T = np.concatenate(columns, axis=2) / np.sqrt(unit)[:, None]
        errors = own.errors * own.huber / np.sqrt(unit)
        H, g = normal_equations(T, errors, validation.data.fold[validation.last.block])
        ends = np.cumsum([own.slopes.shape[2], *(len(trial.names) for trial in slopes)])[:-1]
        first, *effects = np.split(np.arange(T.shape[2]), ends)
        return cls(H, g, first, effects)

    def of_pair(self, i: int, j: int) -> tuple[FloatArray, FloatArray]:
        """H and g of the structure's values and of two effects."""
        at = np.concatenate([self.own, self.columns[i], self.columns[j]])
        return self.H[:, at][:, :, at], self.g[:, at]


def pairs(
    parent: ValidatedFit, keys: Iterable[Key], along: Track, validation: CrossValidation
) -> list[ValidatedFit]:
    """The pairs of these effects that promise most beside a structure, fitted and judged."""
    begun = validation.begun(parent.structure)
    own = None if begun is None else equations(begun, validation.last, validation.scale)
    if own is None or not own.errors.any():  # nothing is left that a pair could explain
        return []
    by_effect = each_beside(lambda key: _at_rest(key, parent, along, validation), list(keys))
    slopes = [trial for shapes in by_effect for trial in shapes]
    equations_of_all = _NormalEquations.of(own, slopes, validation)
    # two shapes of one effect are no pair
    index_pairs = [
        (i, j) for i, j in combinations(range(len(slopes)), 2) if slopes[i].key != slopes[j].key
    ]
    ranked = sorted((_unseen(*equations_of_all.of_pair(i, j)), i, j) for i, j in index_pairs)
    # the step that all folds ask for says where a full fit begins
    tasks = []
    for i, j in islice(_unlike(ranked, slopes), PAIRS_FITTED):
        step = _step(*equations_of_all.of_pair(i, j))[len(equations_of_all.own) :]
        tasks.append(partial(_fitted, parent, (slopes[i], slopes[j]), step, validation))
    return [trial for trial in each_beside(lambda task: task(), tasks) if trial is not None]


def _unlike(
    ranked: Iterable[tuple[float, int, int]], slopes: Sequence[_Slopes]
) -> Iterator[tuple[int, int]]:
    """The pairs that promise most, each effect in few of them: those that do the same beside one
    would take all places.
    """
    chosen: set[frozenset[Key]] = set()
    taken: Counter[Key] = Counter()
    for _, i, j in ranked:
        two = frozenset({slopes[i].key, slopes[j].key})
        if two not in chosen and max(taken[key] for key in two) < EACH_IN_PAIRS:
            chosen.add(two)
            taken.update(two)
            yield i, j


def _at_rest(
    key: Key, parent: ValidatedFit, along: Track, validation: CrossValidation
) -> list[_Slopes]:
    """An effect at rest beside the structure, in each of its shapes; none of one that is never at
    rest.
    """
    effect = None if key.effect == HELD else find_effect(key.effect)
    if effect is None or not effect.vanishes or effect.shifts:
        return []
    shapes: list[dict[str, float]] = []
    for start in starts(key, along):
        values = effect.at_rest(start)
        if values not in shapes:
            shapes.append(values)
    slopes = [_slopes_at(key, values, parent, validation) for values in shapes]
    return [trial for trial in slopes if trial is not None]


def _slopes_at(
    key: Key, values: dict[str, float], parent: ValidatedFit, validation: CrossValidation
) -> _Slopes | None:
    """The slopes of an effect at rest beside the structure; None where it does not fit the model,
    or the model diverges.
    """
    try:
        model = _unbounded(canonical(parent.model.with_effect(*key, values)), key)
    except BadInput:
        return None
    begun = validation.begun(parent.structure, model)
    at_rest = None if begun is None else equations(begun, validation.last, validation.scale)
    if at_rest is None or not np.all(np.isfinite(at_rest.slopes)):
        return None
    free = list(model.free)
    new = [k for k, name in enumerate(free) if name not in parent.model.free]
    names = [free[k].rpartition(".")[2] for k in new]
    return _Slopes(key, values, names, at_rest.slopes[..., new])


def _unbounded(model: PhysicalModel, key: Key) -> PhysicalModel:
    """The model with an effect's values free of their bounds, at which it rests: a value at its
    bound has no slope in a fit's equations.
    """
    effects = []
    for use in model.effects:
        if use.key == key:
            parameters = {
                name: replace(p, lower=-np.inf, upper=np.inf) for name, p in use.parameters.items()
            }
            effects.append(replace(use, parameters=parameters))
        else:
            effects.append(use)
    return replace(model, effects=tuple(effects))


def _step(H: FloatArray, g: FloatArray) -> FloatArray:
    """The step that all folds together ask for."""
    all_H = H.sum(axis=0)
    damped = all_H + PAIR_DAMPING * np.diag(np.diag(all_H))
    return np.asarray(solve_scaled(damped, g.sum(axis=0)[:, None], 1e-10)[:, 0])


def _unseen(H: FloatArray, g: FloatArray) -> float:
    """What all folds leave, each with the values that the others ask for, above what the structure
    alone leaves.
    """
    # Σ_f |e_f − T_f δ_f|² − |e_f|² = Σ_f δ_fᵀH_f δ_f − 2 δ_fᵀg_f
    steps = zip(H, g, steps_without(H, g, PAIR_DAMPING), strict=True)
    return float(sum(step @ h @ step - 2.0 * step @ b for h, b, step in steps))


def _fitted(
    parent: ValidatedFit, pair: Sequence[_Slopes], step: FloatArray, validation: CrossValidation
) -> ValidatedFit | None:
    """The structure with both, begun where the step leads."""
    model: PhysicalModel = parent.model
    for member, more in zip(pair, np.split(step, [len(pair[0].names)]), strict=True):
        moved = {
            name: member.values[name] + float(d) for name, d in zip(member.names, more, strict=True)
        }
        # the step knows no bounds, the model does
        try:
            at_rest = model.with_effect(*member.key, member.values)
            model = model.with_effect(*member.key, _within(at_rest, member.key, moved))
        except BadInput:
            return None
    keys = tuple(sorted((*parent.keys, *(member.key for member in pair))))
    near = parent.structure
    structure = Structure(keys, canonical(model), near.states, near.steps)
    return validation.validate(structure, steps=15, tolerance=1e-5)


def _within(model: PhysicalModel, key: Key, values: dict[str, float]) -> dict[str, float]:
    """All first values of an effect, these within their bounds."""
    use = next(use for use in model.effects if use.key == key)
    return {
        name: min(max(values.get(name, p.value), p.lower), p.upper)
        for name, p in use.parameters.items()
    }
