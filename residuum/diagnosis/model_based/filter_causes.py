"""Causes that change the filter itself: a sensor's noise, a load that changes at random, a second body behind a spring or play.

None of them is a column beside the innovations: noise changes how far readings are trusted, a second body has states of its own.
So each is asked by running the filter that it makes, and judged by the likelihood of that filter's innovations. That costs many
runs (some seconds a window), and is asked of those windows alone that nothing else explains.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from scipy.optimize import minimize_scalar

from residuum.diagnosis.model_based.baseline import Baseline
from residuum.diagnosis.model_based.filtered_window import Filtered, FilterNoise, TrackingFilter, largest_substeps
from residuum.diagnosis.model_based.sizes import Window
from residuum.diagnosis.model_based.window_statistics import whitened
from residuum.identification.errors import BadInput
from residuum.identification.nelder_mead import nelder_mead
from residuum.identification.physics import Experiment, PhysicalModel, candidates, conditions_at
from residuum.identification.physics.effects import EFFECTS
from residuum.identification.physics.effects.transmission.two_bodies import TwoBodies

Array = npt.NDArray[np.float64]

_GROWN = (0.0, 16.0)
"""Logarithm of the factor by which a variance may have grown."""
_LEAST = 1e-3
"""Smallest random load that is tried, as a share of the variance with which it would double that of an output's innovations."""
_PART = 2000
"""Samples, those with the most energy, on which the values of a second body are sought."""
_EVALUATIONS, _POLISHED = 150, 80
"""Filters that are run on the part, and then on the whole window."""
_SHARES = (0.3, 0.6, 0.85)
"""Shares of the inertia beyond the play or spring that are begun with."""
_ROUGH = 0.02
"""Random load beside a second body that is begun with, as a share of the load that alone would explain the window."""
_MOST_SUBSTEPS = 4
_FARTHEST = 6.0


@dataclass(frozen=True, eq=False)
class FilterCause:
    """A cause with the rise of the log-likelihood that its filter brings, how many sizes it has, and what its size is.

    A second body is told without one: its filter is linearised where the contact is not, and a likely gap may be a wrong one.
    """

    kind: str
    name: str
    place: str
    gain: float
    sizes: int
    value: float | None = None
    std: float | None = None
    unit: str = ""


def filter_causes(baseline: Baseline, window: Window) -> list[FilterCause]:
    """All of them that make the window likelier than the healthy machine's filter does."""
    found = noises(baseline, window)
    price = 0.5 * float(np.log(max(np.sum(window.sums.count), 2.0)))
    for rough in rough_loads(baseline, window):
        found.append(rough)
        for id in _second_bodies(baseline, rough.place):
            body = _second_body(baseline, window, id, rough.place, rough.value or 0.0)
            # a body that says no more than the random load beside it is that load
            found += [body] if body and body.gain - rough.gain > price * (body.sizes - rough.sizes) else []
    return [cause for cause in found if cause.gain > 0.0]


def noises(baseline: Baseline, window: Window) -> list[FilterCause]:
    """Each output's noise, as much larger as makes the window likeliest."""
    tracking, e = baseline.tracking, window.filtered.experiment
    found = []
    for o, (name, output) in enumerate(tracking.model.outputs.items()):
        if not np.isfinite(e.Y[:, o]).any():
            continue

        def grown(factor: float, o: int = o) -> FilterNoise:
            variance = tracking.noise.output_variance.copy()
            variance[o] *= factor
            return FilterNoise(variance, tracking.noise.process)

        factor, gain = _likeliest(baseline, window, grown)
        std = float(np.sqrt(tracking.noise.output_variance[o] * factor))
        readings = float(np.isfinite(e.Y[:, o]).sum())
        found.append(FilterCause("sensor", "noise", name, gain, 1, std, std / float(np.sqrt(2.0 * readings)), output.unit))
    return found


def rough_loads(baseline: Baseline, window: Window) -> list[FilterCause]:
    """A load on each balance, new at random in each sample, as large as makes the window likeliest."""
    tracking = baseline.tracking
    found = []
    for name, balance in tracking.model.balances.items():
        way = _way(tracking, window.filtered, name)
        least = _LEAST * _equal(window.filtered, way)
        if not (np.isfinite(way).all() and np.isfinite(least)):
            continue

        def grown(factor: float, way: Array = way, least: float = least) -> FilterNoise:
            return FilterNoise(tracking.noise.output_variance, tracking.noise.process + way * least * (factor - 1.0))

        factor, gain = _likeliest(baseline, window, grown, _GROWN[1] - np.log(_LEAST))
        std = float(np.sqrt(least * max(factor - 1.0, 0.0)))
        doubt = std / float(np.sqrt(2.0 * window.filtered.experiment.n))
        found.append(FilterCause("disturbance", "rough-load", name, gain, 1, std, doubt, balance.unit))
    return found


def _way(tracking: TrackingFilter, filtered: Filtered, balance: str) -> Array:
    """Covariance that a unit of a balance, new in each sample, adds to the states."""
    G = filtered.G[:-1, :, tracking.columns.index(f"balance:{balance}")]
    return np.asarray(G.T @ G / len(G))


def _equal(filtered: Filtered, way: Array) -> float:
    """Variance of a load that adds as much in a sample to some output as its innovations have; infinite where none shows it."""
    H = np.asarray(filtered.H)[:, :, : len(way)]
    added = np.einsum("noi,ij,noj->no", H, way, H)
    there = np.isfinite(filtered.e) & (added > 0.0)
    return float(np.median(filtered.V[there] / added[there])) if there.any() else np.inf


def _likeliest(
    baseline: Baseline, window: Window, grown: Callable[[float], FilterNoise], most: float = _GROWN[1]
) -> tuple[float, float]:
    """The factor that makes the window likeliest, and the rise of its log-likelihood."""
    start = likelihood(baseline, window, window.filtered)

    def cost(exponent: float) -> float:
        noise = grown(float(np.exp(exponent)))
        filtered = baseline.tracking.with_noise(noise).run(_experiment(window), window.values, slopes=False)
        value = likelihood(baseline, window, filtered)
        return start - value if np.isfinite(value) else 1e12

    found = minimize_scalar(cost, bounds=(_GROWN[0], most), method="bounded", options={"xatol": 0.05, "maxiter": 20})
    return float(np.exp(found.x)), -float(found.fun)


def _experiment(window: Window) -> Experiment:
    return window.filtered.experiment


def likelihood(baseline: Baseline, window: Window, filtered: Filtered) -> float:
    """Log-likelihood of the whitened innovations beside what is usual (constants left out); −∞ where the filter does not follow.

    Samples that are but a part of the window are held against noise alone.
    """
    if not filtered.follows:
        return -np.inf
    rows, used = whitened(filtered, filtered.normalised, baseline.colours), np.isfinite(filtered.e)
    whole = len(rows) == len(window.rows)
    of_rows = window.likelihood(rows, baseline.scatter.scale) if whole else -0.5 * float(rows @ rows)
    return of_rows - 0.5 * float(np.sum(np.log(filtered.V[used])))


def _second_bodies(baseline: Baseline, place: str) -> list[str]:
    fit = candidates(baseline.tracking.model)
    return [id for id, target in fit if target == place and isinstance(EFFECTS[id], TwoBodies)]


def _second_body(baseline: Baseline, window: Window, id: str, target: str, rough: float) -> FilterCause | None:
    """A second body on a balance, with the values that make the window likeliest beside some random load; None: none does."""
    whole = _experiment(window)
    first = _most_energetic(window)
    try:
        trial = _Trial.of(baseline, window, id, target, whole.window(first, min(first + _PART, whole.n)))
    except (BadInput, NotImplementedError, KeyError, ValueError):
        return None
    rough_start = max(_ROUGH * rough, 1e-300)
    values = [trial.gain(start, rough_start, trial.part) for start in trial.starts]
    start = trial.starts[int(np.argmax(values))]

    on_part = trial.climbed(start, rough_start, trial.part, _EVALUATIONS)
    shape, _, gain = trial.climbed(*on_part[:2], whole, _POLISHED)
    return FilterCause("effect", id, target, gain, len(shape) + 1) if gain > 0.0 else None


def _most_energetic(window: Window) -> int:
    """First sample of the part with the largest innovations."""
    n, energy = window.filtered.experiment.n, np.sum(np.nan_to_num(window.filtered.normalised) ** 2, axis=1)
    if n <= _PART:
        return 0
    sums = np.concatenate([[0.0], np.cumsum(energy)])
    return int(np.argmax(sums[_PART:] - sums[:-_PART]))


@dataclass(frozen=True, eq=False)
class _Trial:
    """The filter of the model with a second body."""

    baseline: Baseline
    window: Window
    tracking: TrackingFilter
    label: str
    way: Array
    starts: Sequence[dict[str, float]]
    shares: Sequence[str]
    part: Experiment
    plain: Mapping[int, float]

    @classmethod
    def of(cls, baseline: Baseline, window: Window, id: str, target: str, part: Experiment) -> _Trial:
        """With the effect's own starts, each at several shares of the inertia."""
        plain, whole = baseline.tracking, _experiment(window)
        model, X = plain.model.with_values(window.values), plain.states(window.filtered)
        site = model.site(target, EFFECTS[id])
        conditions = conditions_at(model, EFFECTS[id], target, whole, X, np.zeros(whole.n))
        starts = [{**start, "share": share} for start in EFFECTS[id].starts(conditions) for share in _SHARES]
        model = model.with_effect(id, target, starts[0])
        twist = np.median([s.get("gap", 0.0) + conditions.magnitude / s["k"] for s in starts])
        scales = np.concatenate([plain.scales, [max(float(twist), 1e-300), max(conditions.largest("velocity"), 1e-300)]])
        x0 = np.concatenate([X[0], np.zeros(2)])
        asked = [largest_substeps(model.with_values(_named(model, s)), [part], [x0]) for s in starts[:: len(_SHARES)]]
        substeps = max(plain.substeps, min(max(asked), _MOST_SUBSTEPS))
        tracking = TrackingFilter(model, _widened(plain.noise, 2), scales, substeps)
        bounded = [p.name for p in EFFECTS[id].parameters(site) if np.isfinite(p.upper)]
        way = np.zeros((len(scales), len(scales)))
        way[:-2, :-2] = _way(plain, window.filtered, target)
        on_part = likelihood(baseline, window, plain.run(part, window.values, slopes=False))
        known = {part.n: on_part, whole.n: likelihood(baseline, window, window.filtered)}
        return cls(baseline, window, tracking, model.effects[-1].label, way, starts, bounded, part, known)

    def moved(self, start: Mapping[str, float], x: Array) -> dict[str, float]:
        """The start with each value multiplied, a share by its odds."""
        found = {}
        for (name, value), step in zip(start.items(), x.tolist(), strict=True):
            if name in self.shares:
                odds = value / (1.0 - value) * np.exp(step)
                found[name] = float(np.clip(odds / (1.0 + odds), 0.01, 0.99))
            else:
                found[name] = float(value * np.exp(step))
        return found

    def climbed(
        self, start: Mapping[str, float], rough: float, experiment: Experiment, evaluations: int
    ) -> tuple[dict[str, float], float, float]:
        """The values and the random load beside them with which the samples are likeliest, and by how much they are likelier."""

        def there(x: Array) -> tuple[dict[str, float], float]:
            return self.moved(start, x[:-1]), rough * float(np.exp(x[-1]))

        def cost(x: Array) -> float:
            return -self.gain(*there(x), experiment) if np.max(np.abs(x)) <= _FARTHEST else 1e12

        steps = np.diag([0.7] * len(start) + [1.0])
        x = nelder_mead(cost, np.vstack([np.zeros(len(steps)), steps]), evaluations)
        return *there(x), -cost(x)

    def run(self, shape: Mapping[str, float], rough: float, experiment: Experiment) -> Filtered:
        noise = FilterNoise(self.tracking.noise.output_variance, self.tracking.noise.process + self.way * rough**2)
        values = {f"{self.label}.{name}": value for name, value in shape.items()}
        return self.tracking.with_noise(noise).run(experiment, values, slopes=False)

    def gain(self, shape: Mapping[str, float], rough: float, experiment: Experiment) -> float:
        """Rise of the log-likelihood over the healthy machine's filter; −1e12 where this one does not follow."""
        value = likelihood(self.baseline, self.window, self.run(shape, rough, experiment)) - self.plain[experiment.n]
        return value if np.isfinite(value) else -1e12


def _named(model: PhysicalModel, shape: Mapping[str, float]) -> dict[str, float]:
    return {f"{model.effects[-1].label}.{name}": value for name, value in shape.items()}


def _widened(noise: FilterNoise, states: int) -> FilterNoise:
    process = np.zeros((len(noise.process) + states,) * 2)
    process[:-states, :-states] = noise.process
    return FilterNoise(noise.output_variance, process)
