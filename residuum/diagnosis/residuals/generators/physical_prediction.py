"""What a physical model predicts, as a channel: the input of a residual that watches what the
physics leaves over.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from residuum.identification.errors import MAY_DIVERGE, BadInput, NotIdentifiable
from residuum.identification.physics import PhysicalModel, estimate, match
from residuum.identification.record import Record
from residuum.nearest_names import known_names

PREDICTION = "prediction"


def with_prediction(
    model: PhysicalModel, record: Record, output: str, mapping: Mapping[str, str] | None = None
) -> Record:
    """The record with one more channel, `prediction`: `output` as the model simulates it from the
    record's inputs.

    A residual designed from `prediction` to the measured output (both in one unit, so a nearly unit
    response is identified) sees only what the physics does not explain. As long as an effect is
    missing, that is structured and hides small faults; with the effect added (`improve`) the same
    residual finds them. Only the initial states are fitted, to this record; a fault that is there
    from its first sample moves them, one that comes later does not move the prediction.

    Parameters
    ----------
    model : PhysicalModel
        With all parameters estimated, on healthy records.
    output : str
        The model's output, measured in the record.
    mapping : mapping of model name to column

    Raises
    ------
    BadInput
        The model has no such output.
    BadRecord, BadUnit
        The record does not fit the model.
    NotIdentifiable
        The model diverges on the record.
    """
    if output not in model.outputs:
        raise BadInput(
            f"prediction: model {model.name!r} has no output {output!r};"
            f" {known_names(output, model.outputs, 'it has')}"
        )
    matched, (experiment,) = match(model, [record], mapping)
    simulated = estimate(matched, [experiment], free=()).predicted[0]
    if not np.isfinite(simulated).all():
        raise NotIdentifiable(
            f"prediction: model {model.name!r} diverges on record {record.source!r}; {MAY_DIVERGE}"
        )
    predicted = np.asarray(simulated[:, list(model.outputs).index(output)])
    channels = MappingProxyType({**record.channels, PREDICTION: predicted})
    units = MappingProxyType({**record.units, PREDICTION: model.outputs[output].unit})
    return replace(record, channels=channels, units=units)
