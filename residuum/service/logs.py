"""Structured logs: one event a line, for people or as JSON; lines of libraries and of the HTTP
server in the same form.
"""

from __future__ import annotations

import logging
import re
import secrets
import sys
from collections.abc import Mapping, MutableMapping
from contextvars import ContextVar
from typing import Any

import structlog
from structlog.typing import Processor

from residuum.service.settings import Settings

# Request ids: one a request, the caller's own or one of ours, in the answer, in every log line
# and in refusals.

HEADER = "X-Request-ID"
_LOWER = HEADER.lower().encode()
_FORM = re.compile(rb"[A-Za-z0-9._:@/+=-]{1,128}")
_of_request: ContextVar[str | None] = ContextVar("request_id", default=None)


def begin_request(headers: Mapping[bytes, bytes]) -> tuple[bytes, bytes]:
    """Give the request that begins its id, for all that is done for it; returns the header that its
    answer carries.

    An id that the caller sends is taken when it is of up to 128 letters, digits and `._:@/+=-`:
    nothing that ends a log line.
    """
    # a caller's id joins its log to ours; what could end a line, or fill the log, is not taken
    sent = headers.get(_LOWER, b"")
    number = sent.decode("ascii") if _FORM.fullmatch(sent) else secrets.token_hex(8)
    _of_request.set(number)
    return _LOWER, number.encode("ascii")


def request_id() -> str | None:
    """The id of the request that is being answered, None outside of one."""
    return _of_request.get()


def add_request_id(
    _logger: Any, _method: str, line: MutableMapping[str, Any]
) -> MutableMapping[str, Any]:
    """Put the id into a log line (a processor of structlog)."""
    number = _of_request.get()
    if number is not None:
        line["request_id"] = number
    return line


_COMMON: list[Processor] = [
    structlog.contextvars.merge_contextvars,
    add_request_id,
    structlog.processors.add_log_level,
    structlog.processors.TimeStamper(fmt="iso", utc=True),
]


class _StandardError(logging.StreamHandler[Any]):
    """Standard error as it is when a line comes: it may be redirected, and what it was before may
    be closed by then.
    """

    def __init__(self) -> None:
        logging.Handler.__init__(self)

    @property
    def stream(self) -> Any:
        """Where the line goes."""
        return sys.stderr


def set_up_logs(settings: Settings) -> None:
    """Send log lines to standard error in the chosen form: ours from the chosen severity,
    libraries' from warnings on.
    """
    as_json = settings.log_format == "json"
    form: Processor = (
        structlog.processors.JSONRenderer()
        if as_json
        else structlog.dev.ConsoleRenderer(colors=False)
    )
    structlog.configure(
        processors=[*_COMMON, structlog.processors.format_exc_info, form],
        wrapper_class=structlog.make_filtering_bound_logger(
            getattr(logging, settings.log_level.upper())
        ),
        # looked up a line: standard error may be redirected later
        logger_factory=lambda *_: structlog.PrintLogger(sys.stderr),
        cache_logger_on_first_use=False,
    )
    lines = structlog.stdlib.ProcessorFormatter(
        foreign_pre_chain=[*_COMMON, structlog.stdlib.add_logger_name],
        processors=[
            structlog.stdlib.ProcessorFormatter.remove_processors_meta,
            structlog.processors.format_exc_info,
            form,
        ],
    )
    handler = _StandardError()
    handler.setFormatter(lines)
    handler.setLevel(logging.WARNING)
    # a service that is started twice in one process (tests) writes each line once
    foreign = [known for known in logging.root.handlers if not isinstance(known, _StandardError)]
    logging.root.handlers[:] = [*foreign, handler]
