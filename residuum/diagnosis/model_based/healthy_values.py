"""A model's values, its noise and its filter, estimated from healthy windows by the likelihood of the innovations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.model_based.filtered_window import Filtered, TrackingFilter, largest_substeps
from residuum.identification.errors import NotIdentifiable
from residuum.identification.nelder_mead import nelder_mead
from residuum.identification.physics import Experiment, Noise, PhysicalModel, Simulator
from residuum.identification.physics.estimate.least_squares import covariance_of, damped, solve_scaled
from residuum.identification.physics.simulate.filter_sensitivities import innovation_slopes
from residuum.identification.physics.simulate.kalman import first_noise

Array = npt.NDArray[np.float64]

_ROUNDS, _STEPS, _ATTEMPTS = 3, 8, 6
_TUNED_ON = 6
"""Windows that the noise is tuned on."""
_TUNED_SAMPLES = 6000
_EVALUATIONS = 70
_SETTLED = 0.01
"""Rise of the log-likelihood at which the climb stops."""
_OPEN = 0.5
"""Relative standard deviation, over all healthy windows together, from which on a value is not determined."""


class Undetermined(NotIdentifiable):
    """Healthy windows do not determine some of the model's parameters, which are named."""

    def __init__(self, message: str, parameters: Sequence[str]) -> None:
        super().__init__(message)
        self.parameters = tuple(parameters)


@dataclass(frozen=True, eq=False)
class HealthyValues:
    """A filter with the estimated values and noise, each window along its track, and how well the values are known."""

    tracking: TrackingFilter
    windows: list[Filtered]
    free: tuple[str, ...]
    covariance: Array
    log_likelihood: float


def healthy_values(model: PhysicalModel, experiments: Sequence[Experiment], free: Sequence[str]) -> HealthyValues:
    """Climb the innovations' likelihood by the values named `free`, in turn with the noise.

    Raises
    ------
    NotIdentifiable
        The filter diverges on a window at the values of the file.
    """
    tracking = _first(model, experiments)
    noise, best = tracking.noise, -np.inf
    for _ in range(_ROUNDS):
        tracking = _rescaled(tracking, experiments)
        tracking = tracking.with_noise(tuned(tracking, experiments, noise))
        tracking, windows, likelihood = _climb(tracking, experiments, free)
        noise = tracking.noise
        if likelihood < best + 0.5:
            break
        best = likelihood
    H = np.sum([_normal(w, tracking, free)[0] for w in windows], axis=0) if free else np.zeros((0, 0))
    theta = np.array([tracking.model.values[name] for name in free])
    covariance, _ = covariance_of(np.asarray(H), 1.0, tuple(free), theta)
    return HealthyValues(tracking, windows, tuple(free), covariance, likelihood)


def refuse_undetermined(values: HealthyValues) -> None:
    """Raise where the windows leave a free value open: Undetermined says which and what to record."""
    std = np.sqrt(np.diag(values.covariance))
    now = values.tracking.model.values
    own = [name for name in values.free if "@" not in name]
    wide = [n for n, s in zip(values.free, std, strict=True) if n in own and not s < _OPEN * max(abs(now[n]), 1e-300)]
    if wide:
        driving = ", ".join(values.tracking.model.inputs) or "the machine"
        lacking = [n for k, n in enumerate(values.tracking.model.outputs) if not _measured(values)[k]]
        more = f", or record {' or '.join(lacking)} too" if lacking else ""
        names = ", ".join(wide)
        raise Undetermined(
            f"model {values.tracking.model.name!r}: healthy windows do not determine {names}: record windows in which {driving} "
            f"moves faster and over a wider range{more}, or keep {'them' if len(wide) > 1 else 'it'} at the file's value: "
            "--fix-undetermined",
            wide,
        )


def _measured(values: HealthyValues) -> npt.NDArray[np.bool_]:
    return np.asarray(np.any([w.experiment.measured for w in values.windows], axis=0))


def _first(model: PhysicalModel, experiments: Sequence[Experiment]) -> TrackingFilter:
    noise = first_noise(model, experiments)
    unmeasured = ~np.any([e.measured for e in experiments], axis=0)
    noise = Noise(np.where(unmeasured, 1.0, noise.output_variance), noise.walk)
    spread = np.array([float(np.nanmax(np.abs(e.Y))) for e in experiments])
    states = len(Simulator(model).states)
    tracking = TrackingFilter(model, noise, np.full(states, float(np.max(spread)) or 1.0), 1)
    starts = [tracking.start(e) for e in experiments]
    steps = largest_substeps(model, experiments[:3], starts[:3])
    tracking = TrackingFilter(model, noise, tracking.scales, steps)
    if any(not tracking.run(e, slopes=False).follows for e in experiments):
        raise NotIdentifiable(
            f"model {model.name!r}: its filter diverges on the healthy windows with the values of the file; "
            "estimate them first (`residuum estimate`)"
        )
    return tracking


def _rescaled(tracking: TrackingFilter, experiments: Sequence[Experiment]) -> TrackingFilter:
    """With the doubt of each first state its largest size along the windows (once they are followed)."""
    tracks = [tracking.states(tracking.run(e, slopes=False)) for e in experiments]
    peak = np.max([np.max(np.abs(X), axis=0) for X in tracks], axis=0)
    scales = np.where(np.isfinite(peak) & (peak > 0.0), peak, tracking.scales)
    return TrackingFilter(tracking.model, tracking.noise, scales, tracking.substeps)


def tuned(tracking: TrackingFilter, experiments: Sequence[Experiment], start: Noise) -> Noise:
    """The noise that makes the innovations of some windows likeliest, from `start`."""
    every = max(1, len(experiments) // _TUNED_ON)
    chosen = list(experiments[::every])[:_TUNED_ON]
    length = max(50, _TUNED_SAMPLES // len(chosen))
    parts = [e.window(0, min(e.n, length)) for e in chosen]
    balances = list(start.walk)
    measured = np.any([e.measured for e in experiments], axis=0)

    def noise(exponents: Array) -> Noise:
        walk = {b: start.walk[b] * float(np.exp(v)) for b, v in zip(balances, exponents, strict=False)}
        factors = np.ones(len(measured))
        factors[measured] = np.exp(exponents[len(balances) :])
        return Noise(start.output_variance * factors, walk)

    def cost(exponents: Array) -> float:
        if np.max(np.abs(exponents)) > 25:
            return 1e12
        trial = tracking.with_noise(noise(exponents))
        total = sum(trial.run(e, slopes=False).log_likelihood for e in parts)
        return -total if np.isfinite(total) else 1e12

    size = len(balances) + int(measured.sum())
    simplex = np.vstack([np.zeros(size), 2.0 * np.eye(size)])
    return noise(nelder_mead(cost, simplex, _EVALUATIONS))


def _normal(filtered: Filtered, tracking: TrackingFilter, free: Sequence[str]) -> tuple[Array, Array]:
    """Normal matrix and gradient of one window's normalised innovations by the free values."""
    base = np.array([tracking.columns.index(f"parameter:{name}") for name in free], dtype=np.int64)
    f = filtered
    J = innovation_slopes(f.P, f.F, f.H, f.e, f.V, f.G, f.C, base, np.ones((f.experiment.n, len(free))))
    flat = J.reshape(-1, len(free))
    return flat.T @ flat, flat.T @ np.nan_to_num(f.normalised).ravel()


def _climb(
    tracking: TrackingFilter, experiments: Sequence[Experiment], free: Sequence[str]
) -> tuple[TrackingFilter, list[Filtered], float]:
    """Damped Gauss–Newton steps of the free values."""
    parameters = tracking.model.all_parameters
    lower, upper = np.array([parameters[n].lower for n in free]), np.array([parameters[n].upper for n in free])
    theta = np.array([parameters[n].value for n in free])
    windows = [tracking.run(e) for e in experiments]
    likelihood, damping = sum(w.log_likelihood for w in windows), 1e-3
    for _ in range(_STEPS if free else 0):
        parts = [_normal(w, tracking, free) for w in windows]
        H, g = np.sum([h for h, _ in parts], axis=0), np.sum([b for _, b in parts], axis=0)
        for _ in range(_ATTEMPTS):
            trial = np.clip(theta + solve_scaled(damped(H, damping), g[:, None])[:, 0], lower, upper)
            values = dict(zip(free, trial.tolist(), strict=True))
            there = [tracking.run(e, values) for e in experiments]
            risen = sum(w.log_likelihood for w in there) - likelihood
            if risen > 0.0:
                break
            damping *= 10.0
        else:
            break
        theta, windows, likelihood, damping = trial, there, likelihood + risen, max(damping / 10.0, 1e-9)
        if risen < _SETTLED:
            break
    return tracking.with_values(dict(zip(free, theta.tolist(), strict=True))), windows, float(likelihood)
