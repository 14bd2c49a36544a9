"""States of a machine in which its alarms mean nothing, seen in a window's signals."""

from __future__ import annotations

import numpy as np

from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.identification.units import compatible, convert
from residuum.service.alarms.alarm_states import AlarmRule, MachineState


def suppressing_state(rule: AlarmRule, record: Record) -> str | None:
    """The state of the rule that the machine is in during a window, in words; empty where it is in
    none, None where the window cannot tell.

    A state is told by the median of its signal over the samples that are there. A signal that is
    not in the window, has no sample, or another kind of unit than the limit tells nothing.

    >>> rule = AlarmRule(suppress=[{"signal": "speed", "unit": "rpm", "below": 60}])
    >>> suppressing_state(rule, Record({"speed": [0.1, 0.2, 9.0]}, {"speed": "rev/s"}, 1.0))
    'speed below 60 rpm'
    """
    # one that holds is enough, whatever the others cannot tell
    states = [(state, _holds(state, record)) for state in rule.suppress]
    standing = next((str(state) for state, holds in states if holds), None)
    if standing is not None:
        return standing
    return None if any(holds is None for _, holds in states) else ""


def _compatible(unit: str, wanted: str) -> bool:
    try:
        return compatible(unit, wanted)
    except BadInput:  # a unit of the record that nobody knows
        return False


def _holds(state: MachineState, record: Record) -> bool | None:
    unit = record.units.get(state.signal)
    if unit is None or not _compatible(unit, state.unit):
        return None
    values = np.asarray(record[state.signal], dtype=float)
    values = values[np.isfinite(values)]
    if not values.size:
        return None
    # of the window, not its last sample: spikes of a signal end no state
    median = float(np.median(convert(values, unit, state.unit)))
    return median < state.below if state.below is not None else median > (state.above or 0.0)
