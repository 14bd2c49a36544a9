"""Model: a machine's balances, held against records."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import partial
from html import escape
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np

from residuum.identification.errors import MAY_DIVERGE, NotIdentifiable
from residuum.identification.physics import (
    Key,
    PhysicalModel,
    Simulator,
    candidates,
    estimate,
    load_model,
    match,
    measured_parts,
    read_model,
    write_model,
)
from residuum.identification.physics.effects.base import Parameter
from residuum.identification.physics.simulate.record_checks import begins_elsewhere, leaves_tables
from residuum.identification.record import Record as MeasuredRecord
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.residual_analysis.odd_readings import records_without_odd
from residuum.library.comparison import Comparison
from residuum.library.progress import Progress, progress_shown
from residuum.library.questions import asks
from residuum.library.questions.compare import Compare
from residuum.library.questions.estimate import Estimate
from residuum.library.questions.missing_effect import Explain, Improve
from residuum.library.reading import as_records
from residuum.library.record import Record
from residuum.library.result import html_table
from residuum.library.whole_file import write_whole

# What a model is: names, units, parameters, effects, its file; and copies of it that differ.


class DescribedModel:
    """A machine as a set of balances; `physical` is the model as the identification room knows
    it.
    """

    def __init__(self, physical: PhysicalModel, given: str | None = None) -> None:
        self.physical = physical
        # Answers name the model as the user did: one read from a file by the file's path.
        self._given = physical.name if given is None else given

    @property
    def name(self) -> str:
        """Its name."""
        return self.physical.name

    @property
    def inputs(self) -> dict[str, str]:
        """Name → unit of each input."""
        return {name: signal.unit for name, signal in self.physical.inputs.items()}

    @property
    def outputs(self) -> dict[str, str]:
        """Name → unit of each output."""
        return {name: signal.unit for name, signal in self.physical.outputs.items()}

    @property
    def parameters(self) -> dict[str, Parameter]:
        """Every parameter (value, unit, bounds, `fixed`, meaning) by its full name; an effect's is
        `effect@place.name`.
        """
        return self.physical.all_parameters

    @property
    def effects(self) -> tuple[str, ...]:
        """The effects in it, as `effect@place`."""
        return tuple(use.label for use in self.physical.effects)

    @property
    def fitting_effects(self) -> list[Key]:
        """What of the catalogue fits it: each `effect` with its `target`."""
        return candidates(self.physical)

    @property
    def text(self) -> str:
        """The model file's YAML text."""
        return write_model(self.physical)

    def save(self, path: str | PathLike[str]) -> None:
        """Write the model file: whole, or not at all when interrupted.

        Parameters
        ----------
        path : str or path

        Raises
        ------
        BadInput
            The folder does not exist.

        Examples
        --------
        >>> import residuum as rs
        >>> import pathlib, tempfile
        >>> file = pathlib.Path(tempfile.mkdtemp()) / "axis.yaml"
        >>> rs.model("linear-axis").save(file)
        >>> rs.model(file).name
        'linear-axis'
        """
        write_whole(Path(path), self.text)

    def with_values(self, **values: float) -> Self:
        """The model with other parameter values; an effect's full names go as
        `**{"effect@place.name": value}`.

        Parameters
        ----------
        values : float
            By parameter name, in the parameter's unit.

        Returns
        -------
        Model

        Raises
        ------
        BadModel
            An unknown name, or a value out of its bounds.

        Examples
        --------
        >>> import residuum as rs
        >>> rs.model("linear-axis").with_values(M=90.0).parameters["M"].value
        90.0
        """
        return self._changed(self.physical.with_values(values))

    def with_effect(self, effect: str, place: str, **values: float) -> Self:
        """The model with one more effect at a balance, input or output.

        Parameters
        ----------
        effect : str
            Its id in the catalogue.
        place : str
            Name of the balance, input or output.
        values : float
            By the effect's own parameter names.

        Returns
        -------
        Model

        Raises
        ------
        BadModel
            An effect that is not in the catalogue or does not fit there; a value out of its bounds.

        Examples
        --------
        >>> import residuum as rs
        >>> axis = rs.model("linear-axis").with_effect("coulomb-friction", "axis", tau_c=20.0)
        >>> axis.effects
        ('coulomb-friction@axis',)
        """
        return self._changed(self.physical.with_effect(effect, place, values))

    def without_effect(self, label: str) -> Self:
        """The model without one of its effects.

        Parameters
        ----------
        label : str
            `effect@place`, or `effect` where it occurs once.

        Returns
        -------
        Model

        Raises
        ------
        BadModel
            No such effect in the model.

        Examples
        --------
        >>> import residuum as rs
        >>> axis = rs.model("linear-axis").with_effect("coulomb-friction", "axis", tau_c=20.0)
        >>> axis.without_effect("coulomb-friction").effects
        ()
        """
        return self._changed(self.physical.without_effect(label))

    def _changed(self, physical: PhysicalModel) -> Self:
        return type(self)(physical)

    def __str__(self) -> str:
        return self.text

    def __repr__(self) -> str:
        with_ = f", with {', '.join(self.effects)}" if self.effects else ""
        return (
            f"<residuum Model {self.name!r}: {', '.join(self.inputs) or 'no input'} →"
            f" {', '.join(self.outputs)}{with_}>"
        )

    def _repr_html_(self) -> str:
        rows = [
            {
                "parameter": name,
                "value": p.value,
                "unit": p.unit,
                "fixed": p.fixed,
                "meaning": p.meaning,
            }
            for name, p in self.parameters.items()
        ]
        return f"<div><strong>{escape(self.name)}</strong>{html_table(rows)}</div>"


if TYPE_CHECKING:
    from residuum.library.explanation import Explanation
    from residuum.library.improvement import Estimation, Improvement

# What comparing does not need (the search, the estimation) is imported by the methods that need it:
# it costs most of a second.

Records = MeasuredRecord | str | PathLike[str] | Sequence[MeasuredRecord | str | PathLike[str]]
"""One record, a record file, or several: each is an experiment with initial states of its own."""
Mapped = Mapping[str, str] | None
"""Model name → column, for columns that are not named as the model's inputs and outputs are."""


def model(source: str | PathLike[str]) -> Model:
    """A model: a built-in one, a YAML file, or its text.

    Parameters
    ----------
    source : str or path
        `gate-drive`, `oven`, `linear-axis`, `oscillator`, `two-tanks`, `process`; a file; or a text
        of several lines.

    Returns
    -------
    Model

    Raises
    ------
    BadModel
        Neither of these, or anything wrong in the text (with line and column).

    Examples
    --------
    >>> import residuum as rs
    >>> rs.model("gate-drive").outputs
    {'speed': 'rad/s', 'current': 'A'}
    """
    # A name or a path has one line.
    if isinstance(source, str) and "\n" in source:
        return Model(read_model(source))
    return Model(load_model(Path(source) if isinstance(source, PathLike) else source), str(source))


class Model(DescribedModel):
    """A machine as a set of balances, each `storage = sum of terms`. Immutable: what changes it
    returns another one.

    Made by `rs.model`. `physical` is the model as the identification room knows it.

    Parameters
    ----------
    physical : PhysicalModel
        As `rs.model` reads it.
    given : str
        What it was read from, for answers.

    Examples
    --------
    >>> import residuum as rs
    >>> axis = rs.model("linear-axis")
    >>> axis.name, axis.inputs, list(axis.parameters)
    ('linear-axis', {'force': 'N'}, ['M'])
    >>> axis.with_effect("coulomb-friction", "axis", tau_c=20.0).effects
    ('coulomb-friction@axis',)
    """

    @property
    def watched(self) -> PhysicalModel:
        """The model that a machine is watched by."""
        return self.physical

    def _measured(self, records: Records, map: Mapped) -> list[MeasuredRecord]:
        """The records, cut where an input was not measured."""
        return measured_parts(self.physical, as_records(records), map)

    def _sensed(
        self, given: Sequence[MeasuredRecord], map: Mapped
    ) -> tuple[list[MeasuredRecord], tuple[str, ...]]:
        """The records without what no sensor measured, as `compare` leaves it out, and what that
        was.
        """
        # All four questions leave out the same: error codes that one of them kept, twelve rows of
        # 600, became a floor of 18 °C, and its answer contradicted the others'.
        return records_without_odd(self.physical, given, map)

    @asks(Compare)
    def compare(self, records: Records, *, map: Mapped = None, **given: Any) -> Comparison:
        """How large is the error on the records, is it structured, and where does it lie?
        Parameters stay as they are.

        Parameters
        ----------
        records : Record, file, or a list of these
            Channels in any unit that can be converted to the model's.
        map : mapping of model name to column

        Returns
        -------
        Comparison

        Raises
        ------
        BadRecord, BadUnit
            Channels that do not fit the model.
        NotIdentifiable
            The model diverges on a record.

        Examples
        --------
        >>> import residuum as rs
        >>> hidden = {"coulomb-friction": "large"}
        >>> record = rs.simulate("gate-drive", effects=hidden, duration=10.0, seed=1)
        >>> rs.model("gate-drive").compare(record).structured
        True
        """
        return self._compared(self._measured(records, map), map, Compare.of(given))

    def _compared(self, given: Sequence[MeasuredRecord], map: Mapped, asked: Compare) -> Comparison:
        return Comparison(
            self._given, _names(given), compare(self.physical, given, map, **asked.model_dump())
        )

    @asks(Explain)
    def explain(
        self, records: Records, *, map: Mapped = None, progress: Progress = None, **given: Any
    ) -> Explanation:
        """Which physical effect is missing?

        Parameters
        ----------
        records : Record, file, or a list of these
        map : mapping of model name to column
        progress : callable or bool
            Called with the share done (0 … 1) and what is being done; True or False shows or hides
            a line of progress.

        Returns
        -------
        Explanation

        Raises
        ------
        BadRecord, BadUnit, BadModel
            Channels that do not fit the model; an effect that is not in the catalogue.
        NotIdentifiable
            The model diverges on a record.

        Examples
        --------
        >>> import residuum as rs
        >>> hidden = {"coulomb-friction": "large"}
        >>> record = rs.simulate("gate-drive", effects=hidden, duration=6.0, seed=1)
        >>> drive = rs.model("gate-drive")
        >>> drive.explain(record, effects=["coulomb-friction"]).best.effect
        'coulomb-friction'
        """
        from residuum.identification.discrepancy.compile_ahead import (  # noqa: PLC0415
            ensure_compiled,
        )
        from residuum.identification.discrepancy.explain import explain  # noqa: PLC0415
        from residuum.identification.work import part_of  # noqa: PLC0415
        from residuum.library.explanation import Explanation  # noqa: PLC0415

        asked = Explain.of(given)
        # Before anything looks into the catalogue: the user's own effects are candidates, too.
        asked.use_own()
        measured = self._measured(records, map)
        with progress_shown(progress) as tell:
            # Compiled first, and told: a first explanation after an installation waits for it.
            ensure_compiled(tell)
            searching = partial(
                explain,
                self.physical,
                self._sensed(measured, map)[0],
                map,
                tell=part_of(tell, 0.0, 0.9),
            )
            explanation = asked.handed_to(searching)
            tell(0.9, "comparing")
            # With odd readings still in: `compare` leaves them out by itself, and its answer names
            # them.
            compared = self._compared(measured, map, Compare())
        return Explanation(compared, explanation)

    @asks(Improve)
    def improve(
        self, records: Records, *, map: Mapped = None, progress: Progress = None, **given: Any
    ) -> Improvement[Model]:
        """Add effects, estimate again, and count the error on data that were not used for it.

        Parameters
        ----------
        records : Record, file, or a list of these
        map : mapping of model name to column
        progress : callable or bool
            As in `explain`.

        Returns
        -------
        Improvement

        Raises
        ------
        BadModel
            An effect that is not in the catalogue, does not fit the model, or fits several places
            and names none.
        BadRecord, BadUnit, NotIdentifiable
            As in `explain`.

        Examples
        --------
        >>> import residuum as rs
        >>> hidden = {"coulomb-friction": "large"}
        >>> record = rs.simulate("gate-drive", effects=hidden, duration=6.0, seed=1)
        >>> drive = rs.model("gate-drive")
        >>> drive.improve(record, add="coulomb-friction").model.effects
        ('coulomb-friction@shaft',)
        """
        from residuum.identification.discrepancy.compile_ahead import (  # noqa: PLC0415
            ensure_compiled,
        )
        from residuum.identification.discrepancy.improve import improve  # noqa: PLC0415
        from residuum.library.improvement import Improvement  # noqa: PLC0415

        asked = Improve.of(given)
        # Before anything looks into the catalogue: the user's own effects are candidates, too.
        asked.use_own()
        measured, left_out = self._sensed(self._measured(records, map), map)
        with progress_shown(progress) as tell:
            # Compiled first, and told: a first explanation after an installation waits for it.
            ensure_compiled(tell)
            improved = asked.handed_to(partial(improve, self.physical, measured, map, tell=tell))
        # The model as it was given: warnings are of its first values and tables, not of the
        # improved one.
        matched = match(self.physical, measured, map)
        return Improvement(
            self._changed(improved.model),
            improved,
            (*begins_elsewhere(*matched), *leaves_tables(*matched), *left_out),
        )

    @asks(Estimate)
    def estimate(self, records: Records, *, map: Mapped = None, **given: Any) -> Estimation[Model]:
        """Estimate the free parameters, the structure as it is; a record's note `split: 0.7` keeps
        its rest for validation.

        Parameters
        ----------
        records : Record, file, or a list of these
        map : mapping of model name to column

        Returns
        -------
        Estimation
            Its `model` refuses and says why where the search has not come to rest, but `anyway`.

        Raises
        ------
        BadInput
            An unknown method or parameter; channels that do not fit the model.
        NotIdentifiable
            The model diverges on a record.

        Examples
        --------
        >>> import residuum as rs
        >>> hidden = {"coulomb-friction": "large"}
        >>> record = rs.simulate("gate-drive", effects=hidden, duration=6.0, seed=1)
        >>> drive = rs.model("gate-drive")
        >>> fitted = drive.estimate(record).model
        >>> fitted.parameters["R"].value != drive.parameters["R"].value
        True
        """
        from residuum.library.estimation import estimated  # noqa: PLC0415
        from residuum.library.improvement import Estimation  # noqa: PLC0415

        asked = Estimate.of(given)
        measured, left_out = self._sensed(self._measured(records, map), map)
        estimation = estimated(self.physical, measured, map, asked)
        result, fitted = estimation.estimate, Model(estimation.estimate.model)
        answer = (
            self._given,
            _names(measured),
            asked.method,
            estimation.held_out_rmse,
            result,
            estimation.experiments,
        )
        return Estimation(fitted, *answer, estimation.unsettled, asked.anyway, left_out)

    def simulate(
        self,
        record: MeasuredRecord,
        *,
        map: Mapped = None,
        initial: Mapping[str, float] | None = None,
    ) -> Record:
        """The outputs as the model computes them from the record's inputs.

        Parameters
        ----------
        record : Record
            Its inputs drive the model.
        map : mapping of model name to column
        initial : mapping of state to value
            In the states' units; what is not named begins at zero. None: estimated from the
            record's outputs where it has them.

        Returns
        -------
        Record
            The outputs, in the model's units.

        Raises
        ------
        BadRecord, BadUnit
            Inputs that do not fit the model.
        NotIdentifiable
            The model diverges.

        Examples
        --------
        >>> import numpy as np, residuum as rs
        >>> force = np.full(11, 95.0)
        >>> push = rs.from_arrays({"force": force}, units={"force": "N"}, sample_time=0.1)
        >>> axis = rs.model("linear-axis").with_values(M=95.0)
        >>> float(axis.simulate(push)["velocity"][-1].round(9))   # 1 m/s² for 1 s
        1.0
        """
        columns = map or {}
        lacking = {
            columns.get(name, name): unit
            for name, unit in self.outputs.items()
            if columns.get(name, name) not in record.names
        }
        # Matching asks for a column of each output, which a record of inputs alone has not.
        blank = np.zeros(record.n)
        filled = MeasuredRecord(
            {**record.channels, **dict.fromkeys(lacking, blank)},
            {**record.units, **lacking},
            record.sample_time,
            record.t0,
            source=record.source,
        )
        matched, (experiment,) = match(self.physical, [filled], map)
        # First states are estimated from the outputs that were measured: from the record as it is,
        # for the zeros above would be taken for measurements.
        if initial is None and len(lacking) < len(self.outputs):
            matched, experiments = match(self.physical, [record], map)
            Y = estimate(matched, experiments, free=()).predicted[0]
        else:
            Y = Simulator(matched).run(experiment, initial).Y
        if not np.isfinite(Y).all():
            raise NotIdentifiable(
                f"model {self.name!r}: diverges on record {record.source!r}; {MAY_DIVERGE}"
            )
        channels = {name: Y[:, k] for k, name in enumerate(self.outputs)}
        return Record(
            channels,
            self.outputs,
            record.sample_time,
            record.t0,
            source=f"{self.name} on {record.source or 'record'}",
        )


def _names(records: Sequence[MeasuredRecord]) -> tuple[str, ...]:
    return tuple(record.source or "record" for record in records)
