"""Records from the history of an OPC UA server, by its address.

`opc.tcp://user@host:4840/path?nodes=ns=2;s=Speed,ns=2;s=Torque&start=2026-03-01&end=2026-03-08`
names nodes whose values the server keeps (OPC 10000-11, read raw). Each value comes with the time
stamp of its source and its status; one that is not good is missing.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any
from urllib.parse import parse_qsl, unquote

import numpy as np

from residuum.array_types import FloatArray
from residuum.identification.errors import BadRecord, in_one_line
from residuum.identification.record import Record
from residuum.identification.record_formats.history import instant_of, listed, split_address
from residuum.identification.record_formats.loggers.logger_head import is_unit
from residuum.identification.record_formats.optional_package import need
from residuum.identification.record_formats.options import ReadOptions
from residuum.identification.record_formats.time_bases import TimedChannel, on_one_base
from residuum.nearest_names import known_names

_SCHEMES = ("opc.tcp",)
_KEYS = ("nodes", "start", "end")
_EPOCH = datetime(1970, 1, 1, tzinfo=UTC)
_EPOCH_WITHOUT_ZONE = datetime(1970, 1, 1)  # a stamp without zone cannot be taken from one with
_PATIENCE = 10  # [s] until a server that does not answer is given up


@dataclass(frozen=True)
class Address:
    """Nodes of a server, and from when to when; `shown` is the server as messages repeat it."""

    shown: str
    user: str | None
    password: str | None
    nodes: tuple[str, ...]
    start: datetime
    end: datetime


def parse_address(text: str) -> Address:
    """The nodes that an address names.

    >>> at = parse_address("opc.tcp://me:secret@plant:4840/x?nodes=ns=2;s=Speed,i=85&start=2026-03-01&end=2026-03-02")
    >>> at.shown, at.nodes, at.start.isoformat()
    ('opc.tcp://plant:4840/x', ('ns=2;s=Speed', 'i=85'), '2026-03-01T00:00:00+00:00')

    Raises
    ------
    BadRecord
        No nodes, no start or no end in it; a start or end that is no date; a key that there is not.
    """
    parts = split_address(text, _SCHEMES)
    if parts is None:
        raise BadRecord(f"{text}: is no address of an OPC UA server")
    host = parts.netloc.rpartition("@")[2]
    shown = f"opc.tcp://{host}{parts.path}"
    asked = dict(parse_qsl(parts.query, keep_blank_values=True))
    for key in asked:
        if key not in _KEYS:
            raise BadRecord(f"{shown}: no key {key!r}; {known_names(key, _KEYS)}")
    nodes = listed(asked.get("nodes", ""))
    if not nodes:
        raise BadRecord(f"{shown}: name the nodes to read, ?nodes=ns=2;s=Speed,ns=2;s=Torque")
    start, end = (instant_of(asked.get(key, ""), key, shown) for key in ("start", "end"))
    if start is None or end is None:
        raise BadRecord(f"{shown}: say from when to when, &start=2026-03-01&end=2026-03-08")
    user, password = (part and unquote(part) for part in (parts.username, parts.password))
    return Address(shown, user, password, nodes, start, end)


def read_opcua_history(address: str, options: ReadOptions = ReadOptions()) -> Record:
    """The record of an address: its nodes on one even time base, from `start` to before `end`.

    A channel is called by its node's browse name, or by the node's id where two have the same; its
    unit is that of the node's engineering units. Times without a zone are taken as UTC.

    Raises
    ------
    BadRecord
        A server that does not answer or refuses, a node that it has not, that has no history or
        holds no numbers, no values; as `on_one_base` for times that do not lie on one base.
    """
    at = parse_address(address)
    sync = need("asyncua.sync", at.shown, "opcua")
    ua = need("asyncua.ua", at.shown, "opcua")
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)  # what is wrong is raised, too
    client = sync.Client(at.shown, timeout=_PATIENCE)
    try:
        if at.user:
            client.set_user(at.user)
            client.set_password(at.password or "")
        with client:
            names = [str(client.get_node(node).read_browse_name().Name) for node in at.nodes]
            channels = [
                _channel(client.get_node(node), name if names.count(name) == 1 else node, at, ua)
                for node, name in zip(at.nodes, names, strict=True)
            ]
    except BadRecord:  # a ValueError itself, which says already what is wrong
        raise
    except (ua.UaError, OSError, TimeoutError, ValueError) as error:
        raise BadRecord(f"{at.shown}: {in_one_line(error)}") from None
    return on_one_base(channels, at.shown, options)


def _channel(node: Any, name: str, at: Address, ua: Any) -> TimedChannel:
    """The values of a node, in order of their sources' time stamps."""
    history = node.read_raw_history(at.start, at.end, 0, False)
    stamped = [value for value in history if value.SourceTimestamp is not None]
    instants = np.array([_seconds(value.SourceTimestamp) for value in stamped])
    # half open, so that a value at `end` is in the next span alone
    within = (instants >= at.start.timestamp()) & (instants < at.end.timestamp())
    if not within.any():
        raise BadRecord(f"{at.shown}: no values of {name!r} in that time")
    values = _numbers(stamped, name, at)
    order = np.argsort(instants[within], kind="stable")
    return TimedChannel(name, _unit(node, ua), instants[within][order], values[within][order])


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


def _unit(node: Any, ua: Any) -> str:
    """The display name of the node's engineering units, where it has them."""
    try:
        units = node.get_child("0:EngineeringUnits").read_value()
    except ua.UaError:
        return ""
    name = str(getattr(getattr(units, "DisplayName", None), "Text", None) or "")
    return name if is_unit(name) else ""
