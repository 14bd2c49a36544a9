"""Whether a simulation can follow a record at all: an unstable plant's cannot, however right its
model is.

A plant that a controller holds where it would run away (a ball below a magnet, a pendulum on its
head) is recorded without harm, but a simulation from its inputs leaves the record: what noise and
the last digits change grows as e^(λt). Then the error of a simulation says nothing of what the
model lacks, and each parameter that slows the growth seems to explain it.

Told by the linearisation along the states that a filter finds in the record (not those of a
simulation, which has left them): the largest difference δ there, dδ/dt = ∂f/∂x δ, over the second
half of the record, since an integrator's grows in the first half and hardly on. Only of a model
whose simulation is no nearer to the record than its mean. Fails for an experiment whose states the
outputs do not tell.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import MAY_DIVERGE, NotIdentifiable, said
from residuum.identification.physics import Estimate, Experiment, PhysicalModel, estimate
from residuum.identification.physics.simulate.kalman import Filter, first_noise
from residuum.identification.physics.simulate.simulation import Simulator

_MOST_GROWTH = np.log(1e3)
"""Of a difference over half a record: a millionfold over the whole."""
_LOOKS = 2000
"""Places along a record at which the model is linearised, at most: bounds the time of a long one.
"""


def check_followed(
    model: PhysicalModel, experiments: Sequence[Experiment], simulated: Estimate | None = None
) -> None:
    """Raise NotIdentifiable where a model is unstable along a record that its simulation does not
    follow.

    `simulated` is the model as it is on these experiments, where it is known.
    """
    try:
        simulated = simulated or estimate(model, experiments, free=())
    except NotIdentifiable:  # diverges: no simulation is near
        near = [False] * len(experiments)
    else:
        near = [
            _is_near(e.Y, residual)
            for e, residual in zip(experiments, simulated.residuals, strict=True)
        ]
    for e in (e for e, is_near in zip(experiments, near, strict=True) if not is_near):
        lasts, growth = e.n * e.sample_time, growth_over_second_half(model, e)
        if growth > _MOST_GROWTH:
            times = (
                f"a difference grows e-fold in {0.5 * lasts / growth:.3g} s, the record lasts"
                f" {lasts:.4g} s"
            )
            raise NotIdentifiable(
                f"model {model.name!r}: is unstable along record {e.source!r} ({times}), so that no"
                " simulation stays with it, however right the model is, and nothing tells what it"
                " lacks; where a controller holds the plant, estimate with"
                f" {said('method', 'prediction')} begins anew every few samples and tells its"
                " values; where the plant is stable,"
                f" {MAY_DIVERGE}"
            )


def _is_near(measured: FloatArray, residual: FloatArray) -> bool:
    """Whether the simulation of some output is nearer to it than its mean."""
    with np.errstate(over="ignore", invalid="ignore"):
        error = np.nansum(residual**2, axis=0)
        spread = np.nansum((measured - _means(measured)) ** 2, axis=0)
    return bool(np.any(error < spread))


def _means(measured: FloatArray) -> FloatArray:
    known = np.isfinite(measured)
    return np.asarray(np.where(known, measured, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1))


def growth_over_second_half(model: PhysicalModel, experiment: Experiment) -> float:
    """Logarithm of the factor by which the largest difference grows there, along the filtered
    states; 0 where nothing filters.
    """
    # a fifth of a second, for the few models that a simulation leaves
    from scipy.linalg import expm  # noqa: PLC0415

    simulator = Simulator(model)
    if not simulator.states:
        return 0.0
    # along the filtered states, for a simulation has left the record; smoothing adds nothing here
    kalman = Filter(model, first_noise(model, [experiment]))
    X = kalman.run(experiment, simulator.measured_start(experiment), smooth=False).X
    at = np.unique(np.linspace(0, experiment.n - 1, _LOOKS).astype(np.int64))
    A = simulator.rate_slopes(experiment, X, at)
    if not np.all(np.isfinite(A)):
        return 0.0
    # Φ = Π exp(A Δt), its size taken out at each step, so that nothing overflows
    spans = np.diff(at, append=experiment.n) * experiment.sample_time
    difference, growth = np.eye(len(simulator.states)), 0.0
    for k, step in enumerate(expm(A * spans[:, None, None])):
        difference = step @ difference
        size = float(np.linalg.norm(difference, 2))
        if not 0.0 < size < np.inf:
            return 0.0
        difference /= size
        growth += np.log(size) if 2 * k >= len(at) else 0.0
    return float(growth)
