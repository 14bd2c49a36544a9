"""What a person is told of a change of an alarm, or of a flood of them, in plain English."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime
from typing import Any
from urllib.parse import quote

from residuum.service.alarms.alarm_states import SIGNAL, AlarmEvent

# Characters of what a finding says: messengers refuse cards that are too long.
_LONGEST = 1000
# Alarms of a flood that are named.
_NAMED = 10
# What happened to an alarm; of the first two, of one that says that windows cannot be judged, too.
_HAPPENED = {
    AlarmEvent.RAISE: "is faulty",
    AlarmEvent.CLEAR: "is no longer faulty",
    AlarmEvent.ACKNOWLEDGE: "alarm acknowledged",
    AlarmEvent.RESET: "alarm reset",
    AlarmEvent.SHELVE: "alarm shelved",
    AlarmEvent.UNSHELVE: "alarm back from being shelved",
    AlarmEvent.SUPPRESS: "alarm suppressed",
    AlarmEvent.RELEASE: "alarm released",
    AlarmEvent.REMOVE_FROM_SERVICE: "alarm taken out of service",
    AlarmEvent.RETURN_TO_SERVICE: "alarm back in service",
}
_OF_SIGNAL = {
    AlarmEvent.RAISE: "cannot be judged",
    AlarmEvent.CLEAR: "can be judged again",
}


@dataclass(frozen=True)
class AlarmText:
    """A title, facts as (name, value), and a link to the page that has more, None for none."""

    title: str
    facts: tuple[tuple[str, str], ...]
    link: str | None

    @property
    def plain(self) -> str:
        """All of it as lines."""
        lines = [self.title, "", *(f"{name}: {value}" for name, value in self.facts)]
        return "\n".join([*lines, *(["", self.link] if self.link else [])]) + "\n"


def alarm_text(kind: str, payload: Mapping[str, Any], public_url: str | None = None) -> AlarmText:
    """The text of a notice: `alarm`, or `flood`.

    >>> print(alarm_text("alarm", {"asset": "press", "kind": "machine", "state": "unacknowledged",
    ...     "change": "raise", "says": "bearing: outer-race", "priority": "high",
    ...     "raised_at": "2026-03-01T10:00:00+00:00", "exceeded": {"indicator": "rms",
    ...     "value": 3.21, "threshold": 2.0, "unit": "m/s²"}}, "https://plant.example/").plain)
    press is faulty (priority high)
    <BLANKLINE>
    Machine: press
    What: bearing: outer-race
    Since: 2026-03-01 10:00:00 UTC
    Priority: high
    Value: rms 3.21 m/s², threshold 2 m/s²
    State: unacknowledged
    <BLANKLINE>
    https://plant.example/#/machines/press
    <BLANKLINE>
    """
    home = None if public_url is None else public_url.rstrip("/")
    if kind == "flood":
        return _of_flood(payload, home)
    asset, priority = str(payload["asset"]), payload.get("priority")
    facts = [
        ("Machine", asset),
        ("What", says_of(payload)),
        ("Since", moment(payload.get("raised_at"))),
        ("Priority", priority or "none"),
        ("Value", value_of(payload)),
        ("State", str(payload["state"])),
        ("Shelved until", moment(payload.get("shelved_until"))),
        ("Suppressed while", str(payload.get("suppressed_by") or "")),
        ("Acknowledged by", str(payload.get("acknowledged_by") or "")),
        ("Comment", str(payload.get("comment") or "")),
    ]
    title = f"{asset} {_happened(payload)}" + (f" (priority {priority})" if priority else "")
    link = None if home is None else f"{home}/#/machines/{quote(asset, safe='')}"
    return AlarmText(title, tuple((name, value) for name, value in facts if value), link)


def says_of(payload: Mapping[str, Any]) -> str:
    """What the alarm's worst finding says, bounded."""
    return _cut(str(payload.get("says") or payload.get("message") or ""), _LONGEST)


def value_of(payload: Mapping[str, Any]) -> str:
    """The indicator that lies furthest beyond its threshold, with both; empty where none is
    known.
    """
    exceeded = payload.get("exceeded")
    if not exceeded:
        return ""
    value, threshold = (
        f"{exceeded[name]:.4g} {exceeded['unit']}".rstrip() for name in ("value", "threshold")
    )
    return f"{exceeded['indicator']} {value}, threshold {threshold}"


def moment(at: Any) -> str:
    """A moment of a notice for a person, in UTC; empty for none."""
    return f"{datetime.fromisoformat(at):%Y-%m-%d %H:%M:%S} UTC" if at else ""


def _happened(payload: Mapping[str, Any]) -> str:
    # a notice of an earlier release does not say what happened
    if payload.get("change") not in tuple(AlarmEvent):
        return f"alarm: {payload['state']}"
    event = AlarmEvent(payload["change"])
    of_signal = _OF_SIGNAL.get(event) if payload.get("kind") == SIGNAL else None
    return of_signal or _HAPPENED[event]


def _of_flood(payload: Mapping[str, Any], home: str | None) -> AlarmText:
    raised, alarms = payload["raised"], payload["alarms"]
    over = payload["phase"] == "ends"
    title = (
        f"Flood of alarms is over: {raised} raised" if over else f"Flood of alarms: {raised} so far"
    )
    named = [
        (str(alarm["asset"]), _cut(f"{alarm['state']}: {alarm.get('message') or ''}", 200))
        for alarm in alarms[:_NAMED]
    ]
    more = [("And", f"{len(alarms) - _NAMED} more")] if len(alarms) > _NAMED else []
    span = [("Since", moment(payload["began_at"])), ("Over at", moment(payload["ended_at"]))]
    facts = tuple((name, value) for name, value in [*span, *named, *more] if value)
    return AlarmText(title, facts, None if home is None else f"{home}/")


def _cut(text: str, longest: int) -> str:
    return text if len(text) <= longest else f"{text[: longest - 1]}…"
