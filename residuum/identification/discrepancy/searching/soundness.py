"""Is an effect, as it was estimated, one that the records show, or another one in disguise?"""

from __future__ import annotations

from collections.abc import Sequence

from residuum.identification.discrepancy.fitting.structure_comparison import simulates_no_worse
from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.screening.score_test import Screen
from residuum.identification.physics import Experiment, Key, Simulator, conditions_at
from residuum.identification.physics.effects.base import Conditions, Effect
from residuum.identification.physics.model import find_effect


def is_sound(structure: Structure, key: Key, screen: Screen) -> bool:
    """Whether an effect leaves no larger simulation error, and can be told from an unknown load."""
    return simulates_no_worse(structure, screen.base) and shows(structure, key, screen.experiments)


def shows(structure: Structure, key: Key, experiments: Sequence[Experiment]) -> bool:
    """Whether in one of the experiments the effect, as it was estimated, can be told from an unknown load."""
    effect = find_effect(key[0])
    if type(effect).shows is Effect.shows:
        return True
    longest_first = sorted(range(len(experiments)), key=lambda k: -experiments[k].n)
    return any(effect.shows(*at_estimate(structure, key, experiments, k)) for k in longest_first)


def at_estimate(
    structure: Structure, key: Key, experiments: Sequence[Experiment], k: int, beside: Effect | None = None
) -> tuple[dict[str, float], Conditions]:
    """An effect's values where it was estimated, and the conditions for it (or one `beside` it) in the k-th experiment."""
    simulator = Simulator(structure.model)
    X = simulator.run_vectors(experiments[k], structure.initial[k], simulator.p(), substeps=structure.substeps[k]).X
    label = f"{structure.label_of(key)}."
    values = {n.removeprefix(label): v for n, v in structure.model.values.items() if n.startswith(label)}
    return values, conditions_at(structure.model, beside or find_effect(key[0]), key[1], experiments[k], X)
