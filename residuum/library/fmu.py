"""An FMU as a Model. Its library runs in this process, and may end it: commands give it a process
of its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from residuum.identification.errors import BadInput
from residuum.identification.physics import Estimate as Estimated
from residuum.identification.physics import Experiment, PhysicalModel, estimate, match
from residuum.identification.physics.effects.base import Parameter
from residuum.identification.physics.fmu.co_simulation import OwnSimulation
from residuum.identification.physics.fmu.description import Description
from residuum.identification.physics.fmu.instance import Instance, instance_of
from residuum.identification.physics.fmu.parameter_file import (
    Named,
    free_missing,
    named,
    parameter_of,
    settable,
    text,
)
from residuum.identification.physics.fmu.parameters import SimulatedParameters
from residuum.identification.physics.fmu.simulated_model import (
    inputs_of,
    simulated_model,
    with_simulation,
    without_rows,
)
from residuum.identification.physics.fmu.watched_model import exchanged_model, watched_model
from residuum.identification.record import Record as MeasuredRecord
from residuum.identification.residual_analysis.feedback import at_likelier_timing
from residuum.identification.unseen_blocks.foreign_values import answers, doubting, with_answers
from residuum.library.explanation import Explanation
from residuum.library.improvement import Estimation, Improvement
from residuum.library.model import Mapped, Model, Records
from residuum.library.progress import Progress
from residuum.library.questions import asks
from residuum.library.questions.estimate import Estimate
from residuum.library.questions.missing_effect import Explain, Improve
from residuum.library.reading import as_records
from residuum.library.record import Record
from residuum.library.whole_file import write_whole


def fmu(path: str | PathLike[str]) -> FmuModel:
    """An FMU (FMI 2.0 or 3.0) as a model, or a model file that names one (`fmu: drive.fmu`).

    Its library is loaded into this process: one that breaks down ends the process. The commands
    `compare`, `explain`, `improve`, `estimate`, `train` and `score` run it in a process of their
    own.

    Parameters
    ----------
    path : str or path

    Returns
    -------
    FmuModel
        With model exchange and without events every state has a balance that effects can act in.
        Any other FMU is simulated along each record, and what its outputs lack is judged on their
        paths.

    Raises
    ------
    BadModel
        It cannot run here; it is set up in vain; the extra `fmi` is missing.

    Examples
    --------
    >>> import residuum as rs
    >>> rs.fmu("drive.fmu")
    Traceback (most recent call last):
        ...
    residuum.identification.errors.BadModel: model 'drive.fmu': no such file
    """
    read = named(Path(path))
    plain = FmuModel(read.described, read.parameters, given=str(path))
    return plain._changed(read.with_effects(plain.physical))


class FmuModel(Model):
    """An FMU, the values that its parameters were given, and effects added to it. Immutable, as a
    `Model` is. `improve` leaves the FMU's own parameters as they are, but for those in `free`.

    Made by `rs.fmu`.

    Parameters
    ----------
    described : Description
    values : mapping of name to Parameter
        Parameters that are not at the start values of its description.
    effects : tuple of EffectUse
    given : str
        What it was read from, for answers.
    """

    def __init__(
        self,
        described: Description,
        values: Mapping[str, Parameter],
        effects: Sequence[Any] = (),
        given: str | None = None,
    ) -> None:
        self._described, self._values = described, dict(values)
        self._own: OwnSimulation | None = None
        # With states that can be read and set effects act in balances; any other FMU is simulated
        # along a record, and effects are judged on the paths of its outputs.
        if described.is_exchangeable:
            physical = exchanged_model(described, {}, held=self._set)
        else:
            self._own = _own_simulation(self._instance)
            physical = simulated_model(described)
        super().__init__(replace(physical, effects=tuple(effects)), given)

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Every parameter that may be set, and those of effects, by their full names."""
        own = {
            name: self._values.get(name) or parameter_of(offered, fixed=True)
            for name, offered in self._described.parameters.items()
        }
        return own | self.physical.all_parameters

    @property
    def text(self) -> str:
        """The text of a model file in this folder that names the FMU."""
        return text(self._described, self._values, self.physical, Path.cwd())

    def save(self, path: str | PathLike[str]) -> None:
        """Write a model file that names the FMU, which `rs.fmu` and the commands read."""
        folder = Path(path).resolve().parent
        write_whole(Path(path), text(self._described, self._values, self.physical, folder))

    def with_values(self, **values: float) -> Self:
        """The model with other values of the FMU's parameters or of effects'."""
        own = {n: v for n, v in values.items() if n not in self.physical.all_parameters}
        changed = {
            name: replace(
                self._values.get(name) or parameter_of(settable(self._described, name), fixed=True),
                value=float(value),
            )
            for name, value in own.items()
        }
        # What is no parameter of an effect is one of the FMU, or is refused as such.
        effects = {name: value for name, value in values.items() if name not in own}
        return self._copy(self._values | changed, self.physical.with_values(effects))

    @property
    def _instance(self) -> Instance:
        return instance_of(self._described)

    @property
    def _set(self) -> dict[str, float]:
        return {name: parameter.value for name, parameter in self._values.items()}

    def _copy(self, values: Mapping[str, Parameter], physical: PhysicalModel) -> Self:
        return type(self)(self._described, values, physical.effects, self._given)

    def _changed(self, physical: PhysicalModel) -> Self:
        return self._copy(self._values, physical)

    def _simulated(self, records: Sequence[MeasuredRecord], map: Mapped) -> list[MeasuredRecord]:
        """The records with what an FMU that simulates itself computes along them."""
        if self._own is None:
            return list(records)
        simulated = with_simulation(
            self._own, records, map or {}, self._set, self._likelier(records, map)
        )
        return [without_rows(record) for record in simulated]

    def _likelier(
        self, records: Sequence[MeasuredRecord], map: Mapped
    ) -> list[npt.NDArray[np.float64]] | None:
        """How the inputs of each record move between samples, as its outputs speak for it."""
        columns = [(map or {}).get(name, name) for name in self.outputs]
        # Where an output was not measured nothing speaks for a timing.
        if not self._described.inputs or not all(
            any(column in record.names for column in columns) for record in records
        ):
            return None
        # Nothing is estimated here: only the error at each timing is compared.
        model, lent = self._lent(dict(self._values), records, map)
        matched, experiments = match(model.physical, lent, map)

        def fitted(turned: list[Experiment]) -> Estimated:
            return estimate(matched, turned, free=())

        timed, _ = at_likelier_timing(experiments, fitted)
        return [e.hold[: len(self._described.inputs)] for e in timed]

    def _measured(self, records: Records, map: Mapped) -> list[MeasuredRecord]:
        return super()._measured(self._simulated(as_records(records), map), map)

    def simulate(
        self,
        record: MeasuredRecord,
        *,
        map: Mapped = None,
        initial: Mapping[str, float] | None = None,
    ) -> Record:
        """The outputs as the FMU computes them from the record's inputs."""
        (simulated,) = self._simulated([record], map)
        return super().simulate(simulated, map=map, initial=initial)

    @asks(Explain)
    def explain(
        self, records: Records, *, map: Mapped = None, progress: Progress = None, **given: Any
    ) -> Explanation:
        """Which physical effect is missing, or which of the FMU's own parameters has another value?
        That is told nearly; `estimate(free=[…])` tells it exactly.

        Parameters
        ----------
        records : Record, file, or a list of these
        map : mapping of model name to column
        progress : callable or bool
            As in `Model.explain`.

        Returns
        -------
        Explanation

        Raises
        ------
        BadRecord, BadUnit, BadModel, NotIdentifiable
            As in `Model.explain`.
        """
        lent, measured = self._doubting(records, map, ())
        why = lent.explain(measured, map=map, progress=progress, **given)
        # How outputs answer is no signal of the machine: the FMU is compared as it is.
        return replace(why, comparison=self.compare(records, map=map))

    @asks(Improve)
    def improve(
        self, records: Records, *, map: Mapped = None, progress: Progress = None, **given: Any
    ) -> Improvement[Any]:
        """Add effects, and count the error on data that were not used for it; the FMU's own
        parameters stay as they are, but for those in `free`.

        Parameters
        ----------
        records : Record, file, or a list of these
        map : mapping of model name to column
        progress : callable or bool
            As in `Model.explain`.

        Returns
        -------
        Improvement

        Raises
        ------
        BadInput
            A name in `free` that is no fixed or tunable parameter of the FMU.
        BadModel
            `free` of an FMU that can only simulate itself: `estimate` takes its parameters.
        BadRecord, BadUnit, NotIdentifiable
            As in `Model.improve`.
        """
        free = Improve.of(given).free or ()
        lent, measured = self._doubting(records, map, free)
        improvement = lent.improve(measured, map=map, progress=progress, **given)
        improved = self._changed(improvement.found.model)
        if free:
            # Nearly so far: the effects' values move with the FMU's own.
            names = [*free, *improved.physical.free]
            improved = improved.estimate(records, map=map, free=names, anyway=True).model
        return replace(improvement, model=improved)

    def _doubting(
        self, records: Records, map: Mapped, free: Sequence[str]
    ) -> tuple[Model, list[MeasuredRecord]]:
        """The model whose outputs answer those of the FMU's parameters that the errors resemble,
        and those in `free`, and the records with how they do; as they are, where the FMU can only
        simulate itself.
        """
        if self._own is not None:
            return Model(self.physical, self._given), self._measured(records, map)
        for name in free:
            settable(self._described, name)
        taken = as_records(records)
        offered = self._described.parameters.values()
        known = {p.name: self._values.get(p.name) or parameter_of(p) for p in offered}
        held = {n: replace(p, fixed=True) for n, p in known.items() if n in free or p.value != 0.0}
        model, lent = self._lent(held, taken, map)
        found = answers(*match(model.physical, model._measured(lent, map), map), free)
        # Only now: it sets the FMU's own values again.
        measured = self._measured(taken, map)
        return Model(doubting(self.physical, found), self._given), with_answers(
            measured, self.physical, found
        )

    @asks(Estimate)
    def estimate(self, records: Records, *, map: Mapped = None, **given: Any) -> Estimation[Any]:
        """Estimate parameters of the FMU, and of effects, by the error of simulation.

        Slopes are the FMU's directional derivatives where it gives them by a parameter, else
        differences of whole simulations, whose step `slopes` of the answer tells. A
        simulation begins by the FMU's reset, or by its state where it can bring one back.

        Parameters
        ----------
        records : Record, file, or a list of these
        map : mapping of model name to column

        Returns
        -------
        Estimation
            Its `model.save(file)` writes a model file that names the FMU with these values.

        Raises
        ------
        BadInput
            A name that is no fixed or tunable parameter; a method that needs equations.
        NotIdentifiable
            The FMU gives up on a record; its slopes are noise.
        """
        asked = Estimate.of(given)
        if asked.method == "kalman" or (asked.method == "prediction" and self._own is not None):
            raise BadInput(
                repr(asked.method),
                "method",
                "needs equations, or states that can be set, which this FMU does not show",
                way_on=[("method", "simulation")],
            )
        free = self._free(asked)
        parameters = self._estimated(free)
        taken = as_records(records)
        model, lent = self._lent(parameters, taken, map)
        measured = model._measured(lent, map)
        foreign: Any = model.physical.foreign
        # Before the search, at the start values.
        foreign.choose_steps(*_matched(model, measured, map, asked.hold))
        estimation = model.estimate(measured, map=map, **asked.model_dump() | {"free": free})
        fitted = estimation.found.model
        values = {n: replace(p, value=fitted.values[n]) for n, p in parameters.items()}
        return replace(
            estimation,
            fitted=self._copy(self._values | values, fitted),
            slopes=_slope_methods(parameters, free, foreign.steps),
        )

    def _free(self, asked: Estimate) -> tuple[str, ...]:
        """Full names of what is estimated."""
        effects = self.physical.all_parameters
        if asked.free is not None:
            for name in asked.free:
                if name not in effects:
                    settable(self._described, name)
            return tuple(dict.fromkeys(asked.free))
        names = [*(n for n, p in self._values.items() if not p.fixed), *self.physical.free]
        if not names:
            raise free_missing(self._described)
        return tuple(names)

    def _estimated(self, free: Sequence[str]) -> dict[str, Parameter]:
        """Parameters of the FMU that have a value of their own, or get one."""
        offered = self._described.parameters
        # A parameter that has a value of its own stays among them, fixed, where it is not
        # estimated.
        own = {n: parameter_of(offered[n]) for n in free if n in offered} | self._values
        return {n: replace(p, fixed=n not in free) for n, p in own.items()}

    def _lent(
        self, parameters: Mapping[str, Parameter], records: Sequence[MeasuredRecord], map: Mapped
    ) -> tuple[Model, list[MeasuredRecord]]:
        """The model in which the FMU's parameters can be moved, and the records as it takes
        them.
        """
        effects = self.physical.effects
        if self._own is None:
            exchanged = exchanged_model(self._described, parameters, effects)
            return Model(exchanged, self._given), list(records)
        lent = with_simulation(self._own, records, map or {}, self._set)
        signals = [(inputs_of(self._described, r, map or {}), r.sample_time) for r in records]
        foreign = SimulatedParameters(self._own, signals)
        physical = simulated_model(self._described, parameters)
        return Model(replace(physical, effects=effects, foreign=foreign), self._given), lent

    @property
    def watched(self) -> PhysicalModel:
        """With the parameters that are followed from window to window: those that are not fixed."""
        plain = watched_model(Named(self._described, self._values))
        return replace(plain, effects=self.physical.effects)


def _matched(
    model: Model, records: Sequence[MeasuredRecord], map: Mapped, hold: str
) -> tuple[PhysicalModel, Sequence[Any]]:
    return match(model.physical, records, map, hold)


def _slope_methods(
    parameters: Mapping[str, Parameter], free: Sequence[str], steps: Mapping[str, Any]
) -> dict[str, dict[str, Any]]:
    """By what the slopes of each parameter were had."""
    methods = {}
    for name in free:
        if name in steps:
            step = steps[name].of(parameters[name].value)
            how = "differences of simulations", step, steps[name].error
        elif name in parameters:
            how = "directional derivatives", None, None
        else:
            continue
        methods[name] = dict(
            zip(("by", "step", "error"), how, strict=True), unit=parameters[name].unit
        )
    return methods


@lru_cache(maxsize=8)
def _own_simulation(instance: Instance) -> OwnSimulation:
    return OwnSimulation(instance)
