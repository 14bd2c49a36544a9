"""Extended Kalman filter and smoother of a model whose balances each carry an unknown term.

The model is frozen; to every balance a term w is added that walks at random, dw = σ_w dB, and
estimated together with the states from the measured outputs. Plotted against speed, position,
current, temperature or time, the smoothed w is the picture of what the balance lacks. Feedback
through the measurements keeps the states on the record, so it works on plants that integrate and on
data from a closed loop, where a simulation drifts.

How fast w may move (σ_w) and how noisy the outputs are (r) are found by maximum likelihood of the
innovations.

Reference: G. J. Bierman, *Factorization Methods for Discrete Sequential Estimation*, 1977 (smoother
of Bryson and Frazier); B. D. O. Anderson, J. B. Moore, *Optimal Filtering*, 1979.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from residuum.identification.nelder_mead import nelder_mead
from residuum.identification.physics.simulate.experiment import Experiment
from residuum.identification.physics.simulate.kalman_recursions import kalman_filter, predict_ahead
from residuum.identification.physics.simulate.kalman_recursions import smooth as adjoint_smoother
from residuum.identification.physics.simulate.simulation import Simulator
from residuum.identification.work import count_samples

if TYPE_CHECKING:
    from residuum.identification.physics.model import PhysicalModel

Array = npt.NDArray[np.float64]

# Of all experiments together: the noise is a number an output and a balance, and each of some sixty
# evaluations is a whole filter run.
TUNING_SAMPLES = 4000


@dataclass(frozen=True, eq=False)
class Noise:
    """What the filter assumes.

    `output_variance`: r of each output [unit²], shape (outputs,); `walk`: σ_w² of each balance's
    unknown term [unit²/s], by balance name (0 freezes it at zero).
    """

    output_variance: Array
    walk: Mapping[str, float]

    def walking(self, share: float) -> Noise:
        """With so large a share of the walks' variances."""
        return Noise(self.output_variance, {b: share * w for b, w in self.walk.items()})


@dataclass(frozen=True, eq=False)
class MissingTerm:
    """A balance's unknown term along a record: smoothed value and standard deviation, shape (n,),
    in the balance's unit.
    """

    balance: str
    unit: str
    value: Array
    std: Array

    @property
    def rms(self) -> float:
        """Root mean square of the value."""
        return float(np.sqrt(np.mean(self.value**2)))


@dataclass(frozen=True, eq=False)
class Smoothed:
    """What filter and smoother give of one experiment.

    `X` (n, states) smoothed states; `missing` by balance; `innovations`, `variances` (n, outputs);
    `filtered` (n, states + walking terms) is the state after each sample; `log_likelihood` of the
    innovations.
    """

    X: Array
    missing: Mapping[str, MissingTerm]
    innovations: Array
    variances: Array
    filtered: Array
    log_likelihood: float


class Filter:
    """The extended Kalman filter of a model, with an unknown term in each balance of `walk`."""

    def __init__(self, model: PhysicalModel, noise: Noise) -> None:
        self.simulator = Simulator(model)
        self.model = model
        self.noise = noise
        # A term that does not walk stays zero: as a state it would only cost time.
        self.balances = [name for name in model.balances if noise.walk.get(name, 0.0) > 0]
        # The columns of S are first states and missing terms: together they are the slopes of what
        # is filtered.
        names = [f"initial:{name}" for name in self.simulator.states] + [
            model.balances[name].missing for name in self.balances
        ]
        self.columns = self.simulator.columns(names)

    def run(
        self,
        experiment: Experiment,
        x0: Array,
        *,
        substeps: int | None = None,
        smooth: bool = True,
        scales: Array | None = None,
    ) -> Smoothed:
        """Filter (and smooth) one experiment from first states x0; `scales` are its `state_scales`,
        where they are known.
        """
        p = self.simulator.p()
        steps = substeps or self.simulator.substeps(experiment, x0, p)
        count_samples(experiment.n * steps * (1 + len(self.columns)))
        # The unknown terms begin at zero, with the doubt of P0.
        z0 = np.concatenate([x0, np.zeros(len(self.balances))])
        P0, Q = self._covariances(
            experiment,
            state_scales(self.simulator, experiment, x0, steps) if scales is None else scales,
        )
        arguments: tuple[Any, ...] = (
            z0,
            P0,
            Q,
            self.noise.output_variance,
            self.columns,
            experiment.sample_time,
            steps,
            experiment.hold,
        )
        with self.simulator.settled(p):
            z, P, F, H, e, V, filtered = kalman_filter(
                self.simulator.kernel.system, experiment.U, experiment.Y, p, *arguments
            )
        Z, variance = (
            adjoint_smoother(z, P, F, H, e, V) if smooth else (filtered, np.zeros_like(filtered))
        )
        n_x = len(x0)
        missing = {
            b: MissingTerm(
                b, self.model.balances[b].unit, Z[:, n_x + j], np.sqrt(variance[:, n_x + j])
            )
            for j, b in enumerate(self.balances)
        }
        return Smoothed(Z[:, :n_x], missing, e, V, filtered, _log_likelihood(experiment, e, V))

    def predict(
        self, experiment: Experiment, smoothed: Smoothed, steps: int, *, substeps: int = 1
    ) -> Array:
        """Outputs predicted `steps` samples ahead from the filtered states, shape (n, outputs); NaN
        in the first `steps` rows.
        """
        system = self.simulator.kernel.system
        p = self.simulator.p()
        arguments = (self.columns, steps, experiment.sample_time, substeps, experiment.hold)
        with self.simulator.settled(p):
            Y = predict_ahead(system, experiment.U, smoothed.filtered, p, *arguments)
        return np.asarray(Y)

    def _covariances(self, experiment: Experiment, scale: Array) -> tuple[Array, Array]:
        """Initial covariance wide enough for any start, and process noise: the walks, and a trace
        on every state.

        The trace keeps a state that stands still (its sensitivities are then zero) open to
        correction.
        """
        walk = np.array([self.noise.walk[b] for b in self.balances])
        # A walk over ten records: no first value of the term is ruled out.
        P0 = np.diag(
            np.concatenate([scale**2, walk * 10.0 * experiment.sample_time * experiment.n])
        )
        # A trace only, which no reading feels: 1e-5 of a state's size each sample.
        Q = np.diag(np.concatenate([(1e-5 * scale) ** 2, walk * experiment.sample_time]))
        return P0, Q


def state_scales(simulator: Simulator, experiment: Experiment, x0: Array, substeps: int) -> Array:
    """Size of each state: its peak in a simulation, or the largest output where that diverges or
    rests at zero.
    """
    largest = float(np.nanmax(np.abs(experiment.Y)))
    run = simulator.run_vectors(experiment, x0, simulator.p(), substeps=substeps)
    peak = np.nanmax(np.abs(run.X), axis=0)
    # A peak of zero would close the state to correction.
    return np.where(np.isfinite(peak) & (peak > 0), peak, largest if largest > 0 else 1.0)


def noise_floor(Y: Array) -> Array:
    """Standard deviation of each output's measurement noise from its third differences, shape
    (outputs,).

    Third differences remove any smooth motion and multiply the variance of white noise by 20; the
    median makes it robust to steps. For noise whose neighbours correlate it is a lower bound.
    """
    differences = np.diff(Y, n=3, axis=0)
    with np.errstate(invalid="ignore"):
        deviation = np.array(
            [
                np.median(np.abs(d[np.isfinite(d)])) if np.isfinite(d).any() else np.nan
                for d in differences.T
            ]
        )
    # 0.6745: the median of |x| of a normal x of deviation 1. 20 = 1² + 3² + 3² + 1², the squared
    # weights of a third difference.
    return deviation / 0.6745 / np.sqrt(20.0)


def first_noise(model: PhysicalModel, experiments: Sequence[Experiment]) -> Noise:
    """A starting guess: output variances from `noise_floor` (at least 1e-4 of the signal), walks
    from the inputs' size.
    """
    Y = np.concatenate([e.Y for e in experiments])
    with np.errstate(invalid="ignore"):
        spread = np.array([np.nanstd(y) if np.isfinite(y).any() else 1.0 for y in Y.T])
    # A reading in coarse steps has third differences of zero: the least is a part of the signal.
    floor = noise_floor(Y)
    r = (
        np.maximum(
            np.where(np.isfinite(floor), floor, spread), 1e-4 * np.where(spread > 0, spread, 1.0)
        )
        ** 2
    )
    simulator = Simulator(model)
    e = experiments[0]
    run = simulator.run(e)
    X = run.X if run.finite else np.zeros_like(run.X)
    look = simulator.look(e, X)
    walk = {}
    for name, balance in model.balances.items():
        rms = max(
            (float(np.sqrt(np.mean(look[f"{name}.{term}"] ** 2))) for term in balance.terms),
            default=1.0,
        )
        # The term may walk a tenth of the largest known term over a fiftieth of the record.
        walk[name] = (0.1 * (rms if np.isfinite(rms) and rms > 0 else 1.0)) ** 2 / (
            0.02 * e.n * e.sample_time
        )
    return Noise(r, walk)


def tune(
    model: PhysicalModel,
    experiments: Sequence[Experiment],
    initial: Sequence[Array],
    evaluations: int = 60,
) -> Noise:
    """The noise that maximises the innovations' likelihood on at most `TUNING_SAMPLES` samples,
    from `first_noise`.
    """
    start = first_noise(model, experiments)
    # The beginnings of all experiments, each as long: the noise is taken to be the same along them.
    parts = [e.window(0, max(2, min(e.n, TUNING_SAMPLES // len(experiments)))) for e in experiments]
    simulator = Simulator(model)
    steps = simulator.substeps_each(parts, initial, simulator.p())
    balances = list(start.walk)
    known = list(zip(parts, initial, steps, strict=True))
    scales = [state_scales(simulator, *run) for run in known]

    def noise(exponents: Array) -> Noise:
        walk = {
            b: start.walk[b] * float(np.exp(v)) for b, v in zip(balances, exponents, strict=False)
        }
        return Noise(start.output_variance * np.exp(exponents[len(balances) :]), walk)

    def cost(exponents: Array) -> float:
        # e²⁵ = 7e10 times the first guess, up or down: nothing measured is there, and the simplex
        # may overflow.
        if np.max(np.abs(exponents)) > 25:
            return 1e12
        kalman = Filter(model, noise(exponents))
        # Smoothing adds nothing to the likelihood: it is left out.
        runs = zip(known, scales, strict=True)
        total = sum(
            kalman.run(e, x, substeps=n, smooth=False, scales=s).log_likelihood
            for (e, x, n), s in runs
        )
        return -total if np.isfinite(total) else 1e12

    size = len(balances) + len(start.output_variance)
    # Steps of 3 in the exponent: a factor of 20.
    simplex = np.vstack([np.zeros(size), 3.0 * np.eye(size)])
    return noise(nelder_mead(cost, simplex, evaluations))


def missing_terms(
    model: PhysicalModel,
    experiments: Sequence[Experiment],
    initial: Sequence[Array],
    noise: Noise | None = None,
) -> list[Smoothed]:
    """Filter and smooth every experiment with an unknown term in each balance; `noise` is tuned
    when not given.
    """
    kalman = Filter(model, noise or tune(model, experiments, initial))
    return [kalman.run(experiment, x0) for experiment, x0 in zip(experiments, initial, strict=True)]


def _log_likelihood(experiment: Experiment, e: Array, V: Array) -> float:
    used = np.isfinite(e)
    # A reading without an innovation, or with a variance that is none: the filter diverged before it.
    if int(used.sum()) < int(np.isfinite(experiment.Y).sum()) or not (V[used] > 0.0).all():
        return -np.inf
    return float(-0.5 * np.sum(e[used] ** 2 / V[used] + np.log(2.0 * np.pi * V[used])))
