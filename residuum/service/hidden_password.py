"""Addresses as they are shown: without the password of their user info."""

from __future__ import annotations

import re

_USER_INFO = re.compile(r"^([^/]*//)([^/?#]*)@")


def with_hidden_password(address: str) -> str:
    """`scheme://user:***@host…` for an address with a password; any other as it is.

    >>> with_hidden_password("mqtt://eva:secret@broker/plant")
    'mqtt://eva:***@broker/plant'
    """
    found = _USER_INFO.match(address)
    if found is None or ":" not in found[2]:
        return address
    return f"{found[1]}{found[2].partition(':')[0]}:***@{address[found.end() :]}"


def is_hidden(address: str) -> bool:
    """Whether the password of an address is the mark that stands for one."""
    found = _USER_INFO.match(address)
    return found is not None and found[2].partition(":")[2] == "***"
