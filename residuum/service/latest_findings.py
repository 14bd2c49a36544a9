"""The latest finding and alarms of every machine, told from the store to who shows only these."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, Protocol, TypeVar

from residuum.service.store import Alarm, Page, Store

T = TypeVar("T")


class Out(Protocol):
    """Who shows them."""

    def tell(self, kind: str, payload: Mapping[str, Any]) -> None:
        """A finding or an alarm."""


def tell_latest(store: Store, outs: Sequence[Out]) -> None:
    """Tell the latest `finding` of every asset, and of its alarms the `alarm` that changed last; StorageUnavailable."""
    if not outs:
        return
    assets = _all(store.assets)
    news = [("finding", asset.last_finding.to_json()) for asset in assets if asset.last_finding is not None]
    alarms = sorted(_all(lambda cursor: store.alarms(active=False, cursor=cursor)), key=_changed)
    news += [("alarm", alarm.to_json()) for alarm in {alarm.asset: alarm for alarm in alarms}.values()]
    for out in outs:
        for kind, payload in news:
            out.tell(kind, payload)


def _changed(alarm: Alarm) -> float:
    moments = (alarm.raised_at, alarm.cleared_at, alarm.acknowledged_at)
    return max((moment.timestamp() for moment in moments if moment is not None), default=0.0)


def _all(read: Callable[[str | None], Page[T]]) -> Iterator[T]:
    cursor = None
    while True:
        page = read(cursor)
        yield from page.items
        cursor = page.next_cursor
        if cursor is None:
            return
