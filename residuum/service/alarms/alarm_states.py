"""Alarm states and their transitions after ANSI/ISA-18.2-2016, figure 3, with the latched alarms of its clause 10.

An alarm has a condition (what the machine shows, settled by the rule's deadband and delays) and a state (what an operator sees
and does about it). A condition that stands is never in state normal: it is on the list, or somebody put it aside by name.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime
from enum import StrEnum

from residuum.identification.errors import BadInput
from residuum.service.alarms.alarm_rules import AlarmRule


class AlarmState(StrEnum):
    """State of one alarm of one machine."""

    NORMAL = "normal"
    UNACKNOWLEDGED = "unacknowledged"
    ACKNOWLEDGED = "acknowledged"
    RETURNED_UNACKNOWLEDGED = "returned-unacknowledged"
    SHELVED = "shelved"
    SUPPRESSED = "suppressed"
    OUT_OF_SERVICE = "out-of-service"


class AlarmEvent(StrEnum):
    """What can happen to an alarm."""

    RAISE = "raise"
    CLEAR = "clear"
    ACKNOWLEDGE = "acknowledge"
    RESET = "reset"
    SHELVE = "shelve"
    UNSHELVE = "unshelve"
    SUPPRESS = "suppress"
    RELEASE = "release"
    REMOVE_FROM_SERVICE = "remove-from-service"
    RETURN_TO_SERVICE = "return-to-service"


class IllegalTransition(BadInput):
    """An operator asked for something that the alarm's state does not allow."""


ACTIVE = (AlarmState.UNACKNOWLEDGED, AlarmState.ACKNOWLEDGED, AlarmState.RETURNED_UNACKNOWLEDGED)
"""States that an operator sees on the list of alarms."""

_TRANSITIONS: dict[tuple[AlarmState, AlarmEvent], AlarmState] = {
    (AlarmState.NORMAL, AlarmEvent.RAISE): AlarmState.UNACKNOWLEDGED,
    (AlarmState.RETURNED_UNACKNOWLEDGED, AlarmEvent.RAISE): AlarmState.UNACKNOWLEDGED,
    (AlarmState.UNACKNOWLEDGED, AlarmEvent.CLEAR): AlarmState.RETURNED_UNACKNOWLEDGED,
    (AlarmState.ACKNOWLEDGED, AlarmEvent.CLEAR): AlarmState.NORMAL,
    (AlarmState.UNACKNOWLEDGED, AlarmEvent.ACKNOWLEDGE): AlarmState.ACKNOWLEDGED,
    (AlarmState.RETURNED_UNACKNOWLEDGED, AlarmEvent.ACKNOWLEDGE): AlarmState.NORMAL,
    **{(state, AlarmEvent.SHELVE): AlarmState.SHELVED for state in ACTIVE},
    **{(state, AlarmEvent.SUPPRESS): AlarmState.SUPPRESSED for state in (AlarmState.NORMAL, *ACTIVE)},
    **{
        (state, AlarmEvent.REMOVE_FROM_SERVICE): AlarmState.OUT_OF_SERVICE
        for state in (AlarmState.NORMAL, *ACTIVE, AlarmState.SHELVED, AlarmState.SUPPRESSED)
    },
}
_COMING_BACK = {
    AlarmEvent.UNSHELVE: AlarmState.SHELVED,
    AlarmEvent.RELEASE: AlarmState.SUPPRESSED,
    AlarmEvent.RETURN_TO_SERVICE: AlarmState.OUT_OF_SERVICE,
}
_FROM_THE_MACHINE = (AlarmEvent.RAISE, AlarmEvent.CLEAR)


@dataclass(frozen=True)
class AlarmStatus:
    """State and condition of an alarm; `pending_since` is when the machine began to show the opposite of the condition."""

    state: AlarmState = AlarmState.NORMAL
    condition: bool = False
    pending_since: datetime | None = None


def next_state(state: AlarmState, event: AlarmEvent, *, condition: bool = False, latch: bool = False) -> AlarmState:
    """The state after `event`. What the machine does is always legal (it may change nothing); what an operator asks may not be.

    Parameters
    ----------
    condition : bool
        Whether the condition stands: an alarm that comes back from where it was put is then unacknowledged, and not reset.
    latch : bool
        A latched alarm stays when its condition goes, until an operator acknowledges and resets it.

    Raises
    ------
    IllegalTransition
        An operator's request that the state does not allow (acknowledging a normal alarm).

    Examples
    --------
    >>> next_state(AlarmState.UNACKNOWLEDGED, AlarmEvent.CLEAR)
    <AlarmState.RETURNED_UNACKNOWLEDGED: 'returned-unacknowledged'>
    >>> next_state(AlarmState.ACKNOWLEDGED, AlarmEvent.CLEAR, latch=True)
    <AlarmState.ACKNOWLEDGED: 'acknowledged'>
    """
    if latch and event is AlarmEvent.CLEAR:
        return state
    if (state, event) in _TRANSITIONS:
        return _TRANSITIONS[state, event]
    if event in _FROM_THE_MACHINE:
        return state
    if _COMING_BACK.get(event) is state:
        return AlarmState.UNACKNOWLEDGED if condition else AlarmState.NORMAL
    if event is AlarmEvent.RESET and state is AlarmState.ACKNOWLEDGED and not condition:
        return AlarmState.NORMAL
    standing = ", while its condition stands" if event is AlarmEvent.RESET and state is AlarmState.ACKNOWLEDGED else ""
    raise IllegalTransition(f"alarm: cannot {event.value} in state {state.value!r}{standing}")


def follow(status: AlarmStatus, seen: bool, rule: AlarmRule, now: datetime) -> tuple[AlarmStatus, AlarmEvent | None]:
    """The status after the machine was seen with or without the fault, and the event that this was, None for none.

    What is seen becomes the condition once it has been seen without a break for the rule's delay.
    """
    if seen == status.condition:
        return replace(status, pending_since=None), None
    since = status.pending_since or now
    if (now - since).total_seconds() < (rule.on_delay if seen else rule.off_delay):
        return replace(status, pending_since=since), None
    event = AlarmEvent.RAISE if seen else AlarmEvent.CLEAR
    return AlarmStatus(next_state(status.state, event, latch=rule.latch), seen), event


def operate(status: AlarmStatus, event: AlarmEvent) -> AlarmStatus:
    """The status after an operator's request; IllegalTransition when the state does not allow it."""
    return replace(status, state=next_state(status.state, event, condition=status.condition))
