"""Pairs of effects that together promise more than one which stands for both: a first-order look at all pairs at once."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import combinations

import numpy as np

from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.fitting.whitened_least_squares import NormalEquations
from residuum.identification.discrepancy.policy.likelihood import FLAT_DIRECTION
from residuum.identification.discrepancy.policy.trials import PAIR_GAIN, PROMISING_PAIRS
from residuum.identification.discrepancy.screening.score_test import Screened
from residuum.identification.physics import Key, PhysicalModel
from residuum.identification.physics.estimation.least_squares import solve_scaled


def promising_pairs(
    base: Structure, found: Structure, keys: Sequence[Key], screened: Mapping[Key, Screened]
) -> list[PhysicalModel]:
    """The base with two effects that, to first order, do more than those (`keys`) which `found` has; the best first.

    All candidates' slopes on top of the base go into one set of normal equations, weighted as the residuals of `found` are:
    with H, g its curvature and gradient there and a the sizes of its effects, a subset S of the columns (and what the base leaves
    free) promises ½ g₀ᵀ H_SS⁻¹ g₀ where g₀ = g + H a is the gradient with those effects taken away.
    """
    tested = [s for s in screened.values() if all(np.all(np.isfinite(J)) for J in s.slopes)]
    if not {s.key for s in tested} >= set(keys):
        return []
    equations, first = _equations(base, found, tested)
    H, g = equations.reduced()
    own = {s.key: np.arange(at, at + s.slopes[0].shape[2]) for s, at in zip(tested, first, strict=True)}
    for key in keys:
        g = g + H[:, own[key]] @ np.array([found.model.values[f"{found.label_of(key)}.{n}"] for n in screened[key].own])
    free = np.arange(len(base.parameters))

    def promise(*keys: Key) -> float:
        S = np.concatenate([free, *(own[k] for k in keys)])
        return 0.5 * float(g[S] @ solve_scaled(H[np.ix_(S, S)], g[S, None], FLAT_DIRECTION)[:, 0])

    mark = promise(*keys) + (PAIR_GAIN if len(keys) == 1 else 0.0)
    pairs = [(promise(*pair), pair) for pair in _other_pairs(tested, keys)]
    best = sorted((pair for pair in pairs if pair[0] > mark), key=lambda pair: -pair[0])
    return [_joined(base.model, [screened[k].start for k in pair]) for _, pair in best[:PROMISING_PAIRS]]


def _other_pairs(tested: Sequence[Screened], keys: Sequence[Key]) -> list[tuple[Key, Key]]:
    """Pairs of candidates that are not these: with a single one only those without it, which a next step adds to."""
    others = [s.key for s in tested if len(keys) > 1 or s.key != keys[0]]
    return [pair for pair in combinations(others, 2) if set(pair) != set(keys)]


def _equations(base: Structure, found: Structure, tested: Sequence[Screened]) -> tuple[NormalEquations, list[int]]:
    """The joint normal equations, and where each candidate's columns begin."""
    q = len(base.parameters)
    by_parameters = [np.concatenate([J, *(s.slopes[k] for s in tested)], axis=2) for k, J in enumerate(base.by_parameters)]
    widths = [s.slopes[0].shape[2] for s in tested]
    first = q + np.concatenate([[0], np.cumsum(widths)[:-1]]).astype(int)
    return NormalEquations.of(found.residuals, by_parameters, base.by_states, found.noises), first.tolist()


def _joined(model: PhysicalModel, starts: Sequence[PhysicalModel]) -> PhysicalModel:
    """The model with the last effect of each of these."""
    for start in starts:
        use = start.effects[-1]
        model = model.with_effect(use.id, use.target, {n: p.value for n, p in use.parameters.items()})
    return model
