"""Feedback: whether an input answers the noise of an output, as a controller's does that acts on
the measurement.

Then means over several samples are no innovations: the input that moved within them knows their
noise, and what acts there (a lag) would seem to explain it. And the input was held: one that moved
towards its next value would have known what is measured then.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from residuum.array_types import FloatArray
from residuum.identification.errors import BadInput, NotIdentifiable
from residuum.identification.physics import (
    Estimate,
    Experiment,
    PhysicalModel,
    Simulator,
    estimate,
)
from residuum.identification.physics.estimation.estimation import Settings
from residuum.identification.physics.estimation.unsettled import PROMISED
from residuum.identification.residual_analysis.noise import fit_noises
from residuum.identification.residual_analysis.policy import (
    ANSWER_CERTAIN,
    ANSWER_LAGS,
    ANSWER_SAMPLES,
    ANSWER_SHARE,
    NOISE_ORDER,
    NORMAL_MEDIAN,
    OUTLYING_INNOVATION,
)
from residuum.identification.residual_analysis.structured_error import lasting_noise
from residuum.identification.side_by_side import side_by_side

SPEAKS_AGAINST = 10.0
"""Logarithm of the likelihoods' ratio beyond which a timing is not fitted."""
GRANTED = 3.0
"""Times what the next step promises that a fit is taken to gain beyond it."""

# Whether inputs were held over their sample or moved evenly to the next one: what the data say.


def turned_timing(experiments: Sequence[Experiment]) -> list[Experiment]:
    """Inputs that were held now move evenly, and those that moved are held."""
    return [e.turned(np.ones(len(e.hold), dtype=bool)) for e in experiments]


def each_turned(experiments: Sequence[Experiment]) -> list[list[Experiment]]:
    """The other timing of one input alone, once for each of several that change; of a single one
    nothing more than all turned.
    """
    changes = np.any([np.ptp(e.U, axis=0) > 0 for e in experiments], axis=0)
    if changes.sum() < 2:
        return []
    return [
        [e.turned(np.arange(len(changes)) == k) for e in experiments]
        for k in np.flatnonzero(changes)
    ]


Nearby = Callable[[Estimate, list[Experiment]], Estimate]
"""A fit to experiments at another timing, one step from the estimate that is given."""


def a_step_away(best: Estimate, turned: Sequence[Experiment]) -> Estimate:
    """What was estimated, after one step to the experiments at another timing, outputs weighed as
    before; NotIdentifiable where it diverges there.
    """
    return estimate(
        best.model,
        turned,
        free=best.parameters,
        initial=best.initial,
        settings=Settings(weights=best.weights, iterations=1),
        substeps=best.substeps,
    )


def at_likelier_timing(
    experiments: Sequence[Experiment],
    fitted: Callable[[list[Experiment]], Estimate],
    nearby: Nearby | None = None,
) -> tuple[list[Experiment], Estimate]:
    """What is fitted with inputs held over their samples or moving evenly between them, whichever
    leaves the smaller innovations.

    The two conventions differ by half a sample. A good record shows the wrong one as a structured
    error of its own, and as parameters that lie many standard deviations beside the truth. Where
    noise is slow the error itself does not tell them apart: half a sample is fast. All inputs are
    turned at once, then each of several for itself: one may be a controller's, which holds, and
    another a measured one. Where `nearby` says what a step from the best fit gives, a timing that
    this leaves far behind is not fitted: a fit costs ten times as much.
    """

    def tried(turned: list[Experiment]) -> tuple[list[Experiment], Estimate] | NotIdentifiable:
        try:
            return turned, fitted(turned)
        except NotIdentifiable as diverges:
            return diverges

    def likelier(
        best: tuple[list[Experiment], Estimate], turned: list[list[Experiment]]
    ) -> tuple[list[Experiment], Estimate]:
        if nearby is not None:
            open_ = side_by_side(lambda one: _in_question(best[1], one, nearby), turned)
            turned = [one for one, asked in zip(turned, open_, strict=True) if asked]
        return _likelier([best, *side_by_side(tried, turned)])

    at_all = turned_timing(experiments)
    if nearby is None:
        first, alternative = side_by_side(tried, [list(experiments), at_all])
    else:
        first = tried(list(experiments))
    # a model that diverges at the timing it was given is refused, whatever it does at the other one
    if isinstance(first, NotIdentifiable):
        raise first
    best = _likelier([first, alternative]) if nearby is None else likelier(first, [at_all])
    return likelier(best, each_turned(best[0]))


def _in_question(best: Estimate, turned: list[Experiment], nearby: Nearby) -> bool:
    """Whether a fit at another timing may leave smaller innovations than the best so far.

    Not where a step from the best is at rest there and the data still speak against it: with n rows
    and variances v of innovations twice the logarithm of the likelihoods' ratio is n Σ Δ log v.
    What the next step promises is granted several times over, all of it to one output.
    """
    try:
        near = nearby(best, turned)
    except NotIdentifiable:
        return True
    if not near.promised <= PROMISED:
        return True
    measured = np.isfinite(np.concatenate(near.residuals))
    rows, outputs = np.any(measured, axis=1).sum(), np.any(measured, axis=0).sum()
    granted = GRANTED * outputs * near.promised
    behind = innovations_of(near.residuals) - innovations_of(best.residuals)
    return not behind > granted + 2.0 * SPEAKS_AGAINST / rows


def _likelier(
    tried: Sequence[tuple[list[Experiment], Estimate] | NotIdentifiable],
) -> tuple[list[Experiment], Estimate]:
    fits = [trial for trial in tried if not isinstance(trial, NotIdentifiable)]
    return min(fits, key=lambda fit: innovations_of(fit[1].residuals))


def innovations_of(residuals: Sequence[FloatArray]) -> float:
    """Logarithm of the variance of residuals' innovations, summed over the outputs that were
    measured.
    """
    outputs = range(residuals[0].shape[1])
    logarithms = [
        np.log(max(innovation_variance([r[:, o] for r in residuals]), 1e-300)) for o in outputs
    ]
    return float(np.nansum(logarithms))


def innovation_variance(residuals: Sequence[FloatArray]) -> float:
    """Of one output's residuals; their own where they are too few to tell a colour, NaN where they
    were not measured.
    """
    try:
        return lasting_noise(residuals, NOISE_ORDER).innovation_variance
    except BadInput:
        known = np.concatenate([r[np.isfinite(r)] for r in residuals])
        return float(np.mean(known**2)) if known.size else np.nan


def feeds_back(
    model: PhysicalModel, experiments: Sequence[Experiment], residuals: Sequence[FloatArray]
) -> bool:
    """Whether an input's innovations answer those of an output's `residuals` (n, outputs) of each
    experiment, at every sample.

    What an output feels at once (a current its voltage) may correlate with it for other reasons;
    there only later answers count.
    """
    at_once, most = _felt_at_once(model, experiments[0]), -(-ANSWER_SAMPLES // len(experiments))
    # innovations of both: signals themselves correlate wherever the plant is driven, what their own
    # past does not predict only where one answers the other
    inputs = _innovations([e.U[:most] for e in experiments])
    for o, e in enumerate(_innovations([r[:most] for r in residuals])):
        for u in inputs:
            for lag in range(1 if at_once[o] else 0, ANSWER_LAGS):
                if e is not None and u is not None and _answers(e[: len(e) - lag], u[lag:]):
                    return True
    return False


def _felt_at_once(model: PhysicalModel, experiment: Experiment) -> npt.NDArray[np.bool_]:
    """Which outputs change with the inputs of the same sample."""
    # two samples, once with the inputs stepped by their spread: what differs at the first one is
    # felt at once
    simulator, first = Simulator(model), experiment.window(0, 2)
    stepped = replace(first, U=first.U + np.std(experiment.U, axis=0))
    runs = [
        simulator.run_vectors(e, simulator.x0(), simulator.p(), substeps=1)
        for e in (first, stepped)
    ]
    return np.asarray(runs[0].Y[0] != runs[1].Y[0])


def _innovations(signals: Sequence[FloatArray]) -> list[FloatArray | None]:
    """What the past of each signal does not predict of it, in units of its spread, outliers drawn
    in; None if that is nothing.
    """
    by_output: list[FloatArray | None] = []
    for o, noise in enumerate(fit_noises(signals, NOISE_ORDER)):
        if noise is None:
            by_output.append(None)
            continue
        e = np.concatenate(
            [_in_place(noise.whiten(np.ascontiguousarray(v[:, o])), len(v)) for v in signals]
        )
        spread = np.nanmedian(np.abs(e)) / NORMAL_MEDIAN if e.size else 0.0
        by_output.append(
            np.clip(e / spread, -OUTLYING_INNOVATION, OUTLYING_INNOVATION) if spread > 0.0 else None
        )
    return by_output


def _in_place(e: FloatArray, n: int) -> FloatArray:
    """Innovations at their own samples: the first have no past, and how many depends on the noise's
    order, so on the signal.
    """
    return np.r_[np.full(n - len(e), np.nan), e]


def _answers(e: FloatArray, u: FloatArray) -> bool:
    known = np.isfinite(e) & np.isfinite(u)
    if not known.any():
        return False
    # the squared correlation: large enough to matter, and beyond what so many samples give by
    # chance
    share = np.mean(e[known] * u[known]) ** 2 / (np.mean(e[known] ** 2) * np.mean(u[known] ** 2))
    return bool(share > ANSWER_SHARE and share * known.sum() > ANSWER_CERTAIN)
