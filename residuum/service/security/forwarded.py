"""Who asks, and by which name and scheme, where a proxy that ends TLS stands in front of the
service.
"""

from __future__ import annotations

import ipaddress
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from urllib.parse import urlsplit

Network = ipaddress.IPv4Network | ipaddress.IPv6Network


@dataclass(frozen=True)
class Client:
    """The address of the client, and the scheme by which it came."""

    address: str
    scheme: str


class TrustedProxies:
    """Believes what proxies of these networks say of their clients, and nobody else.

    >>> proxies = TrustedProxies(["127.0.0.1", "10.0.0.0/8"])
    >>> proxies.client("127.0.0.1", "http", b"6.6.6.6, 192.0.2.7, 10.1.1.1", b"https")
    Client(address='192.0.2.7', scheme='https')
    >>> proxies.client("192.0.2.7", "http", b"127.0.0.1", b"https")
    Client(address='192.0.2.7', scheme='http')
    """

    def __init__(self, networks: Sequence[str]) -> None:
        self._networks = tuple(ipaddress.ip_network(network, strict=False) for network in networks)
        self._is_one = lru_cache(maxsize=1024)(self._looked_up)

    def client(
        self, peer: str, scheme: str, forwarded_for: bytes, forwarded_proto: bytes
    ) -> Client:
        """Who asks: the last address of `X-Forwarded-For` that is no trusted proxy's; what stands
        left of it anybody may say.
        """
        if not self.trusts(peer):
            return Client(peer, scheme)
        # from the right: each proxy has written the address that came to it behind the others
        address = peer
        for hop in reversed(forwarded_for.decode("latin-1").split(",")):
            hop = hop.strip()
            if not _is_address(hop):
                break
            address = hop
            if not self._is_one(hop):
                break
        # of several, what the proxy next to us says
        proto = forwarded_proto.decode("latin-1").rsplit(",", 1)[-1].strip().lower()
        return Client(address, proto if proto in ("http", "https") else scheme)

    def trusts(self, peer: str) -> bool:
        """Whether this is the address of a trusted proxy."""
        return bool(self._networks) and self._is_one(peer)

    def _looked_up(self, address: str) -> bool:
        try:
            return any(ipaddress.ip_address(address) in network for network in self._networks)
        except ValueError:
            return False


def _is_address(text: str) -> bool:
    try:
        ipaddress.ip_address(text)
    except ValueError:
        return False
    return True


def origin_of(url: str) -> str:
    """Scheme, name and port of an address as a browser writes an `Origin`: no port where it is the
    scheme's own.

    >>> origin_of("https://Plant.example:443/")
    'https://plant.example'
    """
    parts = urlsplit(url)
    own = {"http": 80, "https": 443}.get(parts.scheme)
    name = f"[{parts.hostname}]" if ":" in (parts.hostname or "") else parts.hostname or ""
    return f"{parts.scheme}://{name}" + (f":{parts.port}" if parts.port not in (None, own) else "")
