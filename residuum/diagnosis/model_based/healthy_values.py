"""A model's values, its noise and its filter, estimated from healthy windows by the likelihood of the innovations."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.diagnosis.model_based.filtered_window import Filtered, FilterNoise, TrackingFilter, largest_substeps
from residuum.diagnosis.model_based.hypotheses import Hypothesis
from residuum.identification.errors import NotIdentifiable
from residuum.identification.nelder_mead import nelder_mead
from residuum.identification.physics import Experiment, PhysicalModel, Simulator
from residuum.identification.physics.estimation.least_squares import covariance_of, damped, solve_scaled
from residuum.identification.physics.simulate.filter_sensitivities import innovation_slopes
from residuum.identification.physics.simulate.kalman import first_noise

Array = npt.NDArray[np.float64]

_ROUNDS, _STEPS, _ATTEMPTS = 3, 8, 6
_TUNED_ON = 6
"""Windows that the noise is tuned on."""
_TUNED_SAMPLES = 6000
_EVALUATIONS = 70
_STARTING = 1e-3
"""Process noise of each state a sample that a first track is made with, in its scale."""
_LACKING = 0.03
"""Share of a balance's largest term that its noise begins with."""
_SCATTERED = 0.3
"""Relative scatter from window to window that values are granted while the noise is tuned."""
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


@dataclass(frozen=True, eq=False)
class Marginal:
    """A window's log-likelihood with its own values integrated out, its normal matrix and gradient by their mean."""

    likelihood: float
    H: Array
    g: Array


def healthy_values(
    model: PhysicalModel, experiments: Sequence[Experiment], free: Sequence[str], start: TrackingFilter | None = None
) -> HealthyValues:
    """Climb the innovations' likelihood by the values named `free`, in turn with the noise; with a filter to `start` from its
    noise stays.

    Raises
    ------
    NotIdentifiable
        The filter diverges on a window at the values of the file.
    """
    tracking = _first(model, experiments) if start is None else _like(start, model, experiments)
    best = -np.inf
    for _ in range(_ROUNDS if start is None else 1):
        if start is None:
            tracking = _rescaled(tracking, experiments)
            tracking = tracking.with_noise(tuned(tracking, experiments, free))
        tracking, windows, likelihood = _climb(tracking, experiments, free)
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
    variance = first_noise(model, experiments).output_variance
    unmeasured = ~np.any([e.measured for e in experiments], axis=0)
    spread = np.array([float(np.nanmax(np.abs(e.Y))) for e in experiments])
    scales = np.full(len(Simulator(model).states), float(np.max(spread)) or 1.0)
    noise = FilterNoise(np.where(unmeasured, 1.0, variance), np.diag((_STARTING * scales) ** 2))
    tracking = TrackingFilter(model, noise, scales, 1)
    starts = [tracking.start(e) for e in experiments]
    steps = largest_substeps(model, experiments[:3], starts[:3])
    tracking = TrackingFilter(model, noise, tracking.scales, steps)
    _refuse_diverging(tracking, experiments)
    return tracking


def _like(start: TrackingFilter, model: PhysicalModel, experiments: Sequence[Experiment]) -> TrackingFilter:
    """A filter of another model of the same states with this one's noise."""
    tracking = TrackingFilter(model, start.noise, start.scales, start.substeps)
    _refuse_diverging(tracking, experiments)
    return tracking


def _refuse_diverging(tracking: TrackingFilter, experiments: Sequence[Experiment]) -> None:
    if any(not tracking.run(e, slopes=False).follows for e in experiments):
        raise NotIdentifiable(
            f"model {tracking.model.name!r}: its filter diverges on the healthy windows with the values of the file; "
            "estimate them first (`residuum estimate`)"
        )


def _rescaled(tracking: TrackingFilter, experiments: Sequence[Experiment]) -> TrackingFilter:
    """With the doubt of each first state its largest size along the windows (once they are followed)."""
    tracks = [tracking.states(tracking.run(e, slopes=False)) for e in experiments]
    peak = np.max([np.max(np.abs(X), axis=0) for X in tracks], axis=0)
    scales = np.where(np.isfinite(peak) & (peak > 0.0), peak, tracking.scales)
    return TrackingFilter(tracking.model, tracking.noise, scales, tracking.substeps)


def tuned(tracking: TrackingFilter, experiments: Sequence[Experiment], free: Sequence[str]) -> FilterNoise:
    """The noise that makes the innovations of some windows likeliest, each with values of its own.

    What lasts over a window is a value that differs from window to window, no noise: the likelihood is that of the innovations
    whose values scatter by `_SCATTERED` of their size, marginal over them (to first order).
    """
    every = max(1, len(experiments) // _TUNED_ON)
    chosen = list(experiments[::every])[:_TUNED_ON]
    length = max(50, _TUNED_SAMPLES // len(chosen))
    parts = [e.window(0, min(e.n, length)) for e in chosen]
    ways = _ways(tracking, parts[0])
    measured = np.any([e.measured for e in experiments], axis=0)
    prior = scatter_of(tracking.model, free) ** 2
    start = tracking.noise.output_variance

    def noise(exponents: Array) -> FilterNoise:
        factors = np.ones(len(measured))
        factors[measured] = np.exp(exponents[len(ways) :])
        process = np.zeros_like(tracking.noise.process)
        for way, exponent in zip(ways, exponents, strict=False):
            process = process + way * float(np.exp(exponent))
        return FilterNoise(start * factors, process)

    def cost(exponents: Array) -> float:
        if np.max(np.abs(exponents)) > 25:
            return 1e12
        trial = tracking.with_noise(noise(exponents))
        total = sum(_marginal(trial.run(e), trial, free, prior).likelihood for e in parts)
        return -total if np.isfinite(total) else 1e12

    size = len(ways) + int(measured.sum())
    simplex = np.vstack([np.zeros(size), 2.0 * np.eye(size)])
    return noise(nelder_mead(cost, simplex, _EVALUATIONS))


def scatter_of(model: PhysicalModel, free: Sequence[str]) -> Array:
    """Standard deviation from window to window that values are granted while noise and colour are learned."""
    theta = np.array([model.values[name] for name in free])
    return np.where(theta != 0.0, _SCATTERED * np.abs(theta), 1.0)


def value_columns(model: PhysicalModel, listed: Sequence[Hypothesis]) -> tuple[list[int], Array]:
    """Which sizes of the hypotheses are values of the model, and the scatter that they are granted."""
    columns = [c.acts_on for h in listed for c in h.columns]
    found = [k for k, acts_on in enumerate(columns) if acts_on.startswith("parameter:")]
    return found, scatter_of(model, [columns[k].removeprefix("parameter:") for k in found])


def _ways(tracking: TrackingFilter, experiment: Experiment) -> list[Array]:
    """What a share of each balance's terms, new in each sample, adds to the states' covariance."""
    filtered = tracking.run(experiment)
    look = tracking.simulator.look(experiment, tracking.states(filtered))
    found = []
    for name, balance in tracking.model.balances.items():
        G = filtered.G[:-1, :, tracking.columns.index(f"balance:{name}")]
        largest = max((float(np.sqrt(np.mean(look[f"{name}.{term}"] ** 2))) for term in balance.terms), default=1.0)
        way = G.T @ G / len(G) * (_LACKING * (largest or 1.0)) ** 2
        if np.isfinite(way).all() and np.any(way > 0.0):
            found.append(way)
    return found


def _marginal(filtered: Filtered, tracking: TrackingFilter, free: Sequence[str], prior: Array) -> Marginal:
    """A window's likelihood when its values scatter with variance `prior` about the filter's, to first order."""
    if not filtered.follows:
        return Marginal(-np.inf, np.zeros((len(free), len(free))), np.zeros(len(free)))
    H, g = _normal(filtered, tracking, free)
    root = np.sqrt(prior)
    inner = np.eye(len(root)) + root[:, None] * H * root
    solved = np.linalg.solve(inner, root[:, None] * np.column_stack([H, g]))
    likelihood = filtered.log_likelihood + 0.5 * float((root * g) @ solved[:, -1]) - 0.5 * float(np.linalg.slogdet(inner)[1])
    left = np.column_stack([H, g]) - H @ (root[:, None] * solved)
    return Marginal(likelihood, 0.5 * (left[:, :-1] + left[:, :-1].T), left[:, -1])


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
    """Damped Gauss–Newton steps of the free values, which scatter from window to window."""
    prior = scatter_of(tracking.model, free) ** 2
    parameters = tracking.model.all_parameters
    lower, upper = np.array([parameters[n].lower for n in free]), np.array([parameters[n].upper for n in free])
    theta = np.array([parameters[n].value for n in free])
    windows = [tracking.run(e) for e in experiments]
    parts = [_marginal(w, tracking, free, prior) for w in windows]
    likelihood, damping = sum(part.likelihood for part in parts), 1e-3
    for _ in range(_STEPS if free else 0):
        H, g = np.sum([part.H for part in parts], axis=0), np.sum([part.g for part in parts], axis=0)
        for _ in range(_ATTEMPTS):
            trial = np.clip(theta + solve_scaled(damped(H, damping), g[:, None])[:, 0], lower, upper)
            values = dict(zip(free, trial.tolist(), strict=True))
            there = [tracking.run(e, values) for e in experiments]
            trials = [_marginal(w, tracking, free, prior) for w in there]
            risen = sum(part.likelihood for part in trials) - likelihood
            if risen > 0.0:
                break
            damping *= 10.0
        else:
            break
        theta, windows, parts, likelihood, damping = trial, there, trials, likelihood + risen, max(damping / 10.0, 1e-9)
        if risen < _SETTLED:
            break
    return tracking.with_values(dict(zip(free, theta.tolist(), strict=True))), windows, float(likelihood)
