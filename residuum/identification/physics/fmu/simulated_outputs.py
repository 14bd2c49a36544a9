"""An FMU that is simulated along a record: its outputs become recorded signals, which the model
that is compared passes on.

Nothing is known of its inside, so effects can be judged on the paths of its outputs alone, and its
first state is its own.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from residuum.identification.errors import BadModel, BadRecord, in_one_line
from residuum.identification.physics.files.expression import parse
from residuum.identification.physics.fmu.description import Description, fmpy
from residuum.identification.physics.fmu.fmu_model import names_of, unit_of
from residuum.identification.physics.model import Input, Output, PhysicalModel
from residuum.identification.record import Record

_MADE = "fmu_"
_TOLERANCE = 1e-8


def simulated_model(described: Description) -> PhysicalModel:
    """The model whose outputs are the FMU's, as `with_simulation` writes them into records."""
    _, inputs, outputs = names_of(described)
    units = [unit_of(v) for v in described.outputs]
    idle = {name: Input(name, unit_of(v)) for name, v in zip(inputs, described.inputs, strict=True)}
    simulated = {
        _MADE + name: Input(_MADE + name, unit) for name, unit in zip(outputs, units, strict=True)
    }
    empty: Mapping[str, object] = MappingProxyType({})
    return PhysicalModel(
        described.name,
        MappingProxyType(idle | simulated),
        empty,  # type: ignore[arg-type]
        empty,  # type: ignore[arg-type]
        empty,  # type: ignore[arg-type]
        MappingProxyType(
            {n: Output(n, parse(_MADE + n), unit) for n, unit in zip(outputs, units, strict=True)}
        ),
    )


def with_simulation(
    described: Description, model: PhysicalModel, record: Record, mapping: Mapping[str, str]
) -> Record:
    """The record with what the FMU's outputs would have been, from its own start, inputs held over
    each sample.

    Raises
    ------
    BadRecord
        An input of the FMU that the record lacks, or that has missing samples.
    BadModel
        Its simulation fails.
    """
    _, inputs, outputs = names_of(described)
    signals = [
        _input(record, mapping.get(name, name), unit_of(v))
        for name, v in zip(inputs, described.inputs, strict=True)
    ]
    time = record.sample_time * np.arange(record.n)
    held = np.zeros(
        max(2 * record.n - 1, 1),
        dtype=[("time", float), *((v.name, float) for v in described.inputs)],
    )
    held["time"][::2], held["time"][1::2] = time, time[1:]
    for variable, values in zip(described.inputs, signals, strict=True):
        held[variable.name][::2], held[variable.name][1::2] = values, values[:-1]
    try:
        trajectory = fmpy().simulate_fmu(
            described.path,
            fmi_type="CoSimulation" if described.simulation else "ModelExchange",
            start_time=0.0,
            stop_time=float(time[-1]),
            output_interval=record.sample_time,
            relative_tolerance=_TOLERANCE,
            input=held if described.inputs else None,
            output=[v.name for v in described.outputs],
        )
    except Exception as error:
        raise BadModel(
            f"model {described.path!r}: its simulation along {record.source!r} fails"
            f" ({in_one_line(error)})"
        ) from None
    at = np.clip(np.searchsorted(trajectory["time"], time + 1e-3 * record.sample_time) - 1, 0, None)
    simulated = {
        _MADE + name: np.asarray(trajectory[v.name])[at]
        for name, v in zip(outputs, described.outputs, strict=True)
    }
    units = {name: model.inputs[name].unit for name in simulated}
    return Record(
        {**record.channels, **simulated},
        {**record.units, **units},
        record.sample_time,
        t0=record.t0,
        notes=record.notes,
        source=record.source,
    )


def _input(record: Record, column: str, unit: str) -> np.ndarray[tuple[int], np.dtype[np.float64]]:
    if column not in record.names:
        raise BadRecord(
            f"record {record.source!r}: input {column!r} is missing; the columns are"
            f" {', '.join(record.names)}"
        )
    values = record.in_unit(column, unit)
    if np.isnan(values).any():
        at = int(np.argmax(np.isnan(values)))
        raise BadRecord(
            f"record {record.source!r}: input {column!r} lacks sample {at}; cut the record there"
        )
    return values
