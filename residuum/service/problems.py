"""Every refusal as an RFC 9457 problem document, with one line that says what, where and which
rule.
"""

from __future__ import annotations

import re
from http import HTTPStatus
from typing import Any

import orjson
import structlog
from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from starlette.exceptions import HTTPException
from starlette.requests import ClientDisconnect
from starlette.responses import Response

from residuum.identification.errors import BadInput, Forbidden
from residuum.library.questions import refusal
from residuum.service.alarms.alarm_states import IllegalTransition
from residuum.service.body_errors import BadBody, TooLarge, UnsupportedBody
from residuum.service.logs import HEADER, request_id
from residuum.service.memory_budget import TooBusy
from residuum.service.remedies_over_http import SaidToClients
from residuum.service.store import Conflict, NotFound, SignalLetGo, StorageUnavailable
from residuum.service.work.jobs import TooManyJobs

log = structlog.get_logger()


# 410 for a signal that the retention rule let go: it was there, and will not come back. 422 for
# what is well formed and wrong, which 400 is not.
_STATUS: dict[type[Exception], int] = {
    NotFound: 404,
    SignalLetGo: 410,
    Conflict: 409,
    IllegalTransition: 409,
    BadBody: 400,
    UnsupportedBody: 415,
    TooLarge: 413,
    TooManyJobs: 429,
    TooBusy: 503,
    Forbidden: 403,
    BadInput: 422,
}
# Characters of a refusal, which may repeat what a client sent. Of a body of megabytes a line that
# can be read must be left.
_MOST_SHOWN = 500


def problem(
    status: int,
    detail: str,
    kind: str | None = None,
    headers: dict[str, str] | None = None,
    **more: Any,
) -> Response:
    """A problem document. `kind` names the rule that was broken, for programs; `detail` is one line
    for people.
    """
    number = request_id()
    if number is not None:
        more, headers = {"request_id": number, **more}, {HEADER: number, **(headers or {})}
    body = {
        "type": f"urn:residuum:problem:{kind}" if kind else "about:blank",
        "title": _title(status),
        "status": status,
        "detail": _line(detail),
        **more,
    }
    return Response(
        orjson.dumps(body), status, media_type="application/problem+json", headers=headers
    )


def install(app: FastAPI) -> None:
    """Answer every exception of this app with a problem document."""
    app.add_middleware(SaidToClients)

    @app.exception_handler(BadInput)
    async def _bad_input(_request: Request, error: BadInput) -> Response:
        # the nearest class that has a status; BadInput, from which all come, is the last
        status = next(_STATUS[kind] for kind in type(error).__mro__ if kind in _STATUS)
        return problem(
            status,
            str(error),
            _kebab(type(error).__name__),
            {"Retry-After": "5"} if status in (429, 503) else None,
        )

    @app.exception_handler(RequestValidationError)
    async def _not_valid(_request: Request, error: RequestValidationError) -> Response:
        first = error.errors()[0]
        if first["type"] == "json_invalid":
            return problem(
                400, f"body.{first['loc'][1]}: {first['msg']}: {first['ctx']['error']}", "bad-body"
            )
        return problem(422, str(refusal(first)), "bad-request")

    @app.exception_handler(HTTPException)
    async def _http(_request: Request, error: HTTPException) -> Response:
        return problem(error.status_code, str(error.detail), headers=dict(error.headers or {}))

    @app.exception_handler(ClientDisconnect)
    async def _left(_request: Request, _error: ClientDisconnect) -> Response:
        # nobody reads this answer; it is counted among those that a client caused
        return problem(400, "body: the client left before its end", "bad-body")

    @app.exception_handler(StorageUnavailable)
    async def _storage(_request: Request, error: StorageUnavailable) -> Response:
        log.error("storage unavailable", reason=str(error))
        return problem(
            507 if error.full else 503, str(error), "storage-unavailable", {"Retry-After": "5"}
        )

    @app.exception_handler(Exception)
    async def _ours(_request: Request, error: Exception) -> Response:
        # no more than its class: a message may repeat what is nobody's business
        return problem(
            500, f"internal error: {type(error).__name__}; the log has the details", "internal"
        )


def _title(status: int) -> str:
    try:
        return HTTPStatus(status).phrase
    except ValueError:
        return "Error"


def _line(text: str) -> str:
    line = " ".join(text.split())
    return line if len(line) <= _MOST_SHOWN else line[:_MOST_SHOWN] + "…"


def _kebab(name: str) -> str:
    return re.sub(r"(?<=[a-z])(?=[A-Z])", "-", name).lower()
