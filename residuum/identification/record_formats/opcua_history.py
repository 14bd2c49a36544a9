"""Records from the history of an OPC UA server, by its address.

`opc.tcp://user@host:4840/path?nodes=ns=2;s=Speed,ns=2;s=Torque&start=2026-03-01&end=2026-03-08`
names nodes whose values the server keeps (OPC 10000-11, read raw). Each value comes with the time
stamp of its source and its status; one that is not good is missing.
"""

from __future__ import annotations

import logging
from collections.abc import Iterator, Sequence
from contextlib import suppress
from datetime import UTC, datetime
from importlib import import_module
from typing import Any

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadRecord, in_one_line
from residuum.identification.record import Record
from residuum.identification.record_formats.history import Address, HistoryAway
from residuum.identification.record_formats.loggers.logger_head import is_unit
from residuum.identification.record_formats.optional_package import need
from residuum.identification.record_formats.options import ReadOptions
from residuum.identification.record_formats.time_bases import TimedChannel, on_one_base

_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_EPOCH_WITHOUT_ZONE = datetime(1970, 1, 1)  # a stamp without zone cannot be taken from one with
_PATIENCE = 10  # [s] until a server that does not answer is given up
_PAGE = 10_000  # values that are asked for at a time: an answer of more is refused by many servers


class OpcUaHistory:
    """A server of OPC UA, asked in a session that stays open.

    Names and units of nodes are asked for once a session, not with each window.
    """

    def __init__(self) -> None:
        self._client: Any = None
        self._loop: Any = None
        self._nodes: dict[str, tuple[str, str]] = {}

    def close(self) -> None:
        """End the session; what is asked next opens another."""
        client, loop, self._client, self._loop = self._client, self._loop, None, None
        self._nodes = {}
        if client is not None:
            # of a session that the server has ended
            with suppress(Exception):
                client.disconnect()
        if loop is not None:
            loop.stop()

    def span(self, at: Address) -> tuple[datetime, datetime] | None:
        """From when to when, as the address says."""
        return None if at.start is None or at.end is None else (at.start, at.end)

    def values_of(self, at: Address, column: str) -> list[str]:
        """BadRecord: nodes have no column that tells their values apart."""
        raise BadRecord(f"{at.shown}: nodes have no column {column!r} to part values by")

    def record(self, at: Address, options: ReadOptions) -> Record:
        """The record of an address: its nodes on one even time base.

        A channel is called by its node's browse name, or by the node's id where two have the same;
        its unit is that of the node's engineering units. Times without a zone are taken as UTC.

        Raises
        ------
        BadRecord
            A server that refuses, a node that it has not, that has no history or holds no numbers,
            no values; as `on_one_base` for times that do not lie on one base.
        HistoryAway
            A server that does not answer.
        """
        return on_one_base(self._asked(at), at.shown, options)

    def _asked(self, at: Address) -> list[TimedChannel]:
        """The nodes' values; a session that has ended is opened anew."""
        ua = need("asyncua.ua", at.shown, "opcua")
        away = _away(ua)
        try:
            if self._client is not None:
                try:
                    return self._channels(at)
                except away:
                    self.close()
            self._connect(at)
            return self._channels(at)
        except BadRecord:  # a ValueError itself, which says already what is wrong
            raise
        except away as error:
            self.close()
            raise HistoryAway(f"{at.shown}: {in_one_line(error)}") from None
        except (ua.UaError, ValueError) as error:
            self.close()
            raise BadRecord(f"{at.shown}: {in_one_line(error)}") from None

    def _connect(self, at: Address) -> None:
        logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # what is wrong is raised, too
        sync = import_module("asyncua.sync")
        self._loop = sync.ThreadLoop()
        self._loop.daemon = True  # a process that ends does not wait for it
        self._loop.start()
        self._client = sync.Client(at.shown, timeout=_PATIENCE, tloop=self._loop)
        if at.server["user"]:
            self._client.set_user(at.server["user"])
            self._client.set_password(at.server["password"] or "")
        self._client.connect()

    def _channels(self, at: Address) -> list[TimedChannel]:
        for node in at.tags:
            if node not in self._nodes:
                known = self._client.get_node(node)
                self._nodes[node] = str(known.read_browse_name().Name), _unit(known)
        names = [self._nodes[node][0] for node in at.tags]
        return [
            self._channel(at, node, name if names.count(name) == 1 else node)
            for node, name in zip(at.tags, names, strict=True)
        ]

    def _channel(self, at: Address, node: str, name: str) -> TimedChannel:
        """The values of a node, in order of their sources' time stamps."""
        pages = [
            (
                np.array([_seconds(value.SourceTimestamp) for value in page]),
                _numbers(page, name, at),
            )
            for page in _pages(self._client.get_node(node), name, at)
        ]
        instants, values = (
            np.concatenate([np.empty(0), *part]) for part in zip(*pages, strict=True)
        )
        # half open, so that a value at `end` is in the next span alone
        start, end = (instant.timestamp() for instant in (at.start, at.end) if instant)
        within = (instants >= start) & (instants < end)
        if not within.any():
            raise BadRecord(f"{at.shown}: no values of {name!r} in that time")
        order = np.argsort(instants[within], kind="stable")
        return TimedChannel(
            name, self._nodes[node][1], instants[within][order], values[within][order]
        )


def _away(ua: Any) -> tuple[type[Exception], ...]:
    """What says that nobody answers, or that a session has ended."""
    names = (
        "BadConnectionClosed",
        "BadSessionIdInvalid",
        "BadSessionClosed",
        "BadSecureChannelIdInvalid",
        "BadSecureChannelClosed",
        "BadServerNotConnected",
        "BadTimeout",
        "BadCommunicationError",
    )
    return (OSError, *(getattr(ua.uaerrors, name) for name in names))


def _pages(node: Any, name: str, at: Address) -> Iterator[list[Any]]:
    """The values of a node with a time stamp of their source, so many at a time (OPC 10000-11,
    6.4.3: a server goes on from its continuation point).
    """
    ua = import_module("asyncua.ua")
    details = ua.ReadRawModifiedDetails(
        IsReadModified=False,
        StartTime=at.start,
        EndTime=at.end,
        NumValuesPerNode=_PAGE,
        ReturnBounds=False,
    )
    point = after = None
    while True:
        answer = node.history_read(details, point)
        answer.StatusCode.check()
        read = [
            value
            for value in answer.HistoryData.DataValues or ()
            if value.SourceTimestamp is not None
        ]
        yield [value for value in read if after is None or value.SourceTimestamp > after]
        before, point = (point, after), answer.ContinuationPoint
        if not point:
            # some servers cut an answer without saying that there is more
            if len(read) < _PAGE:
                return
            details.StartTime = after = read[-1].SourceTimestamp
        if (point, after) == before:
            raise BadRecord(f"{at.shown}: gives the same values of {name!r} again and again")


def _seconds(stamp: datetime) -> float:
    """Seconds since 1970; stamps without a zone are UTC, as the standard has them."""
    return (stamp - _EPOCH if stamp.tzinfo else stamp - _EPOCH_WITHOUT_ZONE).total_seconds()


def _numbers(stamped: Sequence[Any], name: str, at: Address) -> FloatArray:
    """Values as numbers, NaN where the status is not good."""
    numbers = [value.Value.Value if _is_good(value) else None for value in stamped]
    kinds = {type(number).__name__ for number in numbers}
    if no_numbers := kinds - {"bool", "int", "float", "NoneType"}:
        raise BadRecord(
            f"{at.shown}: {name!r} holds no numbers but {min(no_numbers)}; leave it out"
        )
    return np.array(numbers, dtype=np.float64)  # None becomes NaN


def _is_good(value: Any) -> bool:
    """A status that is not said is good (OPC 10000-6)."""
    return value.Value is not None and (value.StatusCode is None or value.StatusCode.is_good())


def _unit(node: Any) -> str:
    """The display name of the node's engineering units, where it has them."""
    ua = import_module("asyncua.ua")
    try:
        units = node.get_child("0:EngineeringUnits").read_value()
    except ua.UaError:
        return ""
    name = str(getattr(getattr(units, "DisplayName", None), "Text", None) or "")
    return name if is_unit(name) else ""
