"""A span of time as people write it, and what was stored in it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

from residuum.identification.errors import BadInput
from residuum.service.store import Store, StoredFinding, StoredWindow

_MANY = 500
_MONTH = re.compile("[0-9]{4}-(0[1-9]|1[0-2])")


class Span(NamedTuple):
    """From `begin` until before `end`, both with their zone."""

    begin: datetime
    end: datetime


def span_of(begin: str, end: str) -> Span:
    """The span of two ISO 8601 times; a time without a zone is UTC. BadInput for what is none, or ends before it begins.

    >>> span_of("2026-11-01", "2026-11-02T12:00+01:00").end.isoformat()
    '2026-11-02T12:00:00+01:00'
    """
    span = Span(_moment("from", begin), _moment("to", end))
    if span.end <= span.begin:
        raise BadInput(f"from {begin!r}, to {end!r}: the end must lie after the begin")
    return span


def open_span(begin: str | None, end: str | None) -> tuple[datetime | None, datetime | None]:
    """The span of two ISO 8601 times either of which may be missing; BadInput as `span_of`."""
    if begin is not None and end is not None:
        return span_of(begin, end)
    return None if begin is None else _moment("from", begin), None if end is None else _moment("to", end)


def month_of(text: str) -> Span:
    """The month `YYYY-MM`, in UTC.

    >>> [moment.isoformat() for moment in month_of("2026-12")]
    ['2026-12-01T00:00:00+00:00', '2027-01-01T00:00:00+00:00']
    """
    try:
        if not _MONTH.fullmatch(text):
            raise ValueError
        begin = datetime(int(text[:4]), int(text[5:]), 1, tzinfo=UTC)
        return Span(begin, (begin + timedelta(days=32)).replace(day=1))
    except (ValueError, OverflowError):  # no such year, or its last month: the calendar ends with it
        raise BadInput(f"month {text[:40]!r}: must be YYYY-MM, for example 2026-11") from None


def findings_in(store: Store, asset: str, span: Span) -> Iterator[StoredFinding]:
    """All findings of an asset in a span, oldest first."""
    after = 0
    while found := store.findings_between(asset, *span, after=after, limit=_MANY):
        yield from found
        after = found[-1].id


def windows_in(store: Store, asset: str, span: Span) -> Iterator[StoredWindow]:
    """All windows of an asset in a span, oldest first."""
    after = 0
    while found := store.windows_between(asset, *span, after=after, limit=_MANY):
        yield from found
        after = found[-1].id


def _moment(name: str, text: str) -> datetime:
    try:
        read = datetime.fromisoformat(text)
        read = read if read.tzinfo else read.replace(tzinfo=UTC)
        read.astimezone(UTC)  # the database keeps UTC
    except (ValueError, OverflowError):  # no time, or one that lies before or after the calendar in UTC
        raise BadInput(f"{name} {text[:40]!r}: must be a time like 2026-11-25 or 2026-11-25T08:00+01:00") from None
    return read
