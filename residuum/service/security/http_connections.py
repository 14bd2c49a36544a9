"""HTTP connections within bounds: none holds a place without moving on, and strangers take none
from who has shown a key.
"""

from __future__ import annotations

import asyncio
import fcntl
import ipaddress
import resource
import socket
import ssl
import struct
import termios
from collections import OrderedDict
from collections.abc import Callable
from functools import partial
from typing import Any

from starlette.types import Message, Receive, Scope, Send
from uvicorn.protocols.http.h11_impl import H11Protocol

from residuum.service.security.forwarded import TrustedProxies
from residuum.service.settings import Settings

MOVES_WITHIN = 10.0
"""Seconds in which a connection must move on: ask to the end of a head, or send or take
`LEAST_RATE` of a body.
"""
LEAST_RATE = 1024.0
"""Bytes a second of a body that is waited for, and of an answer that waits to be taken."""
HANDSHAKE_WITHIN = 5.0
"""Seconds for a TLS handshake."""
MOST_STRANGERS = 1000
"""Connections that have shown no key, each of which may hold some hundred kB of an answer."""
# Addresses from which a key has been shown that are remembered.
_MOST_ACQUAINTED = 10_000
# Bytes of an answer that wait in a connection, beside those that TLS and the system keep, before no
# more is made.
_UNSENT = 2**16
KNOWN = "residuum.known"
"""What the scope of a request holds under this name is called when its caller has shown a key."""


def most_connections() -> int:
    """Half of the files that this process may open: the others are for the database, blocks and
    workers.

    >>> 0 < most_connections() <= resource.getrlimit(resource.RLIMIT_NOFILE)[0]
    True
    """
    return max(1, min(resource.getrlimit(resource.RLIMIT_NOFILE)[0], 2**16) // 2)


class Places:
    """Who holds a connection: so many in all, of which strangers leave half to those who have shown
    a key.

    A stranger for whom no place is left takes that of the stranger who has been there for longest:
    of its own address, where that has as many as it may, else of an address from which no key has
    been shown. So sources and pages, which are strangers until their first request is read, have
    the time for it.

    Parameters
    ----------
    most : int
        Connections.
    per_address : int
        Connections of strangers of one address (one network of 64 bits by IPv6); a trusted proxy
        has as many as all.
    proxies : TrustedProxies
        Whose address stands for many.
    """

    def __init__(self, most: int, per_address: int, proxies: TrustedProxies) -> None:
        self._most, self._per_address, self._proxies = most, per_address, proxies
        self._strangers_most = max(1, min(most // 2, MOST_STRANGERS))
        self._count = 0
        self._strangers: OrderedDict[BoundedConnection, str] = OrderedDict()
        self._of_address: dict[str, OrderedDict[BoundedConnection, None]] = {}
        self._acquainted: OrderedDict[str, None] = OrderedDict()

    def take(self, connection: BoundedConnection, address: str) -> None:
        """Give a stranger a place, which may be that of another one, or none."""
        where = _network(address)
        self._count += 1
        self._strangers[connection] = where
        neighbours = self._of_address.setdefault(where, OrderedDict())
        neighbours[connection] = None
        # before the bound of all: many connections from one address must not push others out
        if len(neighbours) > self._per_address and not self._proxies.trusts(address):
            next(iter(neighbours)).give_up()
        elif len(self._strangers) > self._strangers_most or self._count > self._most:
            oldest = next(iter(self._strangers))
            next(
                (
                    stranger
                    for stranger, of in self._strangers.items()
                    if of not in self._acquainted
                ),
                oldest,
            ).give_up()

    def know(self, connection: BoundedConnection) -> None:
        """It has shown a key, and is no stranger any more."""
        where = self._strangers.get(connection)
        if where is not None:
            self._acquainted[where] = None
            self._acquainted.move_to_end(where)
            if len(self._acquainted) > _MOST_ACQUAINTED:
                self._acquainted.popitem(last=False)
            self._forget(connection)

    def leave(self, connection: BoundedConnection) -> None:
        """Its place is free."""
        self._forget(connection)
        self._count -= 1

    def _forget(self, connection: BoundedConnection) -> None:
        where = self._strangers.pop(connection, None)
        if where is not None:
            neighbours = self._of_address[where]
            del neighbours[connection]
            if not neighbours:
                del self._of_address[where]


def bounded_connections(settings: Settings) -> Callable[..., BoundedConnection]:
    """What makes the connections of a service, for uvicorn's `http`; by TLS where there is a
    certificate.

    Raises OSError (ssl.SSLError) for files that are no certificate with its key.
    """
    tls = None
    if settings.tls_certificate is not None:
        tls = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        tls.load_cert_chain(settings.tls_certificate, settings.tls_key)
    proxies = TrustedProxies(settings.trusted_proxies)
    return partial(
        BoundedConnection,
        Places(most_connections(), settings.connections_per_address, proxies),
        tls,
    )


class BoundedConnection(H11Protocol):
    """A connection that is closed when it does not move on, or when its place is another's.

    Without this a client that sends heads a byte at a time, stops in a handshake or never takes its
    answer has a place for ever, and some hundreds of them have all. A handshake is ours, not
    uvicorn's, for it takes a place, too.
    """

    def __init__(self, places: Places, tls: ssl.SSLContext | None, /, **uvicorns: Any) -> None:
        super().__init__(**uvicorns)
        self._places, self._tls = places, tls
        self._raw: asyncio.Transport
        self._handshake: asyncio.Task[None] | None = None
        self._before_it_began = b""
        self._here = False
        self._wants_body = False
        self._received = 0
        self._seen = 0, 0, False
        self._deadline: asyncio.TimerHandle | None = None
        inner = self.app

        async def with_place(scope: Scope, receive: Receive, send: Send) -> None:
            async def waited_for() -> Message:
                self._wants_body = True
                try:
                    return await receive()
                finally:
                    self._wants_body = False

            scope[KNOWN] = self._become_known
            await inner(scope, waited_for, send)

        self.app = with_place

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Take a place, and begin with the handshake where there is one."""
        self._raw, self._here = transport, True
        self._places.take(self, str((transport.get_extra_info("peername") or ("unknown",))[0]))
        if self._tls is None or not self._here:
            self._begin(transport)
        else:
            # what comes belongs to the handshake, and must not be read as HTTP
            transport.pause_reading()
            self._handshake = self.loop.create_task(self._by_tls(transport, self._tls))

    async def _by_tls(self, transport: asyncio.Transport, tls: ssl.SSLContext) -> None:
        try:
            safe = await self.loop.start_tls(
                transport,
                self,
                tls,
                server_side=True,
                ssl_handshake_timeout=HANDSHAKE_WITHIN,
                ssl_shutdown_timeout=HANDSHAKE_WITHIN,
            )
        except (OSError, asyncio.CancelledError):
            # no client of TLS, or one that went or was sent away
            transport.abort()
            self._leave()
            return
        if safe is None or not self._here:
            return
        safe.set_write_buffer_limits(_UNSENT)
        self._begin(safe)
        if self._before_it_began:
            self.data_received(self._before_it_began)

    def _begin(self, transport: asyncio.Transport) -> None:
        super().connection_made(transport)
        self._watch()

    def data_received(self, data: bytes) -> None:
        """Read on."""
        if self.transport is None:  # it came in one piece with the end of the handshake
            self._before_it_began += data
            return
        self._received += len(data)
        before = self.cycle
        super().data_received(data)
        # a head that is read to its end is progress; its single bytes are none
        if self.cycle is not before:
            self._watch()

    def on_response_complete(self) -> None:
        """Wait for the next request."""
        super().on_response_complete()
        self._watch()

    def pause_writing(self) -> None:
        """Wait for the client to take what was answered."""
        super().pause_writing()
        self._watch()

    def connection_lost(self, exc: Exception | None) -> None:
        """Nothing is waited for any more."""
        self._leave()
        if self.transport is not None:
            super().connection_lost(exc)

    def give_up(self) -> None:
        """Close it at once; its place is free."""
        self._leave()
        # else the system keeps it, and a name for it, for minutes
        if self.transport is not None and self._unsent():
            self._raw.get_extra_info("socket").setsockopt(
                socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0)
            )
        self._raw.abort()

    def _leave(self) -> None:
        if self._here:
            self._here = False
            self._places.leave(self)
        if self._deadline is not None:
            self._deadline.cancel()

    def _become_known(self) -> None:
        if self._here:
            self._places.know(self)

    def _watch(self) -> None:
        """From now on the next step is waited for."""
        if self._deadline is not None:
            self._deadline.cancel()
        if self._here:
            self._seen = self._received, self._unsent(), self._wants_body
            self._deadline = self.loop.call_later(MOVES_WITHIN, self._look)

    def _look(self) -> None:
        if self._holds_up():
            self.give_up()
        else:
            self._watch()

    def _holds_up(self) -> bool:
        """Whether the client alone keeps this connection from moving on; what the service does may
        take its time.
        """
        least = LEAST_RATE * MOVES_WITHIN
        received, unsent_before, wanted_body = self._seen
        unsent = self._unsent()
        takes = unsent_before - unsent >= least
        # between requests: a client that still takes the last answer moves on
        if self.cycle is None or self.cycle.response_complete:
            return not (takes or (unsent_before and not unsent))
        if self.flow.write_paused:
            return not takes
        return wanted_body and self._wants_body and self._received - received < least

    def _unsent(self) -> int:
        """Bytes of answers that the client's system has not confirmed: in the transports, and in
        our system's queue.
        """
        connected: socket.socket | None = self._raw.get_extra_info("socket")
        if connected is None or connected.fileno() < 0:
            return 0
        queued: int = struct.unpack(
            "i", fcntl.ioctl(connected.fileno(), termios.TIOCOUTQ, bytes(4))
        )[0]
        return queued + sum(link.get_write_buffer_size() for link in {self._raw, self.transport})


def _network(address: str) -> str:
    """An address, or of one by IPv6 the network: whoever has one there has all.

    >>> _network("192.0.2.7"), _network("2001:db8::1"), _network("::ffff:192.0.2.7")
    ('192.0.2.7', '2001:db8::/64', '192.0.2.7')
    """
    try:
        known = ipaddress.ip_address(address.split("%", maxsplit=1)[0])
    except ValueError:
        return address
    if isinstance(known, ipaddress.IPv6Address):
        return str(known.ipv4_mapped or ipaddress.ip_network((known, 64), strict=False))
    return address
