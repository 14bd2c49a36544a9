"""A structure: a model with some effects, fitted, and where each window begins."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadInput
from residuum.identification.physics import Estimate, Experiment, Key, PhysicalModel, Settings, Simulator, estimate
from residuum.identification.unseen_blocks.data import Rung
from residuum.identification.unseen_blocks.scale import Scale
from residuum.identification.work import go_on

Array = npt.NDArray[np.float64]
States = Sequence[Mapping[str, float]]
"""First values of the states of each window, by name."""


@dataclass(frozen=True, eq=False)
class Structure:
    """Effects `keys` in a `model`; by the windows a record of each rung that was visited, the first `states` of its windows and
    the integration `steps` a sample there.
    """

    keys: tuple[Key, ...]
    model: PhysicalModel
    states: Mapping[int, States]
    steps: Mapping[int, Sequence[int]]

    def at(self, rung: Rung, found: Estimate, keys: tuple[Key, ...] | None = None) -> Structure:
        """The structure with what was found on a rung."""
        states = {**self.states, rung.windows: first_states(found)}
        return Structure(self.keys if keys is None else keys, found.model, states, {**self.steps, rung.windows: found.substeps})


def first_states(found: Estimate) -> list[dict[str, float]]:
    """First values of each window that was estimated on."""
    names = Simulator(found.model).states
    return [dict(zip(names, x.tolist(), strict=True)) for x in found.initial]


def fitted(
    model: PhysicalModel,
    parts: Sequence[Experiment],
    states: States | None,
    scale: Scale,
    *,
    steps: int,
    tolerance: float,
    substeps: Sequence[int] | None = None,
) -> Estimate | None:
    """The model at its least error on these windows in the scale's unit, from where states are known roughly; `substeps` are
    integration steps a sample, where they are known.

    None where it diverges, or nothing can be estimated.
    """
    go_on()
    settings = Settings(weights=scale.weights, filters=scale.filters, iterations=steps, tolerance=tolerance)
    try:
        initial = None if states is None else _vectors(model, parts, states)
        return estimate(model, parts, initial=initial, settings=settings, substeps=substeps)
    except BadInput:
        return None


def _vectors(model: PhysicalModel, parts: Sequence[Experiment], states: States) -> list[Array]:
    """The states in the order of a model that may have others, which begin where its kernel sets them."""
    simulator, found = Simulator(model), []
    for part, known in zip(parts, states, strict=True):
        x = simulator.x0(part.known)
        for k, name in enumerate(simulator.states):
            if name in known and name not in part.known:
                x[k] = known[name]
        found.append(x)
    return found
