"""The last steps of an improvement: what is needless or vanished leaves the model, which is estimated on everything."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from residuum.identification.discrepancy.fitting.judged_experiments import experiments_and_base
from residuum.identification.discrepancy.fitting.structure_fits import fit_structure
from residuum.identification.discrepancy.fitting.structures import Structure
from residuum.identification.discrepancy.improvement import Step
from residuum.identification.discrepancy.improving.held_out_error import HeldOutError
from residuum.identification.discrepancy.policy.acceptance import KEPT_RISE, PLAIN_SHIFT
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import EffectUse, Experiment, Key, estimate, with_coloured_noise
from residuum.identification.record import Record


def without_needless(
    structure: Structure, experiments: Sequence[Experiment], judge: HeldOutError, error: float
) -> tuple[Structure, list[Step]]:
    """Drop effects whose absence the Schwarz criterion prefers and the held-out error does not mind."""
    dropped: list[Step] = []
    for use in structure.model.effects:
        if len(structure.model.effects) < 2:
            break
        less = fit_structure(structure.model.without_effect(use.label), experiments, structure.initial)
        if less is None or structure.log_likelihood - structure.penalty(less) > less.log_likelihood:
            continue
        without = judge.error(less)
        if without <= error * KEPT_RISE:
            structure, error = less, without
            dropped.append(judge.step(f"-{use.id}", less, without))
    return structure, dropped


def least_simulation_error(structure: Structure, experiments: Sequence[Experiment]) -> Structure | None:
    """The structure at the least plain simulation error: of a model that is never complete it is the better simulator."""
    try:
        plain = with_coloured_noise(
            estimate(structure.model, experiments, free=structure.parameters, initial=structure.initial), experiments
        )
    except NotIdentifiable:
        return None
    return replace(structure, model=plain.model, initial=plain.initial, std=plain.std)


def on_everything(
    kept: Structure, records: Sequence[Record], mapping: Mapping[str, str] | None, finer: int, *, least_error: bool
) -> Structure:
    """The structure re-estimated on all records, at the likeliest innovations or at the least simulation error."""
    try:
        experiments, result = experiments_and_base(kept.model, records, mapping, finer)
    except NotIdentifiable:  # with the values of the training part it diverges on the rest
        return kept
    likelier = fit_structure(kept.model, experiments, result.initial)
    if likelier is not None and likelier.log_likelihood > result.log_likelihood:
        result = likelier
    return (least_simulation_error(result, experiments) if least_error else None) or result


def vanished(final: Structure, history: Sequence[Step], shifts: Sequence[Key]) -> list[EffectUse]:
    """Effects that were added and have no size left: at zero, or of the `shifts` in time those that cannot be told from it.

    Once all is estimated at the likelier input timing, what was a delay of half a sample may be some microseconds.
    """
    values, std = final.model.values, dict(zip(final.parameters, final.std, strict=True))

    def gone(use: EffectUse, name: str) -> bool:
        label = f"{use.label}.{name}"
        doubt = std.get(label, 0.0) if use.key in shifts else 0.0
        return abs(values.get(label, 0.0)) <= PLAIN_SHIFT * np.nan_to_num(doubt, posinf=0.0)

    joined = [use for use in final.model.effects if use.effect.sizes and any(step.added == use.id for step in history)]
    return [use for use in joined if all(gone(use, name) for name in use.effect.sizes)]
