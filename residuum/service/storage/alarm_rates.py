"""How often alarms are raised, out of their journal."""

from __future__ import annotations

from collections import Counter, defaultdict
from datetime import datetime, timedelta

import numpy as np
import numpy.typing as npt
from sqlalchemy import Connection, func, select

from residuum.service.alarms.alarm_states import ACTIVE, AlarmEvent, AlarmState
from residuum.service.storage.tables import alarm_journal, alarms
from residuum.service.store import AlarmRates

_TEN_MINUTES, _HOUR, _DAY = timedelta(minutes=10), timedelta(hours=1), timedelta(days=1)
_FLOOD = 10
"""More alarms than this in ten minutes are a flood for one operator (ANSI/ISA-18.2-2016, 16.5)."""
_CHATTER, _CHATTER_WITHIN = 3, 60.0
_MOST_NAMED = 10


def rates(connection: Connection, now: datetime) -> AlarmRates:
    """The rates of the last day."""
    query = (
        select(alarm_journal.c.at, alarm_journal.c.alarm_id, alarms.c.asset_id, alarms.c.kind)
        .join_from(alarm_journal, alarms)
        .where(
            alarm_journal.c.at > now - _DAY,
            alarm_journal.c.event == AlarmEvent.RAISE.value,
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
    last = [int((times > -span.total_seconds()).sum()) for span in (_TEN_MINUTES, _HOUR, _DAY)]
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
    begins = np.searchsorted(times, times - _TEN_MINUTES.total_seconds(), side="right")
    return int((np.arange(len(times)) - begins + 1).max(initial=0))


def _flood_share(times: npt.NDArray[np.float64]) -> float:
    """Share of the day's intervals of ten minutes that were floods."""
    edges = np.linspace(-_DAY.total_seconds(), 0.0, int(_DAY / _TEN_MINUTES) + 1)
    return float((np.histogram(times, edges)[0] > _FLOOD).mean())


def _chatters(times: list[float]) -> bool:
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
        .where(alarms.c.state.in_(states), alarms.c.raised_at < now - _DAY)
        .order_by(alarms.c.id)
    )
    return list(connection.execute(query).scalars())
