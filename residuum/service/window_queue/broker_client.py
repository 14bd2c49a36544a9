"""A connection to the MQTT broker that comes back by itself."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Any

import structlog

from residuum.service.broker_address import BrokerAddress

log = structlog.get_logger()

_LONGEST_PAUSE = 10
_KEEP_ALIVE = 20

Take = Callable[[Any, Any], None]


def _nobody() -> None:
    """Told of something that nobody waits for."""


def broker_client(
    address: BrokerAddress,
    client_id: str,
    topics: Sequence[str],
    take: Take,
    connected: Callable[[], None],
    *,
    kept: bool,
    subscribed: Callable[[], None] = _nobody,
) -> Any:
    """A paho client whose network thread runs: subscribed (QoS 1) again after each break, messages acknowledged by hand.

    Parameters
    ----------
    address : BrokerAddress
    client_id : str
        One connection a name: a second one of the same name ends the first.
    topics : sequence of str
    take : callable
        Told of every message as (client, message), in the network thread.
    connected : callable
        Told of every new connection, before any message of it.
    kept : bool
        Whether the broker keeps messages for this client while it is away.
    subscribed : callable
        Told when the broker has taken the subscription of a new connection: what is published from then on comes.
    """
    client = address.client(client_id=client_id, clean_session=not kept, manual_ack=True)
    client.reconnect_delay_set(1, _LONGEST_PAUSE)

    def on_connect(client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            log.warning("the broker refuses us", broker=f"{address.host}:{address.port}", reason=str(reason))
            return
        connected()
        client.subscribe([(topic, 1) for topic in topics])

    def on_connect_fail(_client: Any, _data: Any) -> None:
        log.warning("the broker does not let us in", broker=f"{address.host}:{address.port}", reason=str(sys.exception()))

    client.on_connect, client.on_connect_fail = on_connect, on_connect_fail
    client.on_subscribe = lambda *_: subscribed()
    client.on_message = lambda client, _data, message: take(client, message)
    client.connect_async(address.host, address.port, keepalive=_KEEP_ALIVE)
    client.loop_start()
    return client
