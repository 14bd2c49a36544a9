"""Whether what was found leaves no more than the right effects leave."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import numpy.typing as npt

from residuum.identification.discrepancy.fitting.structures import Structure, times_its_innovations
from residuum.identification.discrepancy.policy.answers import (
    MOST_OF_THE_EXCESS,
    MUCH_ABOVE_NOISE,
    OWN_SIGNALS_LEVEL,
    OWN_SIGNALS_SHARE,
    STANDS_COMPLETE_OR_NOT,
)
from residuum.identification.discrepancy.policy.likelihood import LEAST_ERROR
from residuum.identification.discrepancy.searching.search_state import Search
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics import Estimate, Experiment, Simulator, estimate
from residuum.identification.residual_analysis.noise.noise_floor import fast_floor, times_the_noise, times_the_quiet_noise
from residuum.identification.residual_analysis.places.axes import signal_axes
from residuum.identification.residual_analysis.policy.noise import AN_EVENT, BEYOND_NOISE, SLOW
from residuum.identification.residual_analysis.structure_tests import structured_errors

FloatArray = npt.NDArray[np.float64]


def explains_a_part(found: Search) -> bool:
    """Whether little went of what stood above the noise: the nearest shape in the catalogue to something else does that."""
    before, after = (np.concatenate(s.residuals) ** 2 for s in (found.base, found.best))
    floors = np.array([fast_floor(column) for column in _of_each_output(found.best.residuals)])
    known = floors > 0.0
    stood, stands = (np.sum(np.nanmean(power[:, known], axis=0) / floors[known] ** 2 - 1.0) for power in (before, after))
    return bool(stood - stands < MOST_OF_THE_EXCESS * stood)


def leaves_much(structure: Structure) -> bool:
    """Whether an error stands so far above the noise of its fast part as none does with the right effects in the model."""
    return times_the_noise_left(structure) > MUCH_ABOVE_NOISE


def at_the_noise(structure: Structure) -> bool:
    """Whether no more is left of any output than the right effects leave."""
    return not leaves_much(structure)


def times_the_noise_left(structure: Structure) -> float:
    """Times the noise of its fast part that the error of an output stands at most."""
    return max(map(times_the_noise, _of_each_output(structure.residuals)))


def _of_each_output(residuals: Sequence[FloatArray]) -> list[tuple[FloatArray, ...]]:
    """The residuals (n, outputs) of several experiments output by output."""
    return list(zip(*(r.T for r in residuals), strict=True))


def _plain(best: Structure, experiments: Sequence[Experiment]) -> Estimate | None:
    try:
        return estimate(best.model, experiments, initial=best.initial, settings=LEAST_ERROR)
    except NotIdentifiable:
        return None


def is_incomplete(found: Search, experiments: Sequence[Experiment]) -> bool:
    """Whether the model's own signals predict its least simulation error, so that it cannot be called complete.

    The search may find nothing to add and yet a slow error remain: noise that is nearly integrated swallows it. Or what it
    found takes away little of the error, as the nearest shape to something that the catalogue does not hold. Where an output's
    error fell to less than `STANDS_COMPLETE_OR_NOT` what was found stands, complete or not.

    Few steps of an input, and as many slow answers that the model lacks, look like a walk at random; but a model whose error
    stands `SLOW` times above what its noise cannot predict is not complete either way.
    """
    with np.errstate(invalid="ignore"):
        fell = float(np.nanmin(found.best.rmse / found.base.rmse))
    if fell < STANDS_COMPLETE_OR_NOT:
        return False
    if times_its_innovations(found.best) > SLOW:
        return True
    least = _plain(found.best, experiments) or found.best  # where that leads to where the model diverges: as it is likeliest
    simulator = Simulator(least.model)
    runs = simulator.run_each(experiments, least.initial, simulator.p(), substeps=least.substeps)
    residuals = runs.errors_of_each
    columns = _of_each_output(residuals)
    if any(times_the_noise(c) > BEYOND_NOISE or times_the_quiet_noise(c) > AN_EVENT for c in columns):
        return True
    axes = [signal_axes(least.model, e, run.X) for e, run in zip(experiments, runs, strict=True)]
    tests = structured_errors(experiments, residuals, axes, least.model, level=OWN_SIGNALS_LEVEL, least_share=OWN_SIGNALS_SHARE)
    return any(test.present and test.share > OWN_SIGNALS_SHARE for test in tests.values())
