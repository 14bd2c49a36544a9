"""Alarm states and their transitions after ANSI/ISA-18.2-2016, figure 3, with the latched alarms of
its clause 10.

An alarm has a condition (what the machine shows, settled by the rule's deadband and delays) and a
state (what an operator sees and does about it). A condition that stands is never in state normal:
it is on the list, or somebody put it aside by name.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from enum import StrEnum
from typing import Literal, get_args

from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from residuum.identification.errors import BadInput
from residuum.identification.units import parse_unit

MACHINE, SIGNAL = "machine", "signal"
"""Kinds of alarms: a fault was found, windows cannot be judged."""

# AlarmRule: when what a machine shows becomes an alarm, and when it no longer is one.


Consequence = Literal["minor", "major", "severe"]
"""What happens where nobody answers an alarm in time."""


class Priority(StrEnum):
    """Which alarm an operator answers first."""

    HIGH = "high"
    MEDIUM = "medium"
    LOW = "low"


# Times to respond [s] up to which an alarm asks for an answer at once, or soon.
_PROMPT, _SOON = 300.0, 1800.0
# by the sum of both ranks, 0 to 4
_PRIORITIES = (Priority.LOW, Priority.LOW, Priority.MEDIUM, Priority.HIGH, Priority.HIGH)


def priority_of(consequence: Consequence, time_to_respond: float) -> Priority:
    """The priority of an alarm from what happens where nobody answers it, and the time [s] in which
    an answer helps (ANSI/ISA-18.2-2016, clause 9, asks for both; the ranks are ours).

    Ranks are added: minor 0, major 1, severe 2; later 0, within half an hour 1, within five minutes
    2. A sum of 3 or more is high, 2 medium, less low.

    >>> priority_of("severe", 1200.0).value, priority_of("minor", 60.0).value
    ('high', 'medium')
    """
    # one rank for each of the two times that it is within
    urgency = (time_to_respond <= _PROMPT) + (time_to_respond <= _SOON)
    return _PRIORITIES[get_args(Consequence).index(consequence) + urgency]


class MachineState(BaseModel):
    """A state of the machine in which its alarms mean nothing: the median of a signal of the window
    lies below, or above, a limit.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    signal: str = Field(
        min_length=1,
        max_length=200,
        description="Its name on the bus, or in the machine's windows where `channels` gives one.",
    )
    unit: str = Field(max_length=60, description="Unit of the limit.")
    below: float | None = Field(default=None, allow_inf_nan=False)
    above: float | None = Field(default=None, allow_inf_nan=False)

    @field_validator("unit")
    @classmethod
    def _known(cls, value: str) -> str:
        try:
            parse_unit(value)
        except BadInput as error:
            raise ValueError(f"suppress, unit: {error}") from None
        return value

    @model_validator(mode="after")
    def _one_limit(self) -> MachineState:
        if (self.below is None) == (self.above is None):
            raise ValueError("suppress: a state has one limit; write below: or above:")
        return self

    def __str__(self) -> str:
        side = f"below {self.below:g}" if self.above is None else f"above {self.above:g}"
        return f"{self.signal} {side} {self.unit}".rstrip()


class AlarmRule(BaseModel):
    """Deadband, delays, latch, priority, shelving and suppression of the alarms of a machine
    (ANSI/ISA-18.2, clauses 9 to 11).
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    deadband: float = Field(
        default=0.0,
        ge=0,
        lt=1,
        description=(
            "A standing alarm clears only where the indicator that raised it lies deadband ·"
            " |threshold| or more below its threshold; a threshold of 0 has no deadband."
        ),
    )
    on_delay: float = Field(
        default=0.0,
        ge=0,
        le=86_400,
        description=(
            "Seconds for which a fault must be seen to raise the alarm. Only time between windows"
            " that both show it counts; a pause longer than the delay, and twice as long as the one"
            " before, begins the count anew."
        ),
    )
    off_delay: float = Field(
        default=0.0,
        ge=0,
        le=86_400,
        description="Seconds without the fault that clear the alarm, counted like the on_delay.",
    )
    latch: bool = Field(
        default=False,
        description="The alarm stays when its condition goes, until it is acknowledged and reset.",
    )
    consequence: Consequence | None = Field(
        default=None, description="What happens where nobody answers in time; with time_to_respond."
    )
    time_to_respond: float | None = Field(
        default=None,
        gt=0,
        le=30 * 86_400,
        description="Seconds in which an answer helps. Both give the priority.",
    )
    action: str = Field(
        default="", max_length=500, description="What an operator does about it, in words."
    )
    shelving_reason: bool = Field(
        default=False, description="Whether an alarm is shelved only with a comment that says why."
    )
    longest_shelving: float = Field(
        default=7 * 24 * 60,
        gt=0,
        le=7 * 24 * 60,
        description="Minutes that shelving lasts at most.",
    )
    flood: int = Field(
        default=0,
        ge=0,
        le=10_000,
        description=(
            "More alarms of the plant than this in ten minutes are a flood, which receivers are"
            " told as one when it begins and when it is over; 0: each change is told."
        ),
    )
    suppress: tuple[MachineState, ...] = Field(
        default=(),
        max_length=10,
        description=(
            "States of the machine in any of which its alarms are suppressed: signal, unit, below"
            " or above."
        ),
    )

    @model_validator(mode="after")
    def _priority_of_both(self) -> AlarmRule:
        if (self.consequence is None) != (self.time_to_respond is None):
            raise ValueError(
                "consequence and time_to_respond: the priority follows from both; write both"
            )
        return self

    def priority(self, kind: str) -> Priority | None:
        """Of an alarm of this kind, None where the rule says none. That windows cannot be judged is
        no consequence of the machine's: low.
        """
        if self.consequence is None or self.time_to_respond is None:
            return None
        of_machine = priority_of(self.consequence, self.time_to_respond)
        return of_machine if kind == MACHINE else Priority.LOW

    def refuse_shelving(self, minutes: float, reason: str | None) -> None:
        """BadInput where an alarm may not be shelved for so long, or without a reason."""
        if minutes > self.longest_shelving:
            raise BadInput(
                f"body, minutes {minutes:g}: an alarm of this machine is shelved for at most"
                f" {self.longest_shelving:g} minutes (setting longest_shelving)"
            )
        if self.shelving_reason and not (reason or "").strip():
            raise BadInput(
                "body, comment: is missing; an alarm of this machine is shelved with a reason"
                " (setting shelving_reason)"
            )


def severity(
    indicators: Mapping[str, float | None], thresholds: Mapping[str, float | None]
) -> float:
    """How far the worst indicator lies beyond its threshold τ, max x/τ; 0 where none has one.

    >>> severity({"rms": 3.0, "kurtosis": 4.0}, {"rms": 1.0, "kurtosis": 8.0})
    3.0
    """
    # a threshold of 0 or below has no multiple, and infinity would hide how far the others are
    pairs = [(indicators.get(name), tau) for name, tau in thresholds.items()]
    return max(
        (
            x / tau
            for x, tau in pairs
            if x is not None and tau is not None and tau > 0 and x / tau < math.inf
        ),
        default=0.0,
    )


def beyond(
    indicators: Mapping[str, float | None], thresholds: Mapping[str, float | None]
) -> frozenset[str]:
    """The indicators above their thresholds.

    >>> sorted(beyond({"rms": 3.0, "kurtosis": 4.0}, {"rms": 1.0, "kurtosis": 8.0}))
    ['rms']
    """
    pairs = {name: (indicators.get(name), tau) for name, tau in thresholds.items()}
    return frozenset(
        name for name, (x, tau) in pairs.items() if x is not None and tau is not None and x > tau
    )


def furthest_beyond(
    indicators: Mapping[str, float | None], thresholds: Mapping[str, float | None]
) -> str | None:
    """The indicator above its threshold τ with the largest x/τ; of those whose τ has no multiple
    (0 or below) one only where no other is above its own. None where none is.

    >>> furthest_beyond({"rms": 3.0, "kurtosis": 9.0}, {"rms": 1.0, "kurtosis": 8.0})
    'rms'
    """
    names = sorted(beyond(indicators, thresholds))

    def times(name: str) -> float:
        return severity(indicators, {name: thresholds[name]})

    return max(names, key=times, default=None)


def in_deadband(
    rule: AlarmRule,
    indicators: Mapping[str, float | None],
    thresholds: Mapping[str, float | None],
    raised_by: Collection[str] | None = None,
) -> bool:
    """Whether one of the indicators that raised an alarm lies below its threshold τ by less than
    the deadband: τ − d |τ| < x ≤ τ.

    `raised_by` of None is any indicator: of an alarm of which nobody kept what raised it.

    >>> in_deadband(AlarmRule(deadband=0.1), {"rms": 0.95}, {"rms": 1.0}, {"rms"})
    True
    >>> limits = {"rms": 1.0, "kurtosis": 1.0}
    >>> in_deadband(AlarmRule(deadband=0.1), {"rms": 0.5, "kurtosis": 0.95}, limits, {"rms"})
    False
    """
    for name, tau in thresholds.items():
        x = indicators.get(name)
        counts = raised_by is None or name in raised_by
        # d of |τ|: the band lies below the threshold of a negative indicator, too
        if (
            counts
            and x is not None
            and tau is not None
            and tau - rule.deadband * abs(tau) < x <= tau
        ):
            return rule.deadband > 0.0
    return False


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

# What is not in it changes nothing where the machine did it, and is refused where an operator asks.
_TRANSITIONS: dict[tuple[AlarmState, AlarmEvent], AlarmState] = {
    (AlarmState.NORMAL, AlarmEvent.RAISE): AlarmState.UNACKNOWLEDGED,
    (AlarmState.RETURNED_UNACKNOWLEDGED, AlarmEvent.RAISE): AlarmState.UNACKNOWLEDGED,
    (AlarmState.UNACKNOWLEDGED, AlarmEvent.CLEAR): AlarmState.RETURNED_UNACKNOWLEDGED,
    (AlarmState.ACKNOWLEDGED, AlarmEvent.CLEAR): AlarmState.NORMAL,
    (AlarmState.UNACKNOWLEDGED, AlarmEvent.ACKNOWLEDGE): AlarmState.ACKNOWLEDGED,
    (AlarmState.RETURNED_UNACKNOWLEDGED, AlarmEvent.ACKNOWLEDGE): AlarmState.NORMAL,
    **{(state, AlarmEvent.SHELVE): AlarmState.SHELVED for state in ACTIVE},
    **{
        (state, AlarmEvent.SUPPRESS): AlarmState.SUPPRESSED
        for state in (AlarmState.NORMAL, *ACTIVE)
    },
    **{
        (state, AlarmEvent.REMOVE_FROM_SERVICE): AlarmState.OUT_OF_SERVICE
        for state in (AlarmState.NORMAL, *ACTIVE, AlarmState.SHELVED, AlarmState.SUPPRESSED)
    },
}
# From where an operator put it; where an alarm then goes depends on its condition.
_COMING_BACK = {
    AlarmEvent.UNSHELVE: AlarmState.SHELVED,
    AlarmEvent.RELEASE: AlarmState.SUPPRESSED,
    AlarmEvent.RETURN_TO_SERVICE: AlarmState.OUT_OF_SERVICE,
}
# Pauses before, from which on a longer one is a gap.
_GAP = 2.0
_FROM_THE_MACHINE = (AlarmEvent.RAISE, AlarmEvent.CLEAR)


@dataclass(frozen=True)
class AlarmStatus:
    """State and condition of an alarm, and what its delays count.

    Attributes
    ----------
    state : AlarmState
    condition : bool
    pending_since : datetime or None
        When the machine began to show the opposite of the condition.
    pending_seconds : float
        For how long it was seen to show it since.
    judged_at : datetime or None
        When the last window was that told; None where one that could not be judged came after it.
    judged_every : float or None
        Seconds between that one and the one before it.
    """

    state: AlarmState = AlarmState.NORMAL
    condition: bool = False
    pending_since: datetime | None = None
    pending_seconds: float = 0.0
    judged_at: datetime | None = None
    judged_every: float | None = None


def next_state(
    state: AlarmState, event: AlarmEvent, *, condition: bool = False, latch: bool = False
) -> AlarmState:
    """The state after `event`. What the machine does is always legal (it may change nothing); what
    an operator asks may not be.

    Parameters
    ----------
    condition : bool
        Whether the condition stands: an alarm that comes back from where it was put is then
        unacknowledged, and not reset.
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
    # before the table, which holds for alarms that are not latched (clause 10)
    if latch and event is AlarmEvent.CLEAR:
        return state
    if (state, event) in _TRANSITIONS:
        return _TRANSITIONS[state, event]
    if event in _FROM_THE_MACHINE:
        return state
    if _COMING_BACK.get(event) is state:
        return AlarmState.UNACKNOWLEDGED if condition else AlarmState.NORMAL
    standing = ""
    if event is AlarmEvent.RESET and state is AlarmState.ACKNOWLEDGED:
        if not condition:
            return AlarmState.NORMAL
        standing = ", while its condition stands"
    raise IllegalTransition(f"alarm: cannot {event.value} in state {state.value!r}{standing}")


def follow(
    status: AlarmStatus, faulty: bool, rule: AlarmRule, now: datetime
) -> tuple[AlarmStatus, AlarmEvent | None]:
    """The status after the machine was seen with or without the fault, and the event that this was,
    None for none.

    What is seen becomes the condition once it has been seen for the rule's delay. Only time between
    two windows in a row that both show it counts: windows that could not be judged stop the count,
    a clock that was set back does not wind it back, and after a gap (longer than the delay, and
    than twice the pause before) it begins anew, for nobody knows what was in between.

    Parameters
    ----------
    status : AlarmStatus
    faulty : bool
        Whether the machine shows the fault.
    rule : AlarmRule
    now : datetime
        Of the window that shows it.
    """
    delay = rule.on_delay if faulty else rule.off_delay
    # a clock that was set back gives no negative pause
    pause = None if status.judged_at is None else max((now - status.judged_at).total_seconds(), 0.0)
    every = status.judged_every if pause is None else pause
    # noted whatever is shown: a later gap is told by the pause before it
    judged = replace(status, judged_at=now, judged_every=every)
    if faulty == status.condition:
        return replace(judged, pending_since=None, pending_seconds=0.0), None
    since, seconds = _pending(status, pause, delay, now)
    if seconds < delay:
        return replace(judged, pending_since=since, pending_seconds=seconds), None
    event = AlarmEvent.RAISE if faulty else AlarmEvent.CLEAR
    state = next_state(status.state, event, latch=rule.latch)
    return (
        replace(judged, state=state, condition=faulty, pending_since=None, pending_seconds=0.0),
        event,
    )


def _pending(
    status: AlarmStatus, pause: float | None, delay: float, now: datetime
) -> tuple[datetime, float]:
    """Since when the opposite of the condition is shown, and for how many seconds it was seen."""
    gap = pause is not None and pause > max(delay, _GAP * (status.judged_every or 0.0))
    if status.pending_since is None or gap:
        return now, 0.0
    return status.pending_since, status.pending_seconds + (pause or 0.0)


def unjudged(status: AlarmStatus) -> AlarmStatus:
    """The status after a window that says nothing of the condition: time around it does not
    count.
    """
    return replace(status, judged_at=None)


def operate(status: AlarmStatus, event: AlarmEvent) -> AlarmStatus:
    """The status after an operator's request; IllegalTransition when the state does not allow
    it.
    """
    return replace(status, state=next_state(status.state, event, condition=status.condition))
