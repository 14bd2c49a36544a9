"""How settings name a CAN bus: `interface:channel`, as python-can has them."""

from __future__ import annotations

from typing import Any
from urllib.parse import urlsplit

from residuum.identification.errors import BadInput

# python-can's own default.
_MULTICAST_PORT = 43113


def bus_arguments(channel: str) -> dict[str, Any]:
    """What `can.Bus` is to be given; of `udp_multicast` the channel is `GROUP[:PORT][/HOPS]`.

    Raises BadInput for an address that is none.

    >>> bus_arguments("socketcan:can0")
    {'interface': 'socketcan', 'channel': 'can0'}
    >>> bus_arguments("udp_multicast:239.1.2.3:5000/1")
    {'interface': 'udp_multicast', 'channel': '239.1.2.3', 'port': 5000, 'hop_limit': 1}
    """
    interface, colon, address = channel.partition(":")
    if not (interface and colon and address):
        raise BadInput(
            f"CAN channel {channel!r}: must be interface:channel, for example socketcan:can0"
        )
    if interface != "udp_multicast":
        return {"interface": interface, "channel": address}
    group, port, hops = multicast_address(address)
    return {"interface": interface, "channel": group, "port": port, "hop_limit": hops}


def multicast_address(text: str) -> tuple[str, int, int]:
    """Group, port and hops of `GROUP[:PORT][/HOPS]`; an IPv6 group with a port stands in brackets.

    >>> multicast_address("239.1.2.3:5000/1"), multicast_address("[ff15::1]:5000")
    (('239.1.2.3', 5000, 1), ('ff15::1', 5000, 0))
    """
    address, _, hops = text.partition("/")
    # several colons and no brackets: an IPv6 group alone, whose last part is no port
    if address.count(":") > 1 and not address.startswith("["):
        address = f"[{address}]"
    try:
        parts = urlsplit(f"//{address}")
        return parts.hostname or "", parts.port or _MULTICAST_PORT, int(hops or 0)
    except ValueError:
        raise BadInput(
            f"CAN channel {text!r}: must be GROUP[:PORT][/HOPS] with whole numbers"
        ) from None
