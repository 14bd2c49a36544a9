"""Shooting: two effects at once, found on stretches too short for a simulation to stray from the track.

Where each of two missing effects changes the course of the machine (a friction, and a cog that holds it), a simulation with one
of them is as far off as one with none, whatever its size, and no first-order test or refit on whole records points there. From
the track's states, where the measurements hold the machine, a simulation of some samples shows what either explains. What is
found there is followed over longer and longer stretches, each along the track of the model found so far.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.policy.trials import (
    SHOT_BASE_STEPS,
    SHOT_FOLLOWED,
    SHOT_FOLLOWING_STEPS,
    SHOT_LEADERS,
    SHOT_LENGTHS,
    SHOT_PRICE,
    SHOT_SAMPLES,
    SHOT_SPECIAL_CASE,
    SHOT_TOLERANCE,
    SHOT_TRIAL_STEPS,
)
from residuum.identification.discrepancy.screening.score_test import Screen
from residuum.identification.discrepancy.screening.track import track
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.physics import Experiment, Key, PhysicalModel, Settings, Simulator, estimate, windows
from residuum.identification.physics.model import find_effect
from residuum.identification.side_by_side import side_by_side

FloatArray = npt.NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Stretches:
    """Parts of the experiments that begin on a track: with first states known, and integration steps a sample; and the weights of
    the outputs' errors, where they are known.
    """

    parts: list[Experiment]
    initial: FloatArray
    substeps: list[int]
    weights: FloatArray | None = None


@dataclass(frozen=True, eq=False)
class _Shot:
    """A model refitted on stretches: `score` is the sum of its outputs' log errors, parameters paid for."""

    model: PhysicalModel
    score: float
    weights: FloatArray

    @property
    def key(self) -> Key:
        """The effect that was added last."""
        return self.model.effects[-1].key


def effects_by_shooting(screen: Screen, keys: Sequence[Key]) -> list[PhysicalModel]:
    """The base with one of the effects `keys` besides, refitted on ever longer stretches; the best first.

    Only effects on the machine, and without states of their own, since no track shows where those were.
    """
    alone, _ = _alone(screen, keys)
    return [_followed(screen, shot.model) for shot in alone[:SHOT_FOLLOWED]]


def pairs_by_shooting(screen: Screen, keys: Sequence[Key]) -> list[PhysicalModel]:
    """The base with two of the effects `keys` besides, as `effects_by_shooting` finds one."""
    alone, stretches = _alone(screen, keys)
    pairs: list[_Shot] = []
    for leader in alone[:SHOT_LEADERS]:
        pairs += _tried(screen, leader.model, [shot.key for shot in alone if shot is not leader], stretches)
    best: dict[frozenset[Key], _Shot] = {}
    for pair in sorted(pairs, key=lambda shot: shot.score):
        best.setdefault(frozenset(use.key for use in pair.model.effects[-2:]), pair)
    return [_followed(screen, pair.model) for pair in list(best.values())[:SHOT_FOLLOWED]]


def _alone(screen: Screen, keys: Sequence[Key]) -> tuple[list[_Shot], _Stretches]:
    """Each effect on top of the base at its best start, the best effect first; and the stretches they were tried on."""
    stretches = _stretches(screen, screen.track.X, SHOT_LENGTHS[0])
    nothing = _shot(screen.origin, stretches, SHOT_BASE_STEPS)
    if nothing is None:
        return [], stretches
    stretches = replace(stretches, weights=nothing.weights)
    felt = [key for key in keys if find_effect(key[0]).place != "output"]
    found: dict[Key, _Shot] = {}
    for shot in sorted(_tried(screen, screen.origin, felt, stretches), key=lambda s: s.score):
        found.setdefault(shot.key, shot)
    return [shot for shot in found.values() if not _needless(shot, found)], stretches


def _needless(shot: _Shot, found: Mapping[Key, _Shot]) -> bool:
    """Whether an effect does little more than the one that it generalises: later steps of a search grow it from that."""
    special = found.get(Key(find_effect(shot.key.effect).generalises, shot.key.target))
    return special is not None and special is not shot and special.score < shot.score + SHOT_SPECIAL_CASE


def _tried(screen: Screen, model: PhysicalModel, keys: Sequence[Key], stretches: _Stretches) -> list[_Shot]:
    """The model with each of these effects besides, refitted from every start of it."""
    starts = [(key, start) for key in keys for start in screen.starts(*key)]

    def tried(one: tuple[Key, dict[str, float]]) -> _Shot | None:
        (id, target), start = one
        try:
            return _shot(model.with_effect(id, target, find_effect(id).at_rest(start)), stretches, SHOT_TRIAL_STEPS)
        except BadInput:
            return None

    return [shot for shot in side_by_side(tried, starts) if shot is not None]


def _followed(screen: Screen, model: PhysicalModel) -> PhysicalModel:
    """The model refitted over longer and longer stretches, each from the states that the filter with it finds; of all these the
    one that simulates whole experiments best.
    """
    X, found = screen.track.X, [model]
    for samples in SHOT_LENGTHS:
        shot = _shot(found[-1], _stretches(screen, X, samples), SHOT_FOLLOWING_STEPS)
        if shot is None:
            break
        found.append(shot.model)
        X = track(shot.model, screen.base, screen.experiments, _of_each(screen.experiments, X)).X
    return min(found, key=screen.error)


def _shot(model: PhysicalModel, stretches: _Stretches, iterations: int) -> _Shot | None:
    """The model at the least simulation error on the stretches; None if it diverges, or has states that no track shows."""
    settings = Settings(iterations=iterations, tolerance=SHOT_TOLERANCE, weights=stretches.weights)
    if len(Simulator(model).states) > stretches.initial.shape[1]:
        return None
    initial = list(stretches.initial)
    try:
        found = estimate(model, stretches.parts, initial=initial, settings=settings, substeps=stretches.substeps)
    except NotIdentifiable:
        return None
    return _Shot(found.model, float(np.nansum(np.log(found.rmse))) + SHOT_PRICE * len(found.parameters), found.weights)


def _stretches(screen: Screen, X: FloatArray, samples: int) -> _Stretches:
    states = Simulator(screen.base.model).states
    parts, initial, substeps = [], [], []
    for e, along, steps in zip(screen.experiments, _of_each(screen.experiments, X), screen.base.substeps, strict=True):
        for part in windows(e, min(samples * e.block, e.n)):
            x = along[round((part.t0 - e.t0) / e.sample_time)]
            parts.append(replace(part, known=dict(zip(states, x.tolist(), strict=True)), block=1))
            initial.append(x)
            substeps.append(steps)
    every = slice(None, None, max(1, -(-sum(part.n for part in parts) // SHOT_SAMPLES)))
    return _Stretches(parts[every], np.array(initial[every]), substeps[every])


def _of_each(experiments: Sequence[Experiment], X: FloatArray) -> list[FloatArray]:
    return np.split(X, np.cumsum([e.n for e in experiments])[:-1])
