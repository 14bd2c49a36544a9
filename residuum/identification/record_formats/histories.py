"""Records, and windows of records, from the histories that an address can name."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from typing import overload

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.history import (
    OPCUA,
    Address,
    History,
    is_address_of,
    parse_address,
)
from residuum.identification.record_formats.loggers.no_value import without_marks, without_overloads
from residuum.identification.record_formats.options import ReadOptions
from residuum.late_members import LateMembers

_POSTGRES = ("residuum.identification.record_formats.postgres_history", "PostgresHistory")
_INFLUX = ("residuum.identification.record_formats.influx_history", "InfluxHistory")
_OPCUA = ("residuum.identification.record_formats.opcua_history", "OpcUaHistory")
HISTORIES: Mapping[str, Callable[[], History]] = LateMembers(
    {
        "timescale": _POSTGRES,
        "postgresql": _POSTGRES,
        "postgres": _POSTGRES,
        "influx": _INFLUX,
        "influxs": _INFLUX,
        OPCUA: _OPCUA,
    }
)
"""Scheme of an address → the history behind it."""
_MOST_WINDOWS = 10_000_000  # more come of a length in other units than seconds


def is_history(path: object) -> bool:
    """Whether this names a table of a history, or nodes that keep one, rather than a file."""
    return is_address_of(path, tuple(HISTORIES))


def _parsed(address: str) -> Address:
    return parse_address(address, tuple(HISTORIES))


def read_history(address: str, options: ReadOptions = ReadOptions()) -> Record:
    """The record of an address: its tags on one even time base, from `start` to before `end`.

    Raises
    ------
    BadRecord
        A server that refuses, no such table, column or tag, no rows; as `on_one_base` for times
        that do not lie on one base; windows, which are several records.
    HistoryAway
        A server that does not answer.
    """
    at = _parsed(address)
    if at.window or at.each:
        asked = "window" if at.window else "each"
        raise BadRecord(
            f"{at.shown}: {asked} asks for several records; leave it out, or give the address to"
            " `residuum rescore` or `residuum reidentify`"
        )
    with closing(HISTORIES[at.scheme]()) as history:
        return _cleaned(history.record(at, options), options)


def _cleaned(record: Record, options: ReadOptions) -> Record:
    """The record without what stands for no value, as files are read."""
    return without_overloads(without_marks(record, options.missing))


@dataclass(frozen=True)
class Windows(Sequence[str]):
    """The addresses of windows, by machine, oldest first, without a password.

    Each is made when it is asked for: those of a year of many machines would fill the memory.
    """

    history: Address
    begin: datetime
    end: datetime
    length: timedelta
    machines: Sequence[str | None]

    @property
    def _of_each(self) -> int:
        """Windows of a machine, rounded up: the last one may be shorter."""
        return -((self.begin - self.end) // self.length)

    def __len__(self) -> int:
        return self._of_each * len(self.machines)

    @overload
    def __getitem__(self, place: int) -> str: ...

    @overload
    def __getitem__(self, place: slice) -> list[str]: ...

    def __getitem__(self, place: int | slice) -> str | list[str]:
        places = range(len(self))[place]
        return self._name(places) if isinstance(places, int) else [*map(self._name, places)]

    def _name(self, place: int) -> str:
        machine, number = divmod(place, self._of_each)
        begin = self.begin + number * self.length
        at = replace(
            self.history,
            start=begin,
            end=min(begin + self.length, self.end),
            where={**self.history.where, **self._rows_of(self.machines[machine])},
        )
        return at.without_secret

    def _rows_of(self, machine: str | None) -> dict[str, str]:
        """What rows of a machine must hold."""
        each = self.history.each
        return {} if each is None or machine is None else {each: machine}

    def place_of(self, name: str) -> int | None:
        """The place of a window's address; None where it is none of these."""
        try:
            at = _parsed(name)
        except BadRecord:
            return None
        machine = None if self.history.each is None else at.where.get(self.history.each)
        if machine not in self.machines or at.start is None:
            return None
        number = (at.start - self.begin) // self.length
        place = self.machines.index(machine) * self._of_each + number
        return place if 0 <= place < len(self) and self[place] == name else None

    def __contains__(self, name: object) -> bool:
        return isinstance(name, str) and self.place_of(name) is not None


def windows_of(address: str, machines: Sequence[str] | None = None) -> Windows:
    """The addresses of the windows in `start` … `end`, or in all that the table holds, for each
    value of the column `each` where one is named (all that it holds, or those of `machines`);
    without a password. The last window may be shorter.

    Raises
    ------
    BadRecord
        As `read_history`; no window's length; more than ten million windows.
    """
    at = _parsed(address)
    if at.window is None:
        raise BadRecord(f"{at.shown}: say how long a window is, in seconds: &window=600")
    with closing(HISTORIES[at.scheme]()) as history:
        begin, end = _span(at, history)
        windows = Windows(at, begin, end, at.window, _machines(at, history, machines))
    if len(windows) > _MOST_WINDOWS:
        raise BadRecord(
            f"{at.shown}: holds {len(windows)} windows; at most {_MOST_WINDOWS}. Say a longer"
            " window, or a shorter time by start and end"
        )
    return windows


def _span(at: Address, history: History) -> tuple[datetime, datetime]:
    """From when to when windows are cut: as asked, else from the first to the last row."""
    if at.start is not None and at.end is not None:
        return at.start, at.end
    span = history.span(at)
    if span is None:
        raise BadRecord(f"{at.shown}: no rows in that time")
    # An end is no part of a record: the last row has to lie before it.
    return at.start or span[0], at.end or span[1] + timedelta(microseconds=1)


def _machines(
    at: Address, history: History, machines: Sequence[str] | None
) -> Sequence[str | None]:
    if at.each is None:
        return [None]
    return history.values_of(at, at.each) if machines is None else machines


class HistoryReader:
    """Windows of one history, read one by one over a connection that stays open.

    Parameters
    ----------
    address : str
        Of the history, with its password where it needs one.
    """

    def __init__(self, address: str) -> None:
        self._at = _parsed(address)
        self._history = HISTORIES[self._at.scheme]()

    @property
    def shown(self) -> str:
        """The table, as messages repeat it."""
        return self._at.shown

    @property
    def each(self) -> str | None:
        """The column that parts rows by machine."""
        return self._at.each

    @property
    def window(self) -> float:
        """[s] How long a window is; 0 where the address does not say."""
        return self._at.window.total_seconds() if self._at.window else 0.0

    def machine_of(self, window: str) -> str | None:
        """What the column `each` holds in a window's rows; None where its address does not say."""
        if not is_history(window) or self._at.each is None:
            return None
        return _parsed(window).where.get(self._at.each)

    def read(self, window: str, options: ReadOptions = ReadOptions()) -> Record:
        """The record of a window's address, as `windows_of` gives it; raises as `read_history`."""
        at = replace(_parsed(window), server=self._at.server)
        record = _cleaned(self._history.record(at, options), options)
        return replace(record, source=at.without_secret)

    def close(self) -> None:
        """Let go of the connection; the next read opens another."""
        self._history.close()
