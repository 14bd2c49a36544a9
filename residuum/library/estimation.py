"""Estimation of a model's parameters from records, by one of three errors."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.physics import (
    Estimate,
    Experiment,
    PhysicalModel,
    estimate,
    estimate_by_likelihood,
    match,
    windows,
    with_coloured_noise,
)
from residuum.identification.physics.estimation.estimation import Settings
from residuum.identification.physics.estimation.unsettled import unsettled
from residuum.identification.record import Record
from residuum.identification.residual_analysis.feedback import a_step_away, at_likelier_timing
from residuum.library.questions.estimate import Estimate as Asked
from residuum.nearest_names import known_names

Method = Callable[[PhysicalModel, Sequence[Experiment], Sequence[str] | None], Estimate]


# The three errors that a model may be estimated by; bands of the first two know the noise's colour.
def _with_honest_band(
    model: PhysicalModel, experiments: Sequence[Experiment], free: Sequence[str] | None
) -> Estimate:
    return with_coloured_noise(estimate(model, experiments, free=free), experiments)


def _by_likelihood(
    model: PhysicalModel, experiments: Sequence[Experiment], free: Sequence[str] | None
) -> Estimate:
    return estimate_by_likelihood(model, experiments, free=free)


METHODS: dict[str, Method] = {
    "simulation": _with_honest_band,
    "prediction": _with_honest_band,
    "kalman": _by_likelihood,
}

_BEFORE = 1e-4
"""Relative fall of the cost at which the model as it was is near enough to its least error."""
_IN_PIECES = "method prediction begins anew in each piece, which an unstable plant needs"


@dataclass(frozen=True, eq=False)
class Estimated:
    """The estimate, its experiments, and each output's RMS error on what the split notes kept
    (None: nothing was kept).

    `unsettled` says why the search did not come to rest; empty where it did.
    """

    estimate: Estimate
    experiments: Sequence[Experiment]
    held_out_rmse: Mapping[str, float] | None
    unsettled: tuple[str, ...] = ()


def _check_of_records(model: PhysicalModel, method: str) -> None:
    """Windows of a prediction would each have a value of their own, and innovations give values of
    records no band that was counted.
    """
    of_records = [name for name, state in model.states.items() if state.of_record is not None]
    if of_records and method != "simulation":
        raise BadInput(
            repr(method),
            "method",
            f"finds no values of records, and {of_records[0]!r} has one for each",
            way_on=[("method", "simulation")],
        )


def estimated(
    model: PhysicalModel,
    records: Sequence[Record],
    mapping: Mapping[str, str] | None,
    asked: Asked,
) -> Estimated:
    """Estimate the free parameters; a note `split: 0.7` in a record keeps its rest for validation.

    Raises
    ------
    BadInput
        An unknown parameter; records that do not fit the model.
    NotIdentifiable
        The model diverges on a record.
    """
    method, free = asked.method, asked.free
    _refuse_unknown(model, free)
    _check_of_records(model, method)
    start, experiments = match(model, records, mapping, asked.hold)
    parts = [
        _estimation_part(experiment, record)
        for experiment, record in zip(experiments, records, strict=True)
    ]

    def fitted(parts: Sequence[Experiment]) -> Estimate:
        return METHODS[method](start, _pieces(parts, asked), free)

    try:
        if asked.hold == "auto":
            parts, result = at_likelier_timing(
                parts,
                fitted,
                # Innovations of a filter are no residuals that a step could be taken from.
                None
                if method == "kalman"
                else lambda best, turned: a_step_away(best, _pieces(turned, asked)),
            )
            # what is kept aside is simulated with the timing that was found
            experiments = [
                replace(experiment, hold=part.hold)
                for experiment, part in zip(experiments, parts, strict=True)
            ]
        else:
            result = fitted(parts)
        held_out = _held_out_error(result.model, experiments, records)
    except NotIdentifiable as diverges:
        if method == "prediction":
            raise diverges from None
        raise NotIdentifiable(f"{diverges}; {_IN_PIECES}") from None
    # An error before and after can be compared where both are of simulations: not by innovations.
    before = None if method == "kalman" else _unfitted(start, _pieces(parts, asked), result)
    # From the true values of a pendulum in its loop a search walked to numbers 170 times off, with
    # bands of 20 %: what did not come to rest is said, and not answered with.
    says = unsettled(result, before)
    if says and method != "prediction":
        says = (*says, _IN_PIECES)
    return Estimated(result, parts, held_out, says)


def _unfitted(start: PhysicalModel, pieces: Sequence[Experiment], result: Estimate) -> Estimate:
    """The model as it was, first states alone fitted, outputs weighed as for the result.

    Weights of its own would be found by several searches more, which take longer the more the model
    lacks, and only the sizes of the two errors are compared: to a thousandth, hence no digits more.
    """
    settings = Settings(weights=result.weights, tolerance=_BEFORE)
    return estimate(start, pieces, free=(), settings=settings)


def _refuse_unknown(model: PhysicalModel, free: Sequence[str] | None) -> None:
    for name in free or ():
        if name not in model.all_parameters:
            raise BadInput(
                repr(name),
                "free",
                f"is no parameter of model {model.name!r};"
                f" {known_names(name, model.all_parameters, 'there are')}",
            )


def _pieces(experiments: Sequence[Experiment], asked: Asked) -> Sequence[Experiment]:
    """What the method simulates at once."""
    if asked.method != "prediction":
        return experiments
    return [piece for experiment in experiments for piece in windows(experiment, asked.steps)]


def _estimation_part(experiment: Experiment, record: Record) -> Experiment:
    if record.split is None:
        return experiment
    # A part of one sample has no error beside its own initial state.
    return experiment.window(0, max(2, round(record.split * experiment.n)))


def _held_out_error(
    model: PhysicalModel, experiments: Sequence[Experiment], records: Sequence[Record]
) -> dict[str, float] | None:
    """RMS error of each output on the parts after the split, simulated with initial states of their
    own.
    """
    held_out = []
    for experiment, record in zip(experiments, records, strict=True):
        if record.split is None:
            continue
        cut = round(record.split * experiment.n)
        if experiment.n - cut >= 2:  # one sample has no error beside its own initial state
            held_out.append(experiment.window(cut, experiment.n))
    if not held_out:
        return None
    rmse = estimate(model, held_out, free=()).rmse
    return {name: float(rmse[k]) for k, name in enumerate(model.outputs) if np.isfinite(rmse[k])}
