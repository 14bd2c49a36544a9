"""The first model on ever longer windows, each rung begun where the one before ended.

Long simulations of oscillating or integrating machines lock in wrongly from a poor start. The last
rung is the whole record, unless the model does not forget its first state within a window (a plant
that integrates, a closed loop) and follows little there.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import MAY_DIVERGE, NotIdentifiable
from residuum.identification.physics import PhysicalModel
from residuum.identification.physics.estimation.gauss_newton import Fit
from residuum.identification.residual_analysis.feedback import feeds_back, innovations_of
from residuum.identification.side_by_side import side_by_side
from residuum.identification.unseen_blocks.data import Data, Rung, one_turned, turned
from residuum.identification.unseen_blocks.policy import FORGETS, RUNG_ERROR
from residuum.identification.unseen_blocks.scale import Scale, clipped, plain
from residuum.identification.unseen_blocks.structure import States, Structure, at_start, fitted


@dataclass(frozen=True, eq=False)
class Climbed:
    """The model fitted on the `last` rung, where it was found, and the rung `middle` of short
    looks, with what the model leaves in each of its windows: `there`, mean squares.
    """

    data: Data
    structure: Structure
    found: Fit
    last: Rung
    middle: Rung
    scale: Scale
    there: FloatArray


def climb(data: Data) -> Climbed:
    """Climb the ladder with the data's model.

    Raises
    ------
    NotIdentifiable
        The model diverges on every rung.
    """
    scale = plain(data)
    structure, last, fit = Structure((), data.model, {}, {}), None, None
    powers: dict[int, FloatArray] = {}
    for rung in data.rungs:
        trial = _fitted(structure, data.model, rung, last, scale)
        if trial is None or (
            last is not None
            and trial.mean > RUNG_ERROR
            and not _is_forgotten(trial, data.model, rung, scale)
        ):
            continue
        structure, last, fit = structure.at(rung, trial), rung, trial
        powers[rung.windows] = np.array(
            [np.nanmean((r * scale.weights) ** 2) for r in trial.residuals]
        )
    if last is None or fit is None:
        raise NotIdentifiable(
            f"model {data.model.name!r}: diverges on the records, also in short windows;"
            f" {MAY_DIVERGE}"
        )
    ordered = [rung for rung in data.rungs if rung.windows in structure.states]
    scale = clipped(scale, fit.residuals, last)
    fit = fit.in_unit(scale).descended(6, 1e-4)
    middle = ordered[min(1, len(ordered) - 1)]
    return Climbed(data, structure.at(last, fit), fit, last, middle, scale, powers[middle.windows])


def _fitted(
    structure: Structure, first: PhysicalModel, rung: Rung, last: Rung | None, scale: Scale
) -> Fit | None:
    """The best fit from the values so far, with and without the states where shorter windows began,
    and from the first values.
    """
    begins: list[tuple[PhysicalModel, States | None]] = [(first, None)]
    if last is not None:
        known = {
            (number, part.t0): s
            for number, part, s in zip(
                last.experiment, last.parts, structure.states[last.windows], strict=True
            )
        }
        states = [
            known.get((number, part.t0), {})
            for number, part in zip(rung.experiment, rung.parts, strict=True)
        ]
        begins = [(structure.model, states), (structure.model, None), *begins]
    fits = [
        fitted(model, rung, states, scale, steps=20, tolerance=1e-4) for model, states in begins
    ]
    return min((fit for fit in fits if fit is not None), key=lambda fit: fit.cost, default=None)


def climb_at_likelier_timing(data: Data) -> Climbed:
    """`climb` with inputs held over their samples or moving evenly between them, whichever leaves
    the smaller innovations.

    The two differ by half a sample. A good record shows the wrong one as a structured error of its
    own, a delay or a lag. Where a controller answers the noise, inputs were held. All inputs are
    turned at once, then each of several alone.
    """

    def climbed(variant: Data) -> Climbed | NotIdentifiable:
        try:
            return climb(variant)
        except NotIdentifiable as diverges:
            return diverges

    climbs = side_by_side(climbed, [data, turned(data)])
    known = [variant for variant in climbs if isinstance(variant, Climbed)]
    if not known:
        raise next(variant for variant in climbs if isinstance(variant, NotIdentifiable))
    held = [variant for variant in known if not any(e.hold.any() for e in variant.data.experiments)]
    if (
        len(known) > 1
        and held
        and feeds_back(held[0].found.model, held[0].last.parts, held[0].found.residuals)
    ):
        return held[0]
    best = min(known, key=_preference)
    innovation = innovations_on(best.last, best.found.model, best.structure, best.scale)
    likelier = [
        data
        for data in one_turned(best.data)
        if innovations_on(
            data.rung(best.last.windows), best.found.model, best.structure, best.scale
        )
        < innovation
    ]
    alone = [variant for variant in side_by_side(climbed, likelier) if isinstance(variant, Climbed)]
    return min([best, *alone], key=_preference)


def innovations_on(rung: Rung, model: PhysicalModel, structure: Structure, scale: Scale) -> float:
    """Innovations that a structure leaves on a rung, its values fitted to it in a few steps;
    infinite where it diverges.
    """
    states, taken = structure.states[rung.windows], structure.steps[rung.windows]
    fit = fitted(model, rung, states, scale, steps=10, tolerance=1e-4, substeps=taken)
    return np.inf if fit is None else innovations_of(fit.residuals)


def _preference(climbed: Climbed) -> tuple[int, float]:
    """The fewer windows and the smaller innovations, the better."""
    return climbed.last.windows, innovations_of(climbed.found.residuals)


def _is_forgotten(fit: Fit, first: PhysicalModel, rung: Rung, scale: Scale) -> bool:
    """Whether first states are forgotten within a window, with the values that were fitted or as
    they were given: short windows that a model cannot follow are fitted by one that stands still,
    and forgets nothing.
    """
    if _forgets(fit, rung):
        return True
    given = at_start(first, rung, None, scale)
    return given is not None and _forgets(given, rung)


def _forgets(fit: Fit, rung: Rung) -> bool:
    """Whether first states are forgotten within a window by that fit."""
    simulator = fit.problem.simulator
    names = [f"initial:{name}" for name in simulator.free_states]
    if not names:
        return True
    runs = simulator.run_each(
        rung.parts, fit.initial, fit.problem.p(fit.theta), slopes=names, substeps=fit.substeps
    )
    slopes = [np.abs(run.dY) for run in runs if run.dY is not None]
    late, peak = (
        np.array([s[-1].max(axis=0) for s in slopes]),
        np.array([s.max(axis=(0, 1)) for s in slopes]),
    )
    return bool(np.median(late / np.maximum(peak, 1e-300), axis=0).max() < FORGETS)
