"""A structure: a model with some effects, fitted, and where each window begins; and held values
that are freed like effects.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput
from residuum.identification.physics import Key, PhysicalModel, Simulator
from residuum.identification.physics.effects import EFFECTS, STRUCTURAL
from residuum.identification.physics.effects.how_often import share_lacking
from residuum.identification.physics.estimation.gauss_newton import Fit, Problem
from residuum.identification.physics.model import place_of
from residuum.identification.residual_analysis.feedback import innovations_of
from residuum.identification.unseen_blocks.policy import (
    COARSE,
    HELD_REACH,
    OCCASIONAL,
    RARE,
    STIFFEST,
    USUAL_SHARE,
)
from residuum.identification.work import count_fit, go_on

if TYPE_CHECKING:
    from residuum.identification.unseen_blocks.data import Horizon
    from residuum.identification.unseen_blocks.scale import Scale

States = Sequence[Mapping[str, float]]
"""First values of the states of each window, by name."""


@dataclass(frozen=True, eq=False)
class Structure:
    """Effects `keys` in a `model`; by the windows a record of each horizon that was visited, the
    first `states` of its windows and the integration `steps` a sample there.
    """

    keys: tuple[Key, ...]
    model: PhysicalModel
    states: Mapping[int, States]
    steps: Mapping[int, Sequence[int]]

    @property
    def rarity(self) -> float:
        """For how many parameters the effects count besides their own, as they are rarely
        missing.
        """
        return sum(rarity(self.model, key) for key in self.keys)

    def with_steps(self, windows: int, steps: Sequence[int]) -> Structure:
        """The structure with other integration steps a sample on the horizon of so many windows."""
        return replace(self, steps={**self.steps, windows: steps})

    def at(self, horizon: Horizon, fit: Fit, keys: tuple[Key, ...] | None = None) -> Structure:
        """The structure with what was found on a horizon."""
        names = fit.problem.simulator.states
        states = {
            **self.states,
            horizon.windows: [dict(zip(names, x.tolist(), strict=True)) for x in fit.X0],
        }
        return Structure(
            self.keys if keys is None else keys,
            fit.model,
            states,
            {**self.steps, horizon.windows: fit.substeps},
        )


def at_start(
    model: PhysicalModel,
    horizon: Horizon,
    states: States | None,
    scale: Scale,
    steps: Sequence[int] | None = None,
) -> Fit | None:
    """The model at its own values on a horizon's windows, from where states are known roughly;
    `steps` a sample, where they are known, do for a model that has no further states.

    None where it diverges, or nothing can be estimated.
    """
    go_on()  # where a search is left when its work is over: before, not amid, a simulation
    try:
        simulator = Simulator(model)
        X0 = np.array(
            [simulator.measured_start(e) for e in horizon.parts]
            if states is None
            else first_states(simulator, horizon, states)
        )
        # steps that were found serve a model with the same states; a further state may be stiffer
        if steps is None or not (states and set(simulator.states) <= states[0].keys()):
            needed = _steps_needed(simulator, horizon, X0)
            steps = needed if steps is None else np.maximum(steps, needed).tolist()
        fit = Problem.of(simulator, horizon.cells, scale, steps).begin(X0)
    except BadInput:
        return None
    if fit.cost == np.inf:
        return None
    if states is not None:
        return fit
    # of unknown first states the measured ones are a guess: they are fitted alone first, the values
    # held at their own, so that a poor start does not move the values
    held = replace(fit.problem, lower=fit.theta, upper=fit.theta)
    return replace(replace(fit, problem=held).descended(2, 1e-2), problem=fit.problem)


def first_states(simulator: Simulator, horizon: Horizon, states: States) -> list[FloatArray]:
    """The states in the order of a model that may have others, which begin where its kernel sets
    them.
    """
    vectors = []
    for part, known in zip(horizon.parts, states, strict=True):
        shared = {name: value for name, value in known.items() if name in simulator.states}
        vectors.append(simulator.x0({**shared, **part.known}))
    return vectors


def _steps_needed(simulator: Simulator, horizon: Horizon, X0: FloatArray) -> list[int]:
    """Integration steps a sample that the fastest mode of each window asks for."""
    return np.minimum(
        simulator.modal_substeps(horizon.parts, list(X0), simulator.p()), STIFFEST
    ).tolist()


def too_few(taken: Iterable[int], needed: Iterable[int]) -> bool:
    """Whether in any window so many more integration steps a sample are needed than were taken that
    it has to be fitted anew.
    """
    return any(n > COARSE * own for n, own in zip(needed, taken, strict=True))


def fitted(
    model: PhysicalModel,
    horizon: Horizon,
    states: States | None,
    scale: Scale,
    *,
    steps: int,
    tolerance: float,
    substeps: Sequence[int] | None = None,
) -> Fit | None:
    """The model at its least error on a horizon's windows in the scale's unit, as `at_start`
    begins.

    Without `substeps`: a stop or a valve that the first run never reaches is stiff where it is met,
    so where what was found asks for many more integration steps a sample, it is sought again with
    those.
    """
    start = at_start(model, horizon, states, scale, substeps)
    if start is None:
        return None
    fit = descended(start, steps=steps, tolerance=tolerance)
    if substeps is not None:
        return fit
    needed = _steps_needed(Simulator(fit.model), horizon, fit.X0)
    if not too_few(fit.substeps, needed):
        return fit
    # from the start again, not from the end: what coarse steps led to may be far from the minimum
    finer = replace(start.problem, substeps=np.maximum(needed, fit.substeps)).at(
        start.theta, start.X0
    )
    return None if finer.cost == np.inf else finer.descended(steps, tolerance)


def descended(begun: Fit, *, steps: int, tolerance: float) -> Fit:
    """The least error from where a fit begins, with the integration steps that it has."""
    count_fit()
    return begun.descended(steps, tolerance)


def innovations_on(
    horizon: Horizon, model: PhysicalModel, structure: Structure, scale: Scale
) -> float:
    """Innovations that a structure leaves on a horizon, its values fitted to it in a few steps;
    infinite where it diverges.
    """
    states, taken = structure.states[horizon.windows], structure.steps[horizon.windows]
    fit = fitted(model, horizon, states, scale, steps=10, tolerance=1e-4, substeps=taken)
    return np.inf if fit is None else innovations_of(fit.residuals)


# What is usual comes first among equals: a rare effect has to earn more than one that machines of
# this kind often lack.


def rarity(model: PhysicalModel, key: Key) -> float:
    """For how many parameters the effect counts besides its own: none where machines of the kind of
    its balance often lack it.

    On the path of an input or output the kinds of all balances count. A user's own effect counts
    for none, nor does a value that the model holds.
    """
    if key.effect not in (EFFECTS.keys() | STRUCTURAL.keys()) or EFFECTS.fingerprint(key.effect):
        return 0.0
    balance = model.balances.get(place_of(key.target))
    balances = model.balances.values() if balance is None else [balance]
    share = share_lacking(key.effect, [b.kind for b in balances])
    if share is None or share >= USUAL_SHARE:
        return 0.0
    return OCCASIONAL if share > 0.0 else RARE


# Held values: parameters that a model holds fixed, where the records ask for another value. They
# are proposed and judged like effects, under a key of their own.
# A mass that is a tenth too large looks like an elasticity or a load. An estimate of what is free
# cannot mend it, and the likeliest effect stands in for it.

HELD = "value"
"""In the place of an effect's id: a parameter that the model fixes is free."""


def freed(model: PhysicalModel, names: Iterable[str]) -> PhysicalModel:
    """The model with these of its fixed parameters free, within reach of their values."""
    known = dict(model.parameters)
    for name in names:
        p = known[name]
        low, high = sorted(((1.0 - HELD_REACH) * p.value, (1.0 + HELD_REACH) * p.value))
        known[name] = replace(p, fixed=False, lower=max(low, p.lower), upper=min(high, p.upper))
    return replace(model, parameters=known)


@dataclass(frozen=True)
class HeldValue:
    """A parameter's value in the model, where it is fixed, and the one that the records ask for,
    with its standard deviation.

    Of the parameters in `indistinguishable_from` another value would do as much (a mass, or the
    area that drives it). It explains as much as the effects `as_much_as` that were found; where
    there are none, more than any would.
    """

    name: str
    held: float
    value: float
    std: float
    unit: str
    indistinguishable_from: tuple[str, ...] = ()
    as_much_as: tuple[str, ...] = ()
