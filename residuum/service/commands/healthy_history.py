"""Healthy windows of a machine out of its history: what `watch train --from` sends to the service."""

from __future__ import annotations

import json
import zipfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np

from residuum.identification.errors import BadInput, BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.histories import (
    HistoryReader,
    is_history,
    windows_of,
)
from residuum.identification.record_formats.history import HistoryAway
from residuum.identification.record_formats.npz import write_npz
from residuum.service.commands.records import Reading
from residuum.service.commands.report import progress
from residuum.service.commands.running_service import answered, ask

WHOLE = 0.99
"""Part of a window that its samples have to last: the last one of a span is shorter."""


def span_of(text: str) -> tuple[datetime, datetime]:
    """From when to before when `BEGIN..END` lasts: each a month, a day or an instant, of UTC where
    no zone is said; the last month or day belongs to it.

    >>> [f"{instant:%Y-%m-%d %H:%M}" for instant in span_of("2026-03..2026-05")]
    ['2026-03-01 00:00', '2026-06-01 00:00']
    >>> [f"{instant:%Y-%m-%d %H:%M}" for instant in span_of("2026-03-01T06:00..2026-03-02")]
    ['2026-03-01 06:00', '2026-03-03 00:00']

    Raises
    ------
    BadInput
        Another text, or an end before the begin.
    """
    begin, _, end = text.partition("..")
    try:
        first, last = _instant(begin), _instant(end)
    except ValueError:
        raise BadInput(
            f"--healthy {text!r}: must be BEGIN..END, each a month, a day or an instant, as"
            " 2026-03..2026-05 or 2026-03-01T06:00..2026-03-08"
        ) from None
    if len(end) == len("2026-03"):
        last = (last + timedelta(days=31)).replace(day=1)
    elif len(end) == len("2026-03-01"):
        last += timedelta(days=1)
    if last <= first:
        raise BadInput(f"--healthy {text!r}: ends before it begins")
    return first, last


def _instant(text: str) -> datetime:
    instant = datetime.fromisoformat(f"{text}-01" if len(text) == len("2026-03") else text)
    return instant if instant.tzinfo else instant.replace(tzinfo=UTC)


@dataclass(frozen=True)
class Lent:
    """Records that the service has for a training alone, and where they are from."""

    records: list[int]
    says: list[str]


@contextmanager
def lent_windows(
    url: str, machine: str, sources: Sequence[str], healthy: str | None, reading: Reading
) -> Iterator[Lent]:
    """Healthy windows of histories and files, sent to the service as records, and taken from it in
    the end: a training has read them by then, and who lent them has them.
    """
    lent = Lent([], [])
    if not sources and (healthy is not None or reading != Reading()):
        raise BadInput("--healthy, --map and how files are read are said of --from; it is missing")
    if healthy is not None and not any(map(is_history, sources)):
        raise BadInput(
            "--healthy: says when a history was healthy, and --from names none; a record file is"
            " healthy as a whole"
        )
    try:
        if sources:
            _lend_all(lent, url, machine, sources, healthy, reading)
        yield lent
    finally:
        for number in lent.records:
            answered(url, f"/records/{number}", method="DELETE")


def _lend_all(
    lent: Lent,
    url: str,
    machine: str,
    sources: Sequence[str],
    healthy: str | None,
    reading: Reading,
) -> None:
    watched = ask(url, f"/assets/{machine}/machine")
    # as many as a training takes, of each its part
    most = watched["learned_from_at_most"] // len(sources)
    for source in sources:
        if not is_history(source):
            _lend(lent, url, machine, reading.named([Path(source)])[0])
            lent.says.append(source)
            continue
        address = _asked(source, watched["settings"]["window"], healthy)
        windows = windows_of(address)
        evenly = np.linspace(0, len(windows) - 1, min(most, len(windows)))
        places = [windows[int(place)] for place in np.unique(evenly.round())]
        before = len(lent.records)
        for record in _whole(address, places, reading):
            progress(f"reading {record.source}", (len(lent.records) - before) / len(places))
            _lend(lent, url, machine, record)
        taken = len(lent.records) - before
        others = f"; {len(places) - taken} more are not whole" if taken < len(places) else ""
        lent.says.append(
            f"{windows.history.without_secret}: {taken} of {len(windows)} windows, spread evenly"
            f"{others}"
        )


def _lend(lent: Lent, url: str, machine: str, record: Record) -> None:
    write_npz(record, content := BytesIO(), zipfile.ZIP_STORED)
    name = f"{machine}-{len(lent.records) + 1}.npz"
    stored = json.loads(answered(url, f"/records?filename={name}", content.getvalue()))
    lent.records.append(stored["id"])


def _whole(address: str, places: Sequence[str], reading: Reading) -> Iterator[Record]:
    """The records of the windows that have rows and do not end early; BadRecord where none does."""
    refused, whole = None, 0
    with closing(HistoryReader(address)) as history:
        for place in places:
            try:
                record = history.read(place, reading.options)
            except HistoryAway:
                raise
            except BadRecord as error:
                refused = refused or error
                continue
            if record.duration >= WHOLE * history.window:
                whole += 1
                yield reading.renamed(record)
    if refused is not None and not whole:
        raise refused


def _asked(address: str, window: Mapping[str, Any], healthy: str | None) -> str:
    """The address with the length of the machine's windows and the healthy span, where it does not
    say them itself.

    Raises
    ------
    BadInput
        A begin or an end that is said twice; windows of several machines; those of a machine that
        are cut by what it does.
    """
    keys = {part.partition("=")[0] for part in address.partition("?")[2].split("&")}
    if "each" in keys:
        raise BadInput("--from: has windows of several machines; say one, as &machine=press-1")
    if "window" not in keys and window["cut"] != "sliding":
        raise BadInput(
            f"--from: windows of the machine are cut by {window['cut']}, which a history does not"
            " tell; give record files of one each, or say a length [s], as &window=10"
        )
    more = [] if "window" in keys else [f"window={window['length']:g}"]
    if healthy is not None:
        if keys & {"start", "end"}:
            raise BadInput(
                "--healthy: the address of --from says start or end itself; leave one of them out"
            )
        begin, end = (instant.astimezone(UTC) for instant in span_of(healthy))
        more += [f"start={begin:%Y-%m-%dT%H:%M:%SZ}", f"end={end:%Y-%m-%dT%H:%M:%SZ}"]
    return "&".join([address if "?" in address else f"{address}?", *more]).replace("?&", "?")
