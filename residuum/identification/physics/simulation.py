"""Simulation of a model on an experiment, with exact sensitivities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadModel
from residuum.identification.physics import integration
from residuum.identification.physics.experiment import Experiment
from residuum.identification.physics.kernel import Kernel, kernel_of
from residuum.identification.physics.model import PhysicalModel

Array = npt.NDArray[np.float64]

MOST_SUBSTEPS = 64
_OSCILLATING, _DECAYING = 0.25, 0.8
_EXACT, _LEAST = 0.02, 1e-4
"""Parts of a record's noise and of an output's spread, by whose sum finer steps may still change the outputs."""
_CHECKED, _DOUBLINGS, _SETTLING = 5000, 3, 0.7
"""Samples on which that is tried, how often steps are halved for it, and the factor by which the change has to fall each time: a
chaotic model's does not."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """What a simulation gives.

    Attributes
    ----------
    X : array, shape (n, states)
    Y : array, shape (n, outputs)
    dY : array, shape (n, outputs, columns) or None
        Sensitivities to what was asked for, in that order.
    columns : tuple of str
        Parameter names, and `initial:state` for initial values.
    """

    X: Array
    Y: Array
    dY: Array | None = None
    columns: tuple[str, ...] = ()

    @property
    def finite(self) -> bool:
        """False when the model diverged."""
        return bool(np.all(np.isfinite(self.Y)))


class Simulator:
    """A model's compiled kernel with parameter values by name.

    Parameters
    ----------
    model : PhysicalModel
        Gives structure and parameter values; values can be replaced in every call.

    Examples
    --------
    >>> import numpy as np
    >>> from residuum.identification.physics import Experiment, Simulator, load_model
    >>> simulator = Simulator(load_model("linear-axis"))
    >>> push = Experiment(np.full((11, 1), 95.0), np.full((11, 2), np.nan), np.zeros(1), sample_time=0.1)
    >>> float(simulator.run(push, {"q": 0.0, "v": 0.0}).Y[-1, 1].round(9))   # 1 m/s² for 1 s
    1.0
    """

    def __init__(self, model: PhysicalModel) -> None:
        self.model = model
        self.kernel: Kernel = kernel_of(model)
        self._index = {name: k for k, name in enumerate(self.kernel.parameters)}
        self._state = {name: k for k, name in enumerate(self.kernel.states)}
        values = model.values
        self._p = np.array([values.get(name, 0.0) for name in self.kernel.parameters])

    @property
    def states(self) -> tuple[str, ...]:
        """All states: the model's, then those of effects."""
        return self.kernel.states

    @property
    def free_states(self) -> tuple[str, ...]:
        """States whose first value is estimated: the model's that it does not fix, and the deviations of effects' own."""
        return (*(name for name in self.model.states if name not in self.model.initial), *self.kernel.deviating)

    @property
    def signals(self) -> tuple[str, ...]:
        """Names of what `look` returns: variables that balances define, and `balance.term`."""
        return self.kernel.signals

    def p(self, values: Mapping[str, float] | None = None) -> Array:
        """Parameter vector with these values replaced."""
        p = self._p.copy()
        for name, value in (values or {}).items():
            p[self._index[name]] = value
        return p

    def x0(self, initial: Mapping[str, float] | None = None) -> Array:
        """Initial state vector: the model's `initial`, then `initial`, zero elsewhere."""
        x0 = np.zeros(len(self._state))
        for name, value in {**self.model.initial, **(initial or {})}.items():
            x0[self._state[name]] = value
        return x0

    def columns(self, names: Sequence[str]) -> npt.NDArray[np.int64]:
        """Kernel columns of parameter names and `initial:state`; BadModel for an unknown one."""
        count = len(self._index)
        known = self._index | {f"initial:{name}": count + k for name, k in self._state.items()}
        if unknown := [name for name in names if name not in known]:
            raise BadModel(f"model {self.model.name!r}: nothing named {unknown[0]!r} to differentiate by")
        return np.array([known[name] for name in names], dtype=np.int64)

    def run(
        self,
        experiment: Experiment,
        initial: Mapping[str, float] | None = None,
        values: Mapping[str, float] | None = None,
        *,
        slopes: Sequence[str] = (),
        substeps: int | None = None,
    ) -> Simulation:
        """Simulate from these initial states; `slopes` names what to differentiate the outputs by.

        A model that diverges gives NaN from there on (`Simulation.finite` is False), not an exception.
        """
        return self.run_vectors(experiment, self.x0(initial), self.p(values), slopes=slopes, substeps=substeps)

    def run_vectors(
        self, experiment: Experiment, x0: Array, p: Array, *, slopes: Sequence[str] = (), substeps: int | None = None
    ) -> Simulation:
        """`run` with initial states and parameters as vectors in kernel order; nothing depends on what the experiment knows."""
        steps = substeps or self.substeps(experiment, x0, p)
        columns = self.columns(slopes)
        arguments = (experiment.U, p, x0, experiment.sample_time, steps, experiment.hold, columns)
        X, Y, dY = integration.simulate(self.kernel.system, *arguments)
        dY[:, :, [name.removeprefix("initial:") in experiment.known for name in slopes]] = 0.0
        return Simulation(X, Y, dY if slopes else None, tuple(slopes))

    def look(self, experiment: Experiment, X: Array, values: Mapping[str, float] | None = None) -> dict[str, Array]:
        """Every signal (defined variables, `balance.term`, `storage:balance`, `drive:balance`) along the states X."""
        Z = integration.evaluate_signals(
            self.kernel.system, experiment.U, X, self.p(values), experiment.sample_time, experiment.hold
        )
        return {name: Z[:, k] for k, name in enumerate(self.kernel.signals)}

    def look_outputs(self, experiment: Experiment, X: Array, values: Mapping[str, float] | None = None) -> Array:
        """Outputs along the states X, shape (n, outputs)."""
        arguments = (experiment.U, X, self.p(values), experiment.sample_time, experiment.hold)
        return np.asarray(integration.evaluate_outputs(self.kernel.system, *arguments))

    def substeps(self, experiment: Experiment, x0: Array, p: Array) -> int:
        """Runge–Kutta steps a sample, from the eigenvalues of ∂f/∂x along a first simulation.

        |λ|·h ≤ 0.25 for oscillating and 0.8 for decaying modes, at most 64; a run that diverges is tried finer, and so is one
        whose outputs would still change by a fiftieth of the record's noise: what the integrator errs would pass for physics.
        """
        steps = 1
        part = experiment.window(0, min(experiment.n, 20_000))
        for _ in range(4):
            X, *_ = integration.simulate(self.kernel.system, part.U, p, x0, part.sample_time, steps, part.hold, self.columns(()))
            needed = self.substeps_along(part, X, p)
            if needed <= steps or steps >= MOST_SUBSTEPS:
                break
            steps = needed
        return self._exact_enough(part.window(0, min(part.n, _CHECKED)), x0, p, steps)

    def _exact_enough(self, experiment: Experiment, x0: Array, p: Array, first: int) -> int:
        """Steps doubled until the outputs no longer change visibly; the first where that does not settle."""
        steps, before = first, np.inf
        Y = self.run_vectors(experiment, x0, p, substeps=steps).Y
        tolerance = _EXACT * _noise(experiment.Y, Y) + _LEAST * _spread(experiment.Y)
        seen = tolerance > 0.0
        for _ in range(_DOUBLINGS):
            if 2 * steps > MOST_SUBSTEPS:
                break
            finer = self.run_vectors(experiment, x0, p, substeps=2 * steps).Y
            with np.errstate(over="ignore", invalid="ignore"):  # of a run that diverges
                change = np.sqrt(np.mean((finer - Y) ** 2, axis=0))
            visible = float(np.max(change[seen] / tolerance[seen], initial=0.0))
            if not visible > 1.0:
                break
            if visible > _SETTLING * before:
                return first
            steps, Y, before = 2 * steps, finer, visible
        return steps

    def substeps_along(self, experiment: Experiment, X: Array, p: Array) -> int:
        """Runge–Kutta steps a sample that the eigenvalues of ∂f/∂x along the states X ask for."""
        samples = np.unique(np.linspace(0, X.shape[0] - 1, 60).astype(np.int64))
        samples = samples[np.all(np.isfinite(X[samples]), axis=1)]
        A = integration.rate_slopes(self.kernel.system, experiment.U, X, p, experiment.sample_time, experiment.hold, samples)
        return min(_needed(A[np.all(np.isfinite(A), axis=(1, 2))], experiment.sample_time), MOST_SUBSTEPS)


def _noise(measured: Array, simulated: Array) -> Array:
    """Size of each output's fast noise, from the steps of the error between samples; 0 where it was not measured."""
    steps = np.abs(np.diff(measured - simulated, axis=0))
    known = np.any(np.isfinite(steps), axis=0)
    return np.where(known, np.nanmedian(np.where(known, steps, 0.0), axis=0) / (0.6745 * np.sqrt(2.0)), 0.0)


def _spread(measured: Array) -> Array:
    """Standard deviation of each output; 0 where it was not measured."""
    known = np.any(np.isfinite(measured), axis=0)
    return np.where(known, np.nanstd(np.where(known, measured, 0.0), axis=0), 0.0)


def _needed(A: Array, sample_time: float) -> int:
    if A.size == 0:
        return MOST_SUBSTEPS
    eigenvalues = np.linalg.eigvals(A)
    oscillating = np.abs(eigenvalues.imag) > 0.05 * np.abs(eigenvalues.real)
    scaled = np.abs(eigenvalues) * sample_time / np.where(oscillating, _OSCILLATING, _DECAYING)
    return max(1, int(np.ceil(np.max(scaled))))
