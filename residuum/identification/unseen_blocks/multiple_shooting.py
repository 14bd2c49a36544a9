"""The first model on ever longer windows, each horizon begun where the one before ended.

Long simulations of oscillating or integrating machines lock in wrongly from a poor start. The last
horizon is the whole record, unless the model does not forget its first state within a window (a
plant that integrates, a closed loop) and follows little there.
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
from residuum.identification.unseen_blocks.data import Data, Horizon, one_turned, turned
from residuum.identification.unseen_blocks.policy import FOLLOWED_ERROR, FORGETS
from residuum.identification.unseen_blocks.scale import Scale, clipped, plain
from residuum.identification.unseen_blocks.structure import (
    States,
    Structure,
    at_start,
    fitted,
    innovations_on,
)


@dataclass(frozen=True, eq=False)
class FirstFit:
    """The model fitted on the `last` horizon, where it was found, and the horizon `middle` of short
    windows, with what the model leaves in each of these: `window_errors`, mean squares.
    """

    data: Data
    structure: Structure
    found: Fit
    last: Horizon
    middle: Horizon
    scale: Scale
    window_errors: FloatArray


def first_fit(data: Data) -> FirstFit:
    """The data's model fitted on ever longer windows.

    Raises
    ------
    NotIdentifiable
        The model diverges on every horizon.
    """
    scale = plain(data)
    structure, last, fit = Structure((), data.model, {}, {}), None, None
    powers: dict[int, FloatArray] = {}
    for horizon in data.horizons:
        trial = _fitted(structure, data.model, horizon, last, scale)
        if trial is None:
            continue
        # a horizon that is followed badly is skipped, but for the first, or where first states are
        # forgotten within a window: there no shorter window would do better
        strays = last is not None and trial.mean > FOLLOWED_ERROR
        if strays and not _is_forgotten(trial, data.model, horizon, scale):
            continue
        structure, last, fit = structure.at(horizon, trial), horizon, trial
        powers[horizon.windows] = np.array(
            [np.nanmean((r * scale.weights) ** 2) for r in trial.residuals]
        )
    if last is None or fit is None:
        raise NotIdentifiable(
            f"model {data.model.name!r}: diverges on the records, also in short windows;"
            f" {MAY_DIVERGE}"
        )
    ordered = [horizon for horizon in data.horizons if horizon.windows in structure.states]
    # clipped from here on: before the best fit is known nothing tells an event from an error
    scale = clipped(scale, fit.residuals, last)
    fit = fit.in_unit(scale).descended(6, 1e-4)
    middle = ordered[min(1, len(ordered) - 1)]
    return FirstFit(data, structure.at(last, fit), fit, last, middle, scale, powers[middle.windows])


def _fitted(
    structure: Structure, first: PhysicalModel, horizon: Horizon, last: Horizon | None, scale: Scale
) -> Fit | None:
    """The best fit from the values so far, with and without the states where shorter windows began,
    and from the first values.
    """
    begins: list[tuple[PhysicalModel, States | None]] = [(first, None)]
    if last is not None:
        # every window begins where a shorter one did, so its first states are known
        shorter = zip(last.experiment, last.parts, structure.states[last.windows], strict=True)
        known = {(number, part.t0): states for number, part, states in shorter}
        states = [
            known.get((number, part.t0), {})
            for number, part in zip(horizon.experiment, horizon.parts, strict=True)
        ]
        begins = [(structure.model, states), (structure.model, None), *begins]
    fits = [
        fitted(model, horizon, states, scale, steps=20, tolerance=1e-4) for model, states in begins
    ]
    return min((fit for fit in fits if fit is not None), key=lambda fit: fit.cost, default=None)


def first_fit_at_likelier_timing(data: Data) -> FirstFit:
    """`first_fit` with inputs held over their samples or moving evenly between them, whichever
    leaves the smaller innovations.

    The two differ by half a sample. A good record shows the wrong one as a structured error of its
    own, a delay or a lag. Where a controller answers the noise, inputs were held. All inputs are
    turned at once, then each of several alone.
    """
    fits_at_both = side_by_side(_first_fit_or_not, [data, turned(data)])
    known = [variant for variant in fits_at_both if isinstance(variant, FirstFit)]
    if not known:
        raise next(variant for variant in fits_at_both if isinstance(variant, NotIdentifiable))
    held = [variant for variant in known if not any(e.hold.any() for e in variant.data.experiments)]
    if len(known) > 1 and held and _is_fed_back(held[0]):
        return held[0]
    best = min(known, key=_preference)
    likelier = _with_one_turned(best)
    alone = [
        variant
        for variant in side_by_side(_first_fit_or_not, likelier)
        if isinstance(variant, FirstFit)
    ]
    return min([best, *alone], key=_preference)


def _first_fit_or_not(data: Data) -> FirstFit | NotIdentifiable:
    """`first_fit`, or why it cannot: at one timing a model may diverge, at the other not."""
    try:
        return first_fit(data)
    except NotIdentifiable as diverges:
        return diverges


def _is_fed_back(held: FirstFit) -> bool:
    """Whether a controller answers the noise in what the model leaves with held inputs."""
    return feeds_back(held.found.model, held.last.parts, held.found.residuals)


def _with_one_turned(best: FirstFit) -> list[Data]:
    """The data with one of several inputs turned, where that leaves smaller innovations: only these
    are worth fits of their own.
    """
    model, windows = best.found.model, best.last.windows
    innovation = innovations_on(best.last, model, best.structure, best.scale)
    return [
        data
        for data in one_turned(best.data)
        if innovations_on(data.horizon(windows), model, best.structure, best.scale) < innovation
    ]


def _preference(start: FirstFit) -> tuple[int, float]:
    """The fewer windows and the smaller innovations, the better."""
    return start.last.windows, innovations_of(start.found.residuals)


def _is_forgotten(fit: Fit, first: PhysicalModel, horizon: Horizon, scale: Scale) -> bool:
    """Whether first states are forgotten within a window, with the values that were fitted or as
    they were given: short windows that a model cannot follow are fitted by one that stands still,
    and forgets nothing.
    """
    if _forgets(fit, horizon):
        return True
    given = at_start(first, horizon, None, scale)
    return given is not None and _forgets(given, horizon)


def _forgets(fit: Fit, horizon: Horizon) -> bool:
    """Whether first states are forgotten within a window by that fit."""
    simulator = fit.problem.simulator
    names = [f"initial:{name}" for name in simulator.free_states]
    if not names:
        return True
    runs = simulator.run_each(
        horizon.parts, fit.initial, fit.problem.p(fit.theta), slopes=names, substeps=fit.substeps
    )
    slopes = [np.abs(run.dY) for run in runs if run.dY is not None]
    late = np.array([slope[-1].max(axis=0) for slope in slopes])
    peak = np.array([slope.max(axis=(0, 1)) for slope in slopes])
    # the median window, and of its states the one that is remembered longest
    return bool(np.median(late / np.maximum(peak, 1e-300), axis=0).max() < FORGETS)
