"""Simulation of a model on an experiment, with exact sensitivities."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, overload

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadModel
from residuum.identification.physics.compile.kernel import Kernel, kernel_of
from residuum.identification.physics.files.expression import Expression, evaluate
from residuum.identification.physics.simulate import integration
from residuum.identification.physics.simulate.experiment import Experiment, means_in_blocks
from residuum.identification.work import count_samples

if TYPE_CHECKING:
    from residuum.identification.physics.model import PhysicalModel

# Which parameter values a machine can have at all: bounds across parameters, beside those that
# each has of its own.
# An end of the travel lies above the other one; what multiplies a derivative (a mass, an inertia,
# a heat capacity) keeps its sign.

Array = npt.NDArray[np.float64]


@dataclass(frozen=True)
class Possible:
    """Whether parameter vectors of one model, in its kernel's order, are those of a machine that
    can be.

    Parameters
    ----------
    pairs : tuple of (int, int)
        Positions of two parameters of which the first must lie below the second.
    storages : tuple of (expression, names with their positions, sign)
        What multiplies the derivative of each balance, as far as parameters alone say it, and the
        sign that it has in the model.
    """

    pairs: tuple[tuple[int, int], ...]
    storages: tuple[tuple[Expression, Mapping[str, int], float], ...]

    @classmethod
    def of(cls, model: PhysicalModel, index: Mapping[str, int]) -> Possible:
        """The bounds of a model whose parameters stand at these positions."""
        pairs = [
            (f"{use.label}.{low.name}", f"{use.label}.{low.below}")
            for use in model.effects
            for low in use.parameters.values()
            if low.below
        ]
        values = model.values
        storages = []
        for balance in model.balances.values():
            names = {
                name: index[name]
                for name in balance.storage.names
                if name in model.parameters and name in index
            }
            # der() counts as 1: what is left multiplies the derivative.
            now = evaluate(balance.storage.tree, values)
            # Where a state or an input is in the storage, parameters alone say nothing of its sign.
            if names and now and math.isfinite(now):
                storages.append((balance.storage, names, math.copysign(1.0, now)))
        return cls(tuple((index[low], index[high]) for low, high in pairs), tuple(storages))

    def __call__(self, p: Array) -> bool:
        """Whether the machine with these parameters, shape (parameters,), can be."""
        if any(not p[low] < p[high] for low, high in self.pairs):
            return False
        sizes = []
        for storage, names, sign in self.storages:
            values = {name: float(p[k]) for name, k in names.items()}
            sizes.append(evaluate(storage.tree, values) * sign)
        # Not `> 0`: a NaN (a root of a negative number) is left to the simulation.
        return all(not size <= 0.0 for size in sizes)


Integers = npt.NDArray[np.int64]

MOST_SUBSTEPS = 64
_OSCILLATING, _DECAYING = 0.25, 0.8
_EXACT, _LEAST = 0.02, 1e-4
"""Parts of a record's noise and of an output's spread, by whose sum finer steps may still change
the outputs.
"""
_DIVERGED = 1e60
_LOOKED_AT, _LOOKS, _ALL_LOOKS = 20_000, 15, 60
"""First samples of an experiment, and points along them, at which its eigenvalues are looked at."""
_CHECKED, _DOUBLINGS, _SETTLING = 5000, 3, 0.7
"""Samples on which that is tried, how often steps are halved for it, and the factor by which the
change has to fall each time: a chaotic model's does not.
"""


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


@dataclass(frozen=True, eq=False)
class Runs(Sequence[Simulation]):
    """Simulations of several experiments, one after the other in X, Y and dY; experiment k begins
    at row starts[k].

    Taken apart they are a `Simulation` each; what is done with all of them is done at one go, for
    windows are many and short.
    """

    experiments: Sequence[Experiment]
    X: Array
    Y: Array
    dY: Array | None
    columns: tuple[str, ...]
    starts: Integers

    def __len__(self) -> int:
        return len(self.experiments)

    @overload
    def __getitem__(self, at: int) -> Simulation: ...
    @overload
    def __getitem__(self, at: slice) -> list[Simulation]: ...
    def __getitem__(self, at: int | slice) -> Simulation | list[Simulation]:
        if isinstance(at, slice):
            return [self[k] for k in range(len(self))[at]]
        k = range(len(self))[at]
        rows = slice(self.starts[k], self.starts[k + 1])
        return Simulation(
            self.X[rows], self.Y[rows], None if self.dY is None else self.dY[rows], self.columns
        )

    @cached_property
    def bounded(self) -> bool:
        """Outputs and sensitivities are finite, and so far from overflow that sums of squares are
        finite too.
        """
        # 1e60 squared is 1e120: sums of squares stay finite.
        arrays = [values for values in (self.Y, self.dY) if values is not None and values.size]
        return all(
            bool(values.max() < _DIVERGED and values.min() > -_DIVERGED) for values in arrays
        )

    @cached_property
    def errors(self) -> Array:
        """What was measured less what was simulated, one experiment after the other."""
        measured = [e.Y for e in self.experiments]
        # One experiment needs no copy.
        return (measured[0] if len(measured) == 1 else np.concatenate(measured)) - self.Y

    @property
    def errors_of_each(self) -> list[Array]:
        """The same, an array an experiment."""
        return [self.errors[a:b] for a, b in pairwise(self.starts.tolist())]

    def in_blocks(self, values: Array) -> tuple[Array, Integers]:
        """Means of such rows over the blocks of each experiment, and where each begins and the last
        one ends.
        """
        return means_in_blocks(values, self.starts, [e.block for e in self.experiments])

    def means(self, values: Array) -> list[Array]:
        """The same, an array an experiment."""
        means, starts = self.in_blocks(values)
        return [means[a:b] for a, b in pairwise(starts.tolist())]


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
    >>> force, unmeasured = np.full((11, 1), 95.0), np.full((11, 2), np.nan)
    >>> push = Experiment(force, unmeasured, np.zeros(1), sample_time=0.1)
    >>> float(simulator.run(push, {"q": 0.0, "v": 0.0}).Y[-1, 1].round(9))   # 1 m/s² for 1 s
    1.0
    """

    def __init__(self, model: PhysicalModel) -> None:
        self.model = model
        self.kernel: Kernel = kernel_of(model)
        self._index = {name: k for k, name in enumerate(self.kernel.parameters)}
        self._state = {name: k for k, name in enumerate(self.kernel.states)}
        # Missing terms are no parameters of the model: zero until a filter estimates them.
        values = model.values
        self._p = np.array([values.get(name, 0.0) for name in self.kernel.parameters])
        self.possible = Possible.of(model, self._index)

    @property
    def states(self) -> tuple[str, ...]:
        """All states: the model's, then those of effects."""
        return self.kernel.states

    @property
    def free_states(self) -> tuple[str, ...]:
        """States whose first value is estimated: the model's that it does not fix, and the
        deviations of effects' own.
        """
        return (
            *(name for name in self.model.states if name not in self.model.initial),
            *self.kernel.deviating,
        )

    @property
    def remembers(self) -> bool:
        """Whether effects have states that go on in an experiment which follows another one in
        time.
        """
        return bool(self.kernel.system.remembered.size)

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
        """Initial state vector: these values, elsewhere what the model says, or zero."""
        x0 = np.zeros(len(self._state))
        for name, value in {**self.model.first_values, **(initial or {})}.items():
            x0[self._state[name]] = value
        return x0

    def measured_start(self, experiment: Experiment) -> Array:
        """First states: what is known, the first measured value of states that are themselves
        outputs; elsewhere where a state says to begin, or zero.
        """
        x0 = self.x0(experiment.known)
        for o, output in enumerate(self.model.outputs.values()):
            name = output.value.text
            readings = experiment.Y[np.isfinite(experiment.Y[:, o]), o]
            if name in self.free_states and name not in experiment.known and readings.size:
                x0[self._state[name]] = readings[0]
        return x0

    def columns(self, names: Sequence[str]) -> npt.NDArray[np.int64]:
        """Kernel columns of parameter names and `initial:state`; BadModel for an unknown one."""
        count = len(self._index)
        known = self._index | {f"initial:{name}": count + k for name, k in self._state.items()}
        if unknown := [name for name in names if name not in known]:
            raise BadModel(
                f"model {self.model.name!r}: nothing named {unknown[0]!r} to differentiate by"
            )
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

        A model that diverges gives NaN from there on (`Simulation.finite` is False), not an
        exception.
        """
        return self.run_vectors(
            experiment, self.x0(initial), self.p(values), slopes=slopes, substeps=substeps
        )

    def run_vectors(
        self,
        experiment: Experiment,
        x0: Array,
        p: Array,
        *,
        slopes: Sequence[str] = (),
        substeps: int | None = None,
    ) -> Simulation:
        """`run` with initial states and parameters as vectors in kernel order; nothing depends on
        what the experiment knows.
        """
        steps = substeps or self.substeps(experiment, x0, p)
        return self.run_each([experiment], [x0], p, slopes=slopes, substeps=[steps])[0]

    def run_each(
        self,
        experiments: Sequence[Experiment],
        initial: Sequence[Array],
        p: Array,
        *,
        slopes: Sequence[str] = (),
        substeps: Sequence[int],
    ) -> Runs:
        """`run_vectors` of several experiments, each from its own first states and with its own
        steps a sample, at one go.

        Parameters that no machine has (`Possible`) give NaN as a model that diverges does: no
        estimation goes there.
        """
        # none: no columns, for outputs alone.
        x0 = np.array(initial)
        steps = np.array(substeps)
        none = self.columns(())
        joined = self._joined(experiments, p)
        X, Y, dY = self._simulated(joined, x0, p, steps, self.columns(slopes))

        def outputs(at: Array) -> Array:
            return self._simulated(self._joined(experiments, at), x0, at, steps, none)[1]

        self._difference(dY, Y, slopes, p, outputs)
        if not self.possible(p):
            X, Y, dY = (np.full_like(values, np.nan) for values in (X, Y, dY))
        for k, e in enumerate(experiments):
            # What an experiment knows of its first states is not estimated there: its slope is
            # nothing.
            if e.known and slopes:
                of_known = [name.removeprefix("initial:") in e.known for name in slopes]
                dY[joined.starts[k] : joined.starts[k + 1], :, of_known] = 0.0
        return Runs(experiments, X, Y, dY if slopes else None, tuple(slopes), joined.starts)

    def _joined(self, experiments: Sequence[Experiment], p: Array) -> Joined:
        """The experiments end to end, what is foreign simulated along them first."""
        # What is foreign simulates itself first; its outputs are inputs here.
        if foreign := self.model.foreign:
            with foreign.lock:
                experiments = foreign.along(experiments, self._foreign_values(p))
        return Joined.of(experiments)

    def _difference(
        self,
        dY: Array,
        Y: Array,
        slopes: Sequence[str],
        p: Array,
        outputs: Callable[[Array], Array],
    ) -> None:
        """Write the slopes by parameters that no equation names: differences of whole
        simulations.
        """
        # A step for each such parameter was chosen when the model was made.
        steps = self.model.foreign.steps if self.model.foreign else {}
        for column, name in enumerate(slopes):
            if name not in steps:
                continue
            k = self._index[name]
            bounds = self.model.parameters[name]

            def run(value: float, k: int = k) -> Array:
                return outputs(np.where(np.arange(len(p)) == k, value, p))

            dY[:, :, column] = steps[name].slope(run, float(p[k]), Y, (bounds.lower, bounds.upper))

    def _simulated(
        self, joined: Joined, initial: Array, p: Array, substeps: Integers, columns: Integers
    ) -> tuple[Array, Array, Array]:
        q = self.kernel.system
        at = joined
        # Columns cost about as much as the states: counted so, work is alike on all machines.
        count_samples(int(np.diff(at.starts) @ substeps) * (1 + len(columns)))
        with self.settled(p) as settled:
            X, Y, dY = integration.simulate(
                q,
                at.U,
                at.starts,
                p,
                initial,
                at.sample_times,
                substeps,
                at.holds,
                at.follows,
                columns,
            )
        # A library that refuses these values: no machine has them.
        if not settled:
            X, Y, dY = (np.full_like(values, np.nan) for values in (X, Y, dY))
        return X, Y, dY

    @contextmanager
    def settled(self, p: Array) -> Iterator[bool]:
        """While what is foreign has these parameters, and nobody else uses it; whether it took
        them. Held by whoever evaluates the kernel.
        """
        if (foreign := self.model.foreign) is None:
            yield True
            return
        with foreign.lock:
            yield foreign.settle(self._foreign_values(p))

    def _foreign_values(self, p: Array) -> dict[str, float]:
        return {name: float(p[self._index[name]]) for name in self.model.parameters}

    def look(
        self, experiment: Experiment, X: Array, values: Mapping[str, float] | None = None
    ) -> dict[str, Array]:
        """Every signal (defined variables, `balance.term`, `storage:balance`, `drive:balance`)
        along the states X.
        """
        with self.settled(self.p(values)):
            Z = integration.evaluate_signals(*self._along(experiment, X, values))
        return {name: Z[:, k] for k, name in enumerate(self.kernel.signals)}

    def look_outputs(
        self, experiment: Experiment, X: Array, values: Mapping[str, float] | None = None
    ) -> Array:
        """Outputs along the states X, shape (n, outputs)."""
        with self.settled(self.p(values)):
            return np.asarray(integration.evaluate_outputs(*self._along(experiment, X, values)))

    def rate_slopes(self, experiment: Experiment, X: Array, samples: Integers) -> Array:
        """∂f/∂x along the states X at these samples, shape (samples, states, states)."""
        joined = Joined.of([experiment])
        p = self.p()
        system = self.kernel.system
        X = np.ascontiguousarray(X)
        times = (joined.sample_times, joined.holds)
        with self.settled(p):
            A = integration.rate_slopes(
                system, joined.U, joined.starts, X, p, *times, samples[None]
            )
        return np.asarray(A[0])

    def _along(
        self, experiment: Experiment, X: Array, values: Mapping[str, float] | None
    ) -> tuple[Any, ...]:
        """What evaluates along given states; whole arrays, since for strided ones it would be
        compiled once more.
        """
        U = np.ascontiguousarray(experiment.U)
        X = np.ascontiguousarray(X)
        return self.kernel.system, U, X, self.p(values), experiment.sample_time, experiment.hold

    def substeps(self, experiment: Experiment, x0: Array, p: Array) -> int:
        """`substeps_each` of one experiment."""
        return self.substeps_each([experiment], [x0], p)[0]

    def substeps_each(
        self,
        experiments: Sequence[Experiment],
        initial: Sequence[Array],
        p: Array,
        modal: Sequence[int] | None = None,
    ) -> list[int]:
        """Runge–Kutta steps a sample of each experiment, from the eigenvalues of ∂f/∂x along a
        first simulation.

        |λ|·h ≤ 0.25 for oscillating and 0.8 for decaying modes, at most 64; a run that diverges is
        tried finer, and so is one whose outputs would still change by a fiftieth of the record's
        noise: what the integrator errs would pass for physics. `modal` are those of
        `modal_substeps`, where they are known.
        """
        first = np.array(
            self.modal_substeps(experiments, initial, p) if modal is None else modal, dtype=np.int64
        )
        return self._exact_enough(experiments, np.array(initial), p, first).tolist()

    def modal_substeps(
        self, experiments: Sequence[Experiment], initial: Sequence[Array], p: Array
    ) -> list[int]:
        """Steps a sample that the fastest mode in each experiment asks for, if they need not be
        exact.
        """
        joined = Joined.of(experiments, _LOOKED_AT)
        X0 = np.array(initial)
        none = self.columns(())
        steps = np.ones(len(experiments), dtype=np.int64)
        for _ in range(4):
            X, *_ = self._simulated(joined, X0, p, steps, none)
            # Never fewer again: the coarser run may have left out what is stiff.
            needed = np.maximum(self._needed_along(joined, X, p), steps)
            if np.all((needed <= steps) | (steps >= MOST_SUBSTEPS)):
                break
            steps = needed
        return steps.tolist()

    def _exact_enough(
        self, experiments: Sequence[Experiment], X0: Array, p: Array, first: Integers
    ) -> Integers:
        """Steps doubled until the outputs no longer change visibly; the first where that does not
        settle.
        """
        steps = first.copy()
        open_ = np.arange(len(experiments))
        before = np.full(len(experiments), np.inf)
        parts = [e.window(0, min(e.n, _CHECKED)) for e in experiments]
        none = self.columns(())

        def outputs(indices: Integers, substeps: Integers) -> list[Array]:
            joined = Joined.of([parts[k] for k in indices])
            return joined.cut(self._simulated(joined, X0[indices], p, substeps, none)[1])

        runs = dict(zip(open_.tolist(), outputs(open_, steps), strict=True))
        tolerances = [
            _EXACT * _noise(e.Y, runs[k]) + _LEAST * _spread(e.Y) for k, e in enumerate(parts)
        ]
        # Steps are doubled for those experiments whose outputs still change visibly.
        for _ in range(_DOUBLINGS):
            open_ = open_[2 * steps[open_] <= MOST_SUBSTEPS]
            if not open_.size:
                break
            still = []
            for k, finer in zip(open_.tolist(), outputs(open_, 2 * steps[open_]), strict=True):
                visible = _visible(finer, runs[k], tolerances[k])
                if not visible > 1.0:
                    continue
                # The error of Runge and Kutta falls 16 times a doubling. Where the change hardly
                # falls it is none of the steps: a chaotic or switching model, which finer steps do
                # not mend.
                if visible > _SETTLING * before[k]:
                    steps[k] = first[k]
                    continue
                steps[k] = 2 * steps[k]
                runs[k] = finer
                before[k] = visible
                still.append(k)
            open_ = np.array(still, dtype=np.int64)
        return steps

    def _needed_along(self, joined: Joined, X: Array, p: Array) -> Integers:
        """Steps a sample of each of several experiments, at most 64."""
        return np.minimum(np.ceil(self._asked_along(joined, X, p)), MOST_SUBSTEPS).astype(np.int64)

    def _asked_along(self, joined: Joined, X: Array, p: Array) -> Array:
        """Steps a sample that the fastest mode of each experiment asks for, infinite where no
        sample is finite.

        Looked at are samples all along, those where a state is largest or smallest, and where such
        a sample's change leads on: there stops and valves are met, and too coarse steps jump off
        them before the next sample.
        """
        lengths = np.diff(joined.starts)
        # Without states there is nothing to integrate.
        if not X.shape[1]:
            return np.ones(len(lengths))
        along = np.linspace(0, lengths - 1, max(_LOOKS, _ALL_LOOKS // len(lengths)), axis=1).astype(
            np.int64
        )
        far = _extremes(X, joined.starts)
        at = joined.starts[:-1, None] + far
        before = joined.starts[:-1, None] + np.maximum(far - 1, 0)
        beyond = X.copy()
        with np.errstate(over="ignore", invalid="ignore"):  # of a run that diverges
            # Where the last change leads on to: a stop just behind the extreme is met there.
            beyond[at] += X[at] - X[before]
        looks = ((X, np.concatenate([along, far], axis=1)), (beyond, far))
        return np.max(
            [self._asked_at(joined, states, samples, p) for states, samples in looks], axis=0
        )

    def _asked_at(self, joined: Joined, X: Array, samples: Integers, p: Array) -> Array:
        """What the states X at these samples of each experiment ask for, shape (experiments,);
        infinite where none is finite.
        """
        finite = np.all(np.isfinite(X[joined.starts[:-1, None] + samples]), axis=2)
        with self.settled(p):
            A = integration.rate_slopes(
                self.kernel.system,
                joined.U,
                joined.starts,
                X,
                p,
                joined.sample_times,
                joined.holds,
                np.where(finite, samples, 0),
            )
        # A sample without finite slopes tells nothing; eigenvalues of it would raise.
        finite &= np.all(np.isfinite(A), axis=(2, 3))
        A[~finite] = 0.0
        steps = np.max(_steps_for(A) * joined.sample_times[:, None], axis=1, initial=1.0)
        # Nothing finite: the run diverged, and finer steps are tried.
        return np.where(np.any(finite, axis=1), steps, np.inf)


def _extremes(X: Array, starts: Integers) -> Integers:
    """In each experiment the samples where each state is largest and smallest, shape (experiments,
    2·states).
    """
    finite = np.isfinite(X)
    high = np.where(finite, X, -np.inf)
    low = np.where(finite, X, np.inf)
    parts = pairwise(starts.tolist())
    return np.array(
        [[*high[a:b].argmax(axis=0), *low[a:b].argmin(axis=0)] for a, b in parts], dtype=np.int64
    )


@dataclass(frozen=True, eq=False)
class Joined:
    """Experiments laid end to end, as the integrator takes them: inputs U, first rows and the last
    one's end. Of each also its sample time, its hold, and whether it follows the one before in
    time.
    """

    U: Array
    starts: Integers
    sample_times: Array
    holds: Array
    follows: Integers

    @classmethod
    def of(cls, experiments: Sequence[Experiment], most: int | None = None) -> Joined:
        """Of each experiment at most so many samples."""
        inputs = [e.U[:most] for e in experiments]
        return cls(
            np.concatenate(inputs) if len(inputs) > 1 else np.ascontiguousarray(inputs[0]),
            np.concatenate([[0], np.cumsum([len(u) for u in inputs])]).astype(np.int64),
            np.array([e.sample_time for e in experiments]),
            np.array([e.hold for e in experiments]),
            # The first follows none.
            np.array([0] + [b.follows(a) for a, b in pairwise(experiments)], dtype=np.int64),
        )

    def cut(self, values: Array) -> list[Array]:
        """The rows of each experiment."""
        return [values[a:b] for a, b in zip(self.starts[:-1], self.starts[1:], strict=True)]


def _visible(finer: Array, Y: Array, tolerance: Array) -> float:
    """RMS change of the outputs over what may be, at the output where it is most."""
    tolerated = tolerance > 0.0
    with np.errstate(over="ignore", invalid="ignore"):  # of a run that diverges
        change = np.sqrt(np.mean((finer - Y) ** 2, axis=0))
    return float(np.max(change[tolerated] / tolerance[tolerated], initial=0.0))


def _noise(measured: Array, simulated: Array) -> Array:
    """Size of each output's fast noise, from the steps of the error between samples; 0 where it was
    not measured.
    """
    # Neighbouring errors differ by the noise: what the model lacks moves slowly.
    steps = np.abs(np.diff(measured - simulated, axis=0))
    known = np.any(np.isfinite(steps), axis=0)
    return np.where(
        known, np.nanmedian(np.where(known, steps, 0.0), axis=0) / (0.6745 * np.sqrt(2.0)), 0.0
    )


def _spread(measured: Array) -> Array:
    """Standard deviation of each output; 0 where it was not measured."""
    # An output that was never measured has no deviation: NumPy would warn.
    known = np.any(np.isfinite(measured), axis=0)
    return np.where(known, np.nanstd(np.where(known, measured, 0.0), axis=0), 0.0)


def _steps_for(A: Array) -> Array:
    """Steps a second that the eigenvalues of each matrix (…, NX, NX) ask for, shape (…)."""
    eigenvalues = np.linalg.eigvals(A)
    # Nearly real eigenvalues count as decaying, for which larger steps are allowed.
    oscillating = np.abs(eigenvalues.imag) > 0.05 * np.abs(eigenvalues.real)
    return np.asarray(
        np.max(
            np.abs(eigenvalues) / np.where(oscillating, _OSCILLATING, _DECAYING),
            axis=-1,
            initial=0.0,
        )
    )
