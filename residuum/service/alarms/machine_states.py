"""States of a machine in which its alarms mean nothing, seen in a window's signals."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import structlog

from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.identification.units import compatible, convert
from residuum.nearest_names import known_names
from residuum.service.alarms.alarm_states import AlarmRule, MachineState

log = structlog.get_logger()


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


def unknown_states(rule: AlarmRule, units: Mapping[str, str]) -> list[str]:
    """What keeps states of the rule from ever being told by windows with these signals, a sentence
    each.

    >>> rule = AlarmRule(suppress=[{"signal": "sped", "unit": "rpm", "below": 60}])
    >>> unknown_states(rule, {"speed": "rev/s"})
    ["no signal 'sped'; did you mean 'speed'? there are speed"]
    """
    says = []
    for state in rule.suppress:
        if state.signal not in units:
            known = known_names(state.signal, sorted(units), "there are")
            says.append(f"no signal {state.signal!r}; {known}")
        elif not _compatible(units[state.signal], state.unit):
            has = units[state.signal] or "no unit"
            says.append(
                f"signal {state.signal!r} is in {has}, which is not of the kind of"
                f" {state.unit or 'no unit'}"
            )
    return says


class UntoldStates:
    """Machines whose newest window lacked the signal that a state of their rule is told by, with why
    it cannot be told; for any thread.
    """

    def __init__(self) -> None:
        self._whys: dict[str, str] = {}
        self._logged: dict[str, str] = {}

    def note(self, asset: str, rule: AlarmRule, record: Record) -> None:
        """Look at a machine's newest window; what was not known of it before is logged."""
        says = unknown_states(rule, record.units) if rule.suppress else []
        if not says:
            self._whys.pop(asset, None)
            return
        why = f"suppress: {'; '.join(says)}"
        # once, not with each window: a machine may have windows of two kinds in turn
        if self._logged.get(asset) != why:
            log.warning("a state that suppresses alarms is not told", machine=asset, reason=why)
        self._whys[asset] = self._logged[asset] = why

    def now(self) -> dict[str, str]:
        """Machine → why a state of its rule cannot be told."""
        return dict(self._whys)


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
