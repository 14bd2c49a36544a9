"""WindowMessage: a window and who is to judge it, as bytes."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple
from zlib import crc32

import msgpack
import numpy as np
import structlog

from residuum.identification.errors import BadInput
from residuum.nearest_names import known_names
from residuum.service.broker import BrokerAddress
from residuum.service.work.worker_pool import PlainRecord

# Where on the broker windows, receipts and the news of stored windows are.

PARTITIONS = 64
"""Parts into which the machines are divided; scorers share them, so there can be at most so
many.
"""


def partition_of(asset: str) -> int:
    """The partition of a machine, the same for ever.

    >>> partition_of("press-1") == partition_of("press-1") < PARTITIONS
    True
    """
    # not Python's hash, which is another one in each process
    return crc32(asset.encode()) % PARTITIONS


def window_topic(prefix: str, asset: str, gateway: str, key: str) -> str:
    """Where a window is published."""
    return f"{prefix}/windows/{partition_of(asset)}/{gateway}/{key}"


def windows_of_part(prefix: str, part: int, parts: int) -> list[str]:
    """What the scorer `part` (from 1) of so many subscribes to.

    >>> sum(len(windows_of_part("residuum", part, 2)) for part in (1, 2)) == PARTITIONS
    True
    """
    return [f"{prefix}/windows/{number}/+/+" for number in range(part - 1, PARTITIONS, parts)]


def receipt_topic(prefix: str, gateway: str) -> str:
    """Where a gateway is told which of its windows are stored."""
    return f"{prefix}/receipts/{gateway}"


def stored_topic(prefix: str) -> str:
    """Where services are told which windows scorers have stored."""
    return f"{prefix}/stored"


# A connection to the MQTT broker that comes back by itself.

log = structlog.get_logger()

# [s] Longest pause between two tries to reach the broker.
_LONGEST_PAUSE = 10
# [s] After which the client asks a silent broker whether it is there.
_KEEP_ALIVE = 20

Take = Callable[[Any, Any], None]


def _nobody() -> None:
    """Told of something that nobody waits for."""


class Listener(NamedTuple):
    """Who is told of what comes over a connection, in its network thread.

    Parameters
    ----------
    take : callable
        Told of every message as (client, message).
    connected : callable
        Told of every new connection, before any message of it.
    subscribed : callable
        Told when the broker has taken the subscription of a new connection: what is published from
        then on comes.
    """

    take: Take
    connected: Callable[[], None] = _nobody
    subscribed: Callable[[], None] = _nobody


def broker_client(
    address: BrokerAddress,
    client_id: str,
    topics: Sequence[str],
    listener: Listener,
    *,
    persistent: bool,
) -> Any:
    """A paho client whose network thread runs: subscribed (QoS 1) again after each break, messages
    acknowledged by hand.

    Parameters
    ----------
    address : BrokerAddress
    client_id : str
        One connection a name: a second one of the same name ends the first.
    topics : sequence of str
    listener : Listener
    persistent : bool
        Whether the session is: the broker then keeps messages for this client while it is away.
    """
    client = address.client(client_id=client_id, clean_session=not persistent, manual_ack=True)
    client.reconnect_delay_set(1, _LONGEST_PAUSE)

    def on_connect(client: Any, _data: Any, _flags: Any, reason: Any, _properties: Any) -> None:
        if reason.is_failure:
            log.warning(
                "the broker refuses us", broker=f"{address.host}:{address.port}", reason=str(reason)
            )
            return
        # first: what is told of a connection must not come behind its messages
        listener.connected()
        client.subscribe([(topic, 1) for topic in topics])

    def on_connect_fail(_client: Any, _data: Any) -> None:
        log.warning(
            "the broker does not let us in",
            broker=f"{address.host}:{address.port}",
            reason=str(sys.exception()),
        )

    client.on_connect, client.on_connect_fail = on_connect, on_connect_fail
    client.on_subscribe = lambda *_: listener.subscribed()
    client.on_message = lambda client, _data, message: listener.take(client, message)
    client.connect_async(address.host, address.port, keepalive=_KEEP_ALIVE)
    client.loop_start()
    return client


_VERSION = 1
_TYPES = ("<f4", "<f8")
MOST_CHANNELS = 256
ASSET_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._-]{0,63}")


@dataclass(frozen=True)
class WindowMessage:
    """A window of `asset`, to be judged by `diagnoser` with the stored baseline of the name
    `baseline`.

    `method` decides, where a diagnoser has two, unless another was chosen where the window is
    judged.
    """

    asset: str
    diagnoser: str
    baseline: str
    window: PlainRecord
    method: str | None = None

    def pack(self) -> bytes:
        """The message as bytes: MessagePack, samples little endian."""
        window = self.window
        channels = {name: _packed(signal) for name, signal in window.channels.items()}
        names = {
            "asset": self.asset,
            "diagnoser": self.diagnoser,
            "baseline": self.baseline,
            "source": window.source,
        }
        names |= {} if self.method is None else {"method": self.method}
        times = {"sample_time": window.sample_time, "t0": window.t0}
        packed: bytes = msgpack.packb(
            {
                "version": _VERSION,
                **names,
                **times,
                "channels": channels,
                "units": dict(window.units),
            }
        )
        return packed

    @classmethod
    def unpack(cls, payload: bytes) -> WindowMessage:
        """The message again; BadInput, in one line, when it is none. Nothing larger than the
        payload is allocated.
        """
        # what comes may be anybody's: whatever does not fit raises one of these below
        try:
            plain = msgpack.unpackb(payload)
            if plain["version"] != _VERSION:
                raise BadInput(
                    f"window message: is of version {plain['version']!r}; {_VERSION} is read here"
                )
            if len(plain["channels"]) > MOST_CHANNELS or len(plain["units"]) > MOST_CHANNELS:
                raise BadInput(
                    f"window message: {len(plain['channels'])} channels; at most {MOST_CHANNELS}"
                    " are read"
                )
            channels = {
                str(name): _unpacked(str(name), *packed)
                for name, packed in plain["channels"].items()
            }
            units = {str(name): str(unit) for name, unit in plain["units"].items()}
            window = PlainRecord(
                channels,
                units,
                float(plain["sample_time"]),
                float(plain["t0"]),
                str(plain["source"]),
            )
            message = cls(
                str(plain["asset"]),
                str(plain["diagnoser"]),
                str(plain["baseline"]),
                window,
                plain.get("method"),
            )
        except (ValueError, TypeError, KeyError, AttributeError, msgpack.UnpackException) as error:
            raise BadInput(
                f"window message: cannot be read: {type(error).__name__} {error}"
            ) from None
        if not ASSET_NAME.fullmatch(message.asset):
            raise BadInput(f"window message, asset: {message.asset[:40]!r} is no name of a machine")
        return message


def _packed(signal: Any) -> tuple[str, bytes]:
    # single precision stays so: half the bytes, and what buses deliver
    kind = "<f4" if np.asarray(signal).dtype == np.float32 else "<f8"
    return kind, np.ascontiguousarray(signal, kind).tobytes()


def _unpacked(name: str, kind: str, samples: bytes) -> Any:
    if kind not in _TYPES:
        raise BadInput(
            f"window message, channel {name[:40]!r}: samples are {kind!r};"
            f" {known_names(kind, _TYPES)}"
        )
    return np.frombuffer(samples, kind)
