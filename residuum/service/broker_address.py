"""Where an MQTT broker is, and what topics begin with."""

from __future__ import annotations

from typing import NamedTuple
from urllib.parse import urlsplit


class BrokerAddress(NamedTuple):
    """Where an MQTT broker is, and what topics begin with."""

    host: str
    port: int
    user: str | None
    password: str | None
    prefix: str


def broker_address(url: str) -> BrokerAddress:
    """The parts of `mqtt://[user:password@]host[:port][/prefix]`; ValueError when it is none.

    >>> broker_address("mqtt://broker/plant-7").port, broker_address("mqtt://broker/plant-7").prefix
    (1883, 'plant-7')
    """
    parts = urlsplit(url)
    if parts.scheme != "mqtt" or not parts.hostname or set(url) & set("#?") or "+" in parts.path:
        raise ValueError("must be mqtt://[user:password@]host[:port][/prefix]")
    return BrokerAddress(parts.hostname, parts.port or 1883, parts.username, parts.password, parts.path.strip("/") or "residuum")
