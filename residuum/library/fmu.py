"""An FMU as a Model; only in a process that may end with it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from residuum.identification.physics.fmu.description import describe
from residuum.identification.physics.fmu.fmu_model import (
    exchange_model,
    is_exchangeable,
    simulated_model,
    with_simulation,
)
from residuum.identification.physics.fmu.loaded_library import load
from residuum.identification.record import Record
from residuum.library.model import Model


def fmu_model(
    path: str, records: Sequence[Record], map: Mapping[str, str] | None = None
) -> tuple[Model, list[Record]]:
    """The FMU as a model, and the records with what it needs beside them.

    With model exchange and without events every state has a balance that effects can act in. Any
    other FMU is simulated along each record, and what its outputs lack is judged on their paths.

    Raises
    ------
    BadModel, BadRecord
        It cannot run here; an input is missing; its simulation fails.
    """
    described = describe(path)
    if is_exchangeable(described):
        return Model(exchange_model(load(described)), path), list(records)
    model = simulated_model(described)
    return Model(model, path), [
        with_simulation(described, model, record, map or {}) for record in records
    ]
