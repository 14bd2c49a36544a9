"""An FMU's parameters in a simulation: what `Foreign` asks for, of both ways of running it."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import NotIdentifiable
from residuum.identification.physics.estimation.estimation import estimate
from residuum.identification.physics.fmu.co_simulation import OwnSimulation
from residuum.identification.physics.fmu.description import Description
from residuum.identification.physics.fmu.loaded_library import LoadedLibrary
from residuum.identification.physics.model import PhysicalModel
from residuum.identification.physics.simulate.differences import Step, chosen_step
from residuum.identification.physics.simulate.experiment import Experiment
from residuum.identification.physics.simulate.simulation import Simulator

_KEPT = 16
"""Simulations of whole records that are remembered: parts of one record ask for the same, and fits
side by side each for theirs.
"""


class ExchangedParameters:
    """Parameters of an FMU whose rates the model's equations call: the FMU takes those of these
    `names` from the model, and those that are `held` at values; all others keep its own.

    A model may have more: a value that a search doubts moves the outputs beside the FMU, which
    keeps the one that it has.
    """

    def __init__(
        self,
        library: LoadedLibrary,
        names: Collection[str],
        held: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        self.library = library
        self.names = names
        self.held = held
        self.lock = library.instance.lock
        self.steps: Mapping[str, Step] = {}

    @property
    def description(self) -> Description:
        """The FMU's own."""
        return self.library.description

    @property
    def file(self) -> Path:
        """The FMU as it was loaded."""
        return self.library.instance.file

    def choose_steps(self, model: PhysicalModel, experiments: Sequence[Experiment]) -> None:
        """Try, along experiments, with which steps slopes are differences: of the free parameters
        by which the FMU gives no derivatives.
        """
        own = [name for name, parameter in model.parameters.items() if not parameter.fixed]
        names = [name for name in own if name not in self.library.parameters]
        self.steps = with_steps(model, experiments, names)

    def settle(self, values: Mapping[str, float]) -> bool:
        """Begin the FMU anew where its parameters change."""
        taken = {name: value for name, value in values.items() if name in self.names}
        return self.library.settle({**self.held, **taken})

    def along(
        self, experiments: Sequence[Experiment], values: Mapping[str, float]
    ) -> Sequence[Experiment]:
        """As they are."""
        return experiments


class SimulatedParameters:
    """Parameters of an FMU that simulates itself along whole records, by their inputs U and sample
    times; experiments are parts of them, their rows told by `SAMPLE`.
    """

    def __init__(self, own: OwnSimulation, records: Sequence[tuple[FloatArray, float]]) -> None:
        self.own = own
        self.records = list(records)
        self.lock = own.instance.lock
        self.steps: Mapping[str, Step] = {}
        # Where each record begins among the rows of all.
        self._first = np.concatenate([[0], np.cumsum([len(U) for U, _ in records])])
        described = own.instance.description
        # the order of inputs in `simulated_model`
        nu = len(described.inputs)
        ny = len(described.outputs)
        self._own = slice(0, nu)
        self._made = slice(nu, nu + ny)
        self._sample = nu + ny
        self._runs: dict[tuple[object, ...], FloatArray] = {}

    @property
    def description(self) -> Description:
        """The FMU's own."""
        return self.own.instance.description

    @property
    def file(self) -> Path:
        """The FMU as it was loaded."""
        return self.own.instance.file

    def choose_steps(self, model: PhysicalModel, experiments: Sequence[Experiment]) -> None:
        """Try, along experiments, with which steps slopes are differences: of all that are free."""
        names = [name for name, parameter in model.parameters.items() if not parameter.fixed]
        self.steps = with_steps(model, experiments, names)

    def settle(self, values: Mapping[str, float]) -> bool:
        """Nothing: it was simulated before."""
        return True

    def along(
        self, experiments: Sequence[Experiment], values: Mapping[str, float]
    ) -> Sequence[Experiment]:
        """The experiments with its outputs by these values."""
        return [self._with_outputs(e, values) for e in experiments]

    def _with_outputs(self, experiment: Experiment, values: Mapping[str, float]) -> Experiment:
        rows = experiment.U[:, self._sample]
        record = int(np.searchsorted(self._first, rows[0], side="right")) - 1
        Y = self._run(record, experiment.hold[self._own], values)
        U = experiment.U.copy()
        at = rows - self._first[record]
        # A window of whole samples is cut out; one at another rate lies between them.
        begin = int(at[0])
        whole = at[-1] - at[0] == len(at) - 1
        U[:, self._made] = (
            Y[begin : begin + len(at)]
            if whole
            else np.stack([np.interp(at, np.arange(len(Y)), y) for y in Y.T], axis=1)
        )
        return replace(experiment, U=U)

    def _run(self, record: int, hold: FloatArray, values: Mapping[str, float]) -> FloatArray:
        key = (record, hold.tobytes(), *values.values())
        if key not in self._runs:
            U, dt = self.records[record]
            # The oldest goes first: a fit asks for the newest values only.
            while len(self._runs) >= _KEPT:
                self._runs.pop(next(iter(self._runs)))
            self._runs[key] = self.own.along(U, hold, dt, values)
        return self._runs[key]


def with_steps(
    model: PhysicalModel, experiments: Sequence[Experiment], names: Sequence[str]
) -> Mapping[str, Step]:
    """The steps of differences for the parameters of these names, tried along experiments."""
    if not names:
        return {}
    simulator = Simulator(model)
    # First states fitted, nothing else: slopes are asked for where the estimation begins.
    begun = estimate(model, experiments, free=())
    starts = begun.initial
    substeps = begun.substeps
    p = simulator.p()

    def step(name: str) -> Step:
        parameter = model.parameters[name]
        k = int(simulator.columns([name])[0])

        def run(value: float) -> FloatArray:
            at = np.where(np.arange(len(p)) == k, value, p)
            return simulator.run_each(experiments, starts, at, substeps=substeps).Y

        size = abs(parameter.value) or _of_bounds(parameter.lower, parameter.upper)
        chosen = chosen_step(run, parameter.value, size, (parameter.lower, parameter.upper))
        if not chosen.error < 1.0:
            raise NotIdentifiable(
                f"parameter {name!r}: its slope is another one at every step that was tried; the"
                " FMU's solver is too rough, or it does not begin anew after its reset: export it"
                " with a smaller tolerance, or with canGetAndSetFMUstate"
            )
        return chosen

    return {name: step(name) for name in names}


def _of_bounds(lower: float, upper: float) -> float:
    """Usual size of a parameter that starts at 0: that of its range, else 1."""
    span = upper - lower
    return span if np.isfinite(span) else 1.0
