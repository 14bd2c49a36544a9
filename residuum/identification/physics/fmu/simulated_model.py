"""An FMU that is simulated along records: its outputs become recorded signals, which the model that
is compared passes on.

Nothing is known of its inside, so effects can be judged on the paths of its outputs alone, and its
first state is its own.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadModel, BadRecord
from residuum.identification.physics.effects.base import Parameter
from residuum.identification.physics.files.expression import parse
from residuum.identification.physics.fmu.co_simulation import OwnSimulation
from residuum.identification.physics.fmu.description import Description, unit_of
from residuum.identification.physics.fmu.fmu_model import names_of
from residuum.identification.physics.model import Input, Output, PhysicalModel
from residuum.identification.physics.simulate.experiment import moves_evenly
from residuum.identification.record import Record
from residuum.nearest_names import known_names

MADE = "fmu_"
"""How names of signals begin that the FMU computed."""
SAMPLE = "fmu_sample"
"""Input of a model whose parameters are estimated: the row in all records together, by which a part
of a record is found again in the simulation of the whole.
"""


def simulated_model(
    described: Description, parameters: Mapping[str, Parameter] | None = None
) -> PhysicalModel:
    """The model whose outputs are the FMU's, as `with_simulation` writes them into records; one in
    which parameters of it can be moved has the rows of `SAMPLE`, too.
    """
    _, inputs, outputs = names_of(described)
    units = [unit_of(v) for v in described.outputs]
    # The FMU's own inputs stand in no equation: they are there to be matched with the record's
    # columns.
    idle = {name: Input(name, unit_of(v)) for name, v in zip(inputs, described.inputs, strict=True)}
    simulated = {
        MADE + name: Input(MADE + name, unit) for name, unit in zip(outputs, units, strict=True)
    }
    rows = {} if parameters is None else {SAMPLE: Input(SAMPLE, "")}
    return PhysicalModel(
        described.name,
        MappingProxyType(idle | simulated | rows),
        states=MappingProxyType({}),
        parameters=MappingProxyType(dict(parameters or {})),
        balances=MappingProxyType({}),
        outputs=MappingProxyType(
            {n: Output(n, parse(MADE + n), unit) for n, unit in zip(outputs, units, strict=True)}
        ),
    )


def with_simulation(
    own: OwnSimulation,
    records: Sequence[Record],
    mapping: Mapping[str, str],
    values: Mapping[str, float],
    holds: Sequence[FloatArray] | None = None,
) -> list[Record]:
    """The records with what the FMU's outputs would have been by these parameters, from its own
    start, and the rows of `SAMPLE` (`without_rows` takes them off again).

    Parameters
    ----------
    holds : sequence of array
        For each record, 1 of an input that moves evenly between samples and 0 of one that is held;
        default: as `match` takes them.

    Raises
    ------
    BadRecord
        An input of the FMU that a record lacks, or that has missing samples.
    BadModel
        Its simulation fails.
    """
    described = own.instance.description
    first = 0
    simulated = []
    _, _, names = names_of(described)
    for number, record in enumerate(records):
        U = inputs_of(described, record, mapping)
        hold = (
            np.array([float(moves_evenly("auto", u)) for u in U.T])
            if holds is None
            else holds[number]
        )
        Y = own.along(U, hold, record.sample_time, values)
        if own.says:
            raise BadModel(
                f"model {described.path!r}: its simulation along {record.source!r} fails"
                f" ({own.says})"
            )
        signals = {MADE + name: Y[:, k] for k, name in enumerate(names)}
        units = {MADE + name: unit_of(v) for name, v in zip(names, described.outputs, strict=True)}
        # Counted through all records: a part knows its record by its rows.
        signals[SAMPLE] = first + np.arange(record.n, dtype=float)
        units[SAMPLE] = ""
        first += record.n
        simulated.append(
            Record(
                {**record.channels, **signals},
                {**record.units, **units},
                record.sample_time,
                t0=record.t0,
                notes=record.notes,
                source=record.source,
            )
        )
    return simulated


def without_rows(record: Record) -> Record:
    """The record without `SAMPLE`, which is no signal of the machine."""
    return replace(
        record,
        channels={n: v for n, v in record.channels.items() if n != SAMPLE},
        units={n: v for n, v in record.units.items() if n != SAMPLE},
    )


def inputs_of(described: Description, record: Record, mapping: Mapping[str, str]) -> FloatArray:
    """The FMU's inputs along a record, shape (n, inputs), in its units."""
    _, inputs, _ = names_of(described)
    columns = [
        _input(record, mapping.get(name, name), unit_of(v))
        for name, v in zip(inputs, described.inputs, strict=True)
    ]
    return np.stack(columns, axis=1) if columns else np.zeros((record.n, 0))


def _input(record: Record, column: str, unit: str) -> FloatArray:
    if column not in record.names:
        raise BadRecord(
            f"record {record.source!r}: input {column!r} is missing;"
            f" {known_names(column, record.names, 'the columns are')}"
        )
    values = record.in_unit(column, unit)
    if np.isnan(values).any():
        at = int(np.argmax(np.isnan(values)))
        raise BadRecord(
            f"record {record.source!r}: input {column!r} lacks sample {at}; cut the record there"
        )
    return values
