"""Records, and windows of records, from the histories that an address can name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import replace
from datetime import datetime, timedelta

from residuum.identification.errors import BadRecord
from residuum.identification.record import Record
from residuum.identification.record_formats.history import (
    Address,
    History,
    is_address_of,
    parse_address,
    split_address,
)
from residuum.identification.record_formats.options import ReadOptions
from residuum.late_members import LateMembers

_POSTGRES = ("residuum.identification.record_formats.postgres_history", "PostgresHistory")
_INFLUX = ("residuum.identification.record_formats.influx_history", "InfluxHistory")
_OPCUA = ("residuum.identification.record_formats.opcua_history", "read_opcua_history")
HISTORIES: Mapping[str, Callable[[], History]] = LateMembers(
    {
        "timescale": _POSTGRES,
        "postgresql": _POSTGRES,
        "postgres": _POSTGRES,
        "influx": _INFLUX,
        "influxs": _INFLUX,
    }
)
"""Scheme of an address → the history behind it."""
# scheme of servers that keep the history of nodes, which have no windows → what reads one
_NODES: Mapping[str, Callable[[str, ReadOptions], Record]] = LateMembers({"opc.tcp": _OPCUA})
_MOST_WINDOWS = 10_000_000  # whose addresses are made before the first is read


def is_history(path: object) -> bool:
    """Whether this names a table of a history, or nodes that keep one, rather than a file."""
    return is_address_of(path, (*HISTORIES, *_NODES))


def has_windows(path: object) -> bool:
    """Whether this names a table of a history, which can be read in windows."""
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
    nodes = split_address(address, tuple(_NODES))
    if nodes is not None:
        return _NODES[nodes.scheme](address, options)
    at = _parsed(address)
    if at.window or at.each:
        asked = "window" if at.window else "each"
        raise BadRecord(
            f"{at.shown}: {asked} asks for several records; leave it out, or give the address to"
            " `residuum rescore` or `residuum reidentify`"
        )
    with closing(HISTORIES[at.scheme]()) as history:
        return history.record(at, options)


def windows_of(address: str) -> list[str]:
    """The addresses of the windows in `start` … `end`, or in all that the table holds, for each
    value of the column `each` where one is named; without a password. The last window may be
    shorter.

    Raises
    ------
    BadRecord
        As `read_history`; no window's length; more than ten million windows.
    """
    at = _parsed(address)
    if at.window is None:
        raise BadRecord(f"{at.shown}: say how long a window is, in seconds: &window=600")
    with closing(HISTORIES[at.scheme]()) as history:
        start, end = _span(at, history)
        machines = [{}] if at.each is None else _machines(at, at.each, history)
    # rounded up: the last window may be shorter
    count = -((start - end) // at.window)
    if count * len(machines) > _MOST_WINDOWS:
        raise BadRecord(
            f"{at.shown}: holds {count * len(machines)} windows; at most {_MOST_WINDOWS}. Say a"
            " longer window, or a shorter time by start and end"
        )
    begins = [start + k * at.window for k in range(count)]
    whole = replace(at, window=None, each=None)
    return [
        replace(
            whole, where={**at.where, **machine}, start=begin, end=min(begin + at.window, end)
        ).without_secret
        for machine in machines
        for begin in begins
    ]


def _span(at: Address, history: History) -> tuple[datetime, datetime]:
    """From when to when windows are cut: as asked, else from the first to the last row."""
    if at.start is not None and at.end is not None:
        return at.start, at.end
    span = history.span(at)
    if span is None:
        raise BadRecord(f"{at.shown}: no rows in that time")
    # An end is no part of a record: the last row has to lie before it.
    return at.start or span[0], at.end or span[1] + timedelta(microseconds=1)


def _machines(at: Address, column: str, history: History) -> list[dict[str, str]]:
    """What rows of each machine must hold."""
    return [{column: value} for value in history.values_of(at, column)]


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

    def read(self, window: str) -> Record:
        """The record of a window's address, as `windows_of` gives it; raises as `read_history`."""
        at = replace(_parsed(window), server=self._at.server)
        return replace(self._history.record(at, ReadOptions()), source=at.without_secret)

    def close(self) -> None:
        """Let go of the connection; the next read opens another."""
        self._history.close()
