"""An unknown load of every window's own: what effects have to explain better than, of a plant that is judged in windows."""

from __future__ import annotations

from collections.abc import Sequence

from residuum.identification.discrepancy.fitting.structure_fits import refit
from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.physics import Experiment
from residuum.identification.physics.effects.load.drifting_load import DriftingLoad
from residuum.identification.residual_analysis.policy.records import DRIFTING_LOAD_WINDOWS


def likeliest_drifting_load(base: Structure, experiments: Sequence[Experiment]) -> Structure | None:
    """The base with a load that drifts in the balance where it explains most; None where nothing moves, or in few experiments.

    In a window a slow load is a force and its slope. Noise, however integrated, does not know how the plant answers to a force:
    beside that noise alone a weight that somebody put on passes for an effect that has a mean in every window.
    """
    if len(experiments) < DRIFTING_LOAD_WINDOWS:
        return None
    model, effect = base.model, DriftingLoad()
    there = [name for name in model.balances if effect.fits(model.site(name, effect))]
    fitted = [refit(base, model.with_unnamed(effect.id, name), experiments) for name in there]
    return max((found for found in fitted if found is not None), key=lambda found: found.log_likelihood, default=None)


def bears_a_drifting_load(structure: Structure) -> bool:
    """Whether such a load stands in the structure."""
    return any(use.id == DriftingLoad.id for use in structure.model.effects)
