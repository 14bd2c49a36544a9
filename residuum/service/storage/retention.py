"""What may go: first the signals of the oldest windows beyond an age or an amount, then their rows,
unless somebody may still ask for them.
"""

from __future__ import annotations

import math
import sys
from collections import Counter, defaultdict, deque
from dataclasses import dataclass
from datetime import datetime, timedelta
from time import monotonic
from typing import Any

import numpy as np
import numpy.typing as npt
from sqlalchemy import ColumnElement, Connection, Row, Select, delete, func, select, update

from residuum.service.alarms.alarm_states import ACTIVE, AlarmEvent, AlarmState
from residuum.service.storage.rows import finding_hours, finding_notices
from residuum.service.storage.tables import alarm_journal, alarms, assets, findings, windows
from residuum.service.store import AlarmRates

# How often alarms are raised, out of their journal.

_TEN_MINUTES, _HOUR, _DAY_OF_RATES = timedelta(minutes=10), timedelta(hours=1), timedelta(days=1)
# More alarms than this in ten minutes are a flood for one operator (ANSI/ISA-18.2-2016, 16.5).
_FLOOD = 10
# An alarm that is raised so often within so many seconds chatters. Three times a minute are where
# ANSI/ISA-18.2 begins to look for chattering alarms.
_CHATTER, _CHATTER_WITHIN = 3, 60.0
# Alarms that are named as the most frequent ones, as many as ANSI/ISA-18.2 (clause 16) looks at: a
# few alarms make most of an operator's load.
_MOST_NAMED = 10


def rates(connection: Connection, now: datetime) -> AlarmRates:
    """The rates of the last day."""
    query = (
        select(alarm_journal.c.at, alarm_journal.c.alarm_id, alarms.c.asset_id, alarms.c.kind)
        .join_from(alarm_journal, alarms)
        .where(
            alarm_journal.c.at > now - _DAY_OF_RATES,
            alarm_journal.c.event == AlarmEvent.RAISE.value,
            # Raised while shelved, suppressed or out of service, an alarm asked nothing of an
            # operator.
            alarm_journal.c.state == AlarmState.UNACKNOWLEDGED.value,
        )
        .order_by(alarm_journal.c.at)
    )
    rows = connection.execute(query).all()
    times = np.array([(row.at - now).total_seconds() for row in rows])
    moments: dict[int, list[float]] = defaultdict(list)
    for row, time in zip(rows, times.tolist(), strict=True):
        moments[row.alarm_id].append(time)
    named = {
        row.alarm_id: {"alarm": row.alarm_id, "asset": row.asset_id, "kind": row.kind}
        for row in rows
    }
    often = Counter({alarm: len(raises) for alarm, raises in moments.items()}).most_common(
        _MOST_NAMED
    )
    last = [
        int((times > -span.total_seconds()).sum()) for span in (_TEN_MINUTES, _HOUR, _DAY_OF_RATES)
    ]
    return AlarmRates(
        last_10_minutes=last[0],
        last_hour=last[1],
        last_day=last[2],
        highest_in_10_minutes=_highest(times),
        flood=last[0] > _FLOOD,
        flood_share=_flood_share(times),
        standing=_standing(connection),
        stale=_stale(connection, now),
        chattering=[alarm for alarm, raises in moments.items() if _chatters(raises)],
        most_frequent=[named[alarm] | {"raised": count} for alarm, count in often],
    )


def _highest(times: npt.NDArray[np.float64]) -> int:
    """Most alarms in any ten minutes."""
    # Of each alarm, the first within the ten minutes that end with it: times increase.
    begins = np.searchsorted(times, times - _TEN_MINUTES.total_seconds(), side="right")
    return int((np.arange(len(times)) - begins + 1).max(initial=0))


def _flood_share(times: npt.NDArray[np.float64]) -> float:
    """Share of the day's intervals of ten minutes that were floods."""
    edges = np.linspace(-_DAY_OF_RATES.total_seconds(), 0.0, int(_DAY_OF_RATES / _TEN_MINUTES) + 1)
    return float((np.histogram(times, edges)[0] > _FLOOD).mean())


def _chatters(times: list[float]) -> bool:
    # from each raise to the second one after it
    apart = np.array(times[_CHATTER - 1 :]) - np.array(times[: len(times) - _CHATTER + 1])
    return bool((apart <= _CHATTER_WITHIN).any())


def _standing(connection: Connection) -> dict[str, int]:
    counted = connection.execute(
        select(alarms.c.state, func.count()).group_by(alarms.c.state)
    ).all()
    return {row[0]: row[1] for row in counted}


def _stale(connection: Connection, now: datetime) -> list[int]:
    states = [state.value for state in ACTIVE]
    query = (
        select(alarms.c.id)
        .where(alarms.c.state.in_(states), alarms.c.raised_at < now - _DAY_OF_RATES)
        .order_by(alarms.c.id)
    )
    return list(connection.execute(query).scalars())


_DAY = 86_400.0
# Signals let go in one transaction, so that writers never wait long for it.
_AT_ONCE = 500
# Share of what is there that may go for its age within a day, where the age by itself asks for
# less.
_SHARE = 0.1
# Windows that may go for their age within a day, however few there are.
_LEAST = 10
# How far back the newest window may lie: beyond, the clock may have jumped, and nothing goes for
# its age.
_FARTHEST = timedelta(days=7)


@dataclass(frozen=True)
class Retention:
    """How long, and how many bytes of, the windows' signals are kept; and how long, and how many
    of, their rows.
    """

    days: float
    size_bytes: int
    row_days: float = math.inf
    rows: int = sys.maxsize


class Clock:
    """How far the clock is believed: a share of the windows a day may go for their age, none while
    the newest lies far back.

    A clock that stands two years ahead makes all windows old at once. What went within a day is
    known by a clock that nobody can set, and of signals also from their rows. `doubt` says why some
    that are old were kept.
    """

    def __init__(self) -> None:
        self.doubt: str | None = None
        self._far: datetime | None = None
        self._gone: dict[str, deque[tuple[float, int]]] = {"signals": deque(), "rows": deque()}

    def signals(self, connection: Connection, days: float, now: datetime) -> int:
        """How many signals may go for their age now."""
        held = connection.execute(
            select(func.count()).select_from(windows).where(_HELD)
        ).scalar_one()
        lately = windows.c.signal_let_go_at > now - timedelta(days=1)
        recent = connection.execute(
            select(func.count()).select_from(windows).where(lately)
        ).scalar_one()
        return self._may_go(connection, held, max(recent, self._lately("signals")), days, now)

    def rows(self, connection: Connection, days: float, now: datetime) -> int:
        """How many rows may go for their age now."""
        total = connection.execute(select(func.count()).select_from(windows)).scalar_one()
        return self._may_go(connection, total, self._lately("rows"), days, now)

    def went(self, kind: str, count: int) -> None:
        """Note that so many `signals` or `rows` went for their age."""
        if count > 0:
            self._gone[kind].append((monotonic(), count))

    def _lately(self, kind: str) -> int:
        departures = self._gone[kind]
        while departures and departures[0][0] < monotonic() - _DAY:
            departures.popleft()
        return sum(count for _, count in departures)

    def _may_go(
        self, connection: Connection, total: int, past: int, days: float, now: datetime
    ) -> int:
        newest = connection.execute(
            select(windows.c.received_at).order_by(windows.c.id.desc()).limit(1)
        ).scalar_one_or_none()
        # By number, not by time: a clock that jumped has written its own times.
        self._far = newest if newest is not None and now - newest > _FARTHEST else None
        if self._far is not None:
            return 0
        # Windows that come evenly are 1/days of what is there, each day: twice as many may go, so
        # that a rule of few days is kept up with.
        share = math.inf if days <= 0 else max(_SHARE, 2.0 / days)
        return sys.maxsize if share >= 1 else max(_LEAST, math.ceil(share * (total + past))) - past

    def kept_back(self, days: float, now: datetime) -> None:
        """Note that more is old than may go."""
        if self._far is not None:
            says = (
                f"the newest window is of {self._far:%Y-%m-%d}, the clock says {now:%Y-%m-%d}: none"
                " goes until newer ones come"
            )
        else:
            says = (
                f"more is older than {days:g} days than the {100 * max(_SHARE, 2.0 / days):.0f} %"
                " that go within a day"
            )
        self.doubt = f"{says}; set the clock right if it is wrong"


def let_go(connection: Connection, retention: Retention, now: datetime, clock: Clock) -> list[str]:
    """Write down that the oldest signals beyond the age or the amount are gone, a batch at most;
    returns their blocks' paths.

    Those beyond the age go as far as the clock is believed. Signals of rows that are to go go too.
    Kept whatever their age: the newest window of every asset, and the window behind every alarm
    that is not normal.
    """
    held = connection.execute(
        select(func.coalesce(func.sum(windows.c.size_bytes), 0)).where(_HELD)
    ).scalar_one()
    surplus = int(held) - retention.size_bytes
    rows = (
        connection.execute(select(func.count()).select_from(windows).where(_HELD)).scalar_one()
        - retention.rows
    )
    # A row goes only when its signal has gone: what is to be forgotten is let go first.
    days = min(retention.days, retention.row_days)
    aged = may_go = clock.signals(connection, days, now)
    freed: list[Row[Any]] = []
    # The sums go down with each row that is let go, so that no more go than must.
    for row in connection.execute(_may_go(_HELD)):
        # Oldest first. Beyond the amount they go whatever the clock says; for their age alone only
        # so many a day.
        if surplus <= 0 and rows <= 0:
            if (now - row.received_at).total_seconds() <= days * _DAY:
                break
            if aged <= 0:
                clock.kept_back(days, now)
                break
            aged -= 1
        surplus -= row.size_bytes
        rows -= 1
        freed.append(row)
    clock.went("signals", may_go - aged)
    ids = [row.id for row in freed]
    connection.execute(update(windows).where(windows.c.id.in_(ids)).values(signal_let_go_at=now))
    return [row.block_path for row in freed]


def forget(connection: Connection, retention: Retention, now: datetime, clock: Clock) -> int:
    """Fold the findings of the oldest windows beyond the age or the number into their hours, and
    delete the rows of both.

    A batch at most; returns how many. Only windows whose signal is gone; kept is what `let_go`
    keeps, and what any alarm names.
    """
    surplus = (
        connection.execute(select(func.count()).select_from(windows)).scalar_one() - retention.rows
    )
    aged = clock.rows(connection, retention.row_days, now)
    forgotten: list[int] = []
    for row in connection.execute(
        _may_go(windows.c.signal_let_go_at.is_not(None), alarming=alarms.c.window_id.is_not(None))
    ):
        if len(forgotten) >= surplus:
            if (now - row.received_at).total_seconds() <= retention.row_days * _DAY:
                break
            if len(forgotten) - max(0, surplus) >= aged:
                clock.kept_back(retention.row_days, now)
                break
        forgotten.append(row.id)
    if forgotten:
        clock.went("rows", len(forgotten) - max(0, surplus))
        theirs = findings.c.window_id.in_(forgotten)
        # Notices point to findings, and findings to windows: they go in this order.
        finding_notices.forget(connection, theirs)
        finding_hours.add(
            connection,
            connection.execute(select(findings).where(theirs).order_by(findings.c.id)).all(),
        )
        connection.execute(delete(findings).where(theirs))
        connection.execute(delete(windows).where(windows.c.id.in_(forgotten)))
    return len(forgotten)


_HELD = windows.c.signal_let_go_at.is_(None)
_ALARMING = (alarms.c.state != AlarmState.NORMAL.value) & alarms.c.window_id.is_not(None)


def _may_go(where: ColumnElement[bool], alarming: ColumnElement[bool] = _ALARMING) -> Select[Any]:
    newest = (
        select(func.max(windows.c.id))
        .where(windows.c.asset_id == assets.c.id)
        .correlate(assets)
        .scalar_subquery()
    )
    query = select(
        windows.c.id, windows.c.block_path, windows.c.size_bytes, windows.c.received_at
    ).where(
        where,
        windows.c.id.not_in(select(newest).select_from(assets).where(newest.is_not(None))),
        windows.c.id.not_in(select(alarms.c.window_id).where(alarming)),
    )
    return query.order_by(windows.c.id).limit(_AT_ONCE)
