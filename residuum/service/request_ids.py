"""Request ids: one a request, the caller's own or one of ours, in the answer, in every log line and in refusals."""

from __future__ import annotations

import re
import secrets
from collections.abc import Mapping, MutableMapping
from contextvars import ContextVar
from typing import Any

HEADER = "X-Request-ID"
_LOWER = HEADER.lower().encode()
_FORM = re.compile(rb"[A-Za-z0-9._:@/+=-]{1,128}")
_of_request: ContextVar[str | None] = ContextVar("request_id", default=None)


def begin_request(headers: Mapping[bytes, bytes]) -> tuple[bytes, bytes]:
    """Give the request that begins its id, for all that is done for it; returns the header that its answer carries.

    An id that the caller sends is taken when it is of up to 128 letters, digits and `._:@/+=-`: nothing that ends a log line.
    """
    sent = headers.get(_LOWER, b"")
    number = sent.decode("ascii") if _FORM.fullmatch(sent) else secrets.token_hex(8)
    _of_request.set(number)
    return _LOWER, number.encode("ascii")


def request_id() -> str | None:
    """The id of the request that is being answered, None outside of one."""
    return _of_request.get()


def add_request_id(_logger: Any, _method: str, line: MutableMapping[str, Any]) -> MutableMapping[str, Any]:
    """Put the id into a log line (a processor of structlog)."""
    if (number := _of_request.get()) is not None:
        line["request_id"] = number
    return line
