"""Answers that several routes give: JSON through orjson (NumPy numbers and moments as they are,
non-finite numbers as null), pages of lists, files, jobs; and JSON bodies, read strictly.
"""

from __future__ import annotations

import tempfile
from collections.abc import AsyncIterator, Callable, Coroutine, Mapping
from json import JSONDecodeError
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import orjson
from fastapi import Request, Response
from fastapi.routing import APIRoute
from starlette.background import BackgroundTask
from starlette.concurrency import run_in_threadpool
from starlette.exceptions import HTTPException
from starlette.responses import FileResponse, JSONResponse, StreamingResponse

from residuum.diagnosis.finding import TOLD_BESIDE, Finding
from residuum.library.questions import OLD_SPELLINGS
from residuum.service.api.parameters import known_channels
from residuum.service.store import Page, StoredWindow, T

if TYPE_CHECKING:
    from residuum.service.services import Services
    from residuum.service.work.jobs import Job

# Bytes, and lists and objects, of a JSON body that asks for something: read on the event loop in
# some 20 ms at worst.
_LARGEST, _MOST_NESTED = 2 * 2**20, 50_000
# Bytes that are sent at once.
_PIECE = 256 * 2**10
_CLOSE = {"Connection": "close"}  # the rest of the body is not waited for
# UTC as `Z` (RFC 3339); arrays are written without a list made of them first.
_OPTIONS = orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS | orjson.OPT_UTC_Z


class Json(JSONResponse):
    """A JSON answer."""

    def render(self, content: Any) -> bytes:
        """The bytes."""
        return orjson.dumps(content, option=_OPTIONS)


def finding_json(finding: Finding) -> Response:
    """A finding as `Json(finding.to_json())` gives it, without the plain copy that this makes
    first.
    """
    beside = {name: finding.evidence[name] for name in TOLD_BESIDE if name in finding.evidence}
    document = beside | {
        "diagnoser": finding.diagnoser,
        "verdict": finding.verdict.value,
        "class": finding.fault_class,
        "ne107": finding.ne107.value,
        "indicators": finding.indicators,
        "thresholds": finding.thresholds,
        "units": finding.units,
        "evidence": finding.evidence,
        "reason": finding.reason,
    }
    return Response(orjson.dumps(document, _plain, _OPTIONS), media_type="application/json")


def _plain(value: Any) -> Any:
    """What orjson does not know."""
    if isinstance(value, Mapping):
        return dict(value)
    if isinstance(value, np.ndarray):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is no JSON value")


def page_json(page: Page[T]) -> Json:
    """One page of a list: `items` and the `next_cursor` to ask for the next."""
    items = [item.to_json() for item in page.items]  # type: ignore[attr-defined]
    return Json({"items": items, "next_cursor": page.next_cursor})


async def page_answer(running: Services, page: Callable[..., Page[T]], *arguments: Any) -> Json:
    """A page of a list, made in a thread when there is room for it."""
    return await running.listing(lambda: page_json(page(*arguments)))


def accepted(job: Job) -> Json:
    """The answer to a request that became a job."""
    # 202 with the address to look at (RFC 9110, 15.3.3): analyses take seconds to minutes, longer
    # than clients and proxies wait.
    return Json(job.to_json(with_result=False), 202, {"Location": f"/api/v1/jobs/{job.id}"})


async def of_one_channel(
    running: Services,
    asset: str,
    window: int,
    channel: str | None,
    make: Callable[[StoredWindow, str], Response],
) -> Response:
    """What `make(window, channel)` makes of a channel's samples (None: the first), when there is
    memory for it.
    """
    known = await run_in_threadpool(running.store.window, asset, window)
    name = channel if channel is not None else next(iter(known.units))
    known_channels([name], known.units)
    return await running.sampling(known.size_bytes // max(1, len(known.units)), make, known, name)


def downloads(data: Path) -> Path:
    """The folder of files that are being written and sent, on the disk that has room for them."""
    return data / "downloads"


async def file_answer(
    running: Services, name: str, write: Callable[[Path], object], media_type: str
) -> Response:
    """The answer of a file that `write` makes, one at a time, and that is gone when it was sent."""
    return await running.writing(
        _written, downloads(running.settings.data), name, write, media_type
    )


def _written(place: Path, name: str, write: Callable[[Path], object], media_type: str) -> Response:
    # On the data's disk: the folder of temporary files is often in memory, and small.
    place.mkdir(parents=True, exist_ok=True)
    folder = tempfile.TemporaryDirectory(dir=place)
    path = Path(folder.name) / name
    try:
        write(path)
    except BaseException:
        # no answer will remove it
        folder.cleanup()
        raise
    return FileResponse(
        path, media_type=media_type, filename=name, background=BackgroundTask(folder.cleanup)
    )


def in_pieces(content: bytes, media_type: str, headers: Mapping[str, str]) -> Response:
    """An answer that is sent piece by piece, as fast as the client takes it: a long one at once
    would hold up everybody.
    """

    async def pieces() -> AsyncIterator[bytes]:
        for begin in range(0, len(content), _PIECE):
            yield content[begin : begin + _PIECE]

    # With its length, which a streamed answer has not by itself: a client sees an answer that was
    # cut off.
    return StreamingResponse(
        pieces(), media_type=media_type, headers={**headers, "Content-Length": str(len(content))}
    )


class _StrictRequest(Request):
    async def body(self) -> bytes:
        """The body, refused as soon as it is longer than such a body may be."""
        # where Starlette keeps a body that was read
        if not hasattr(self, "_body"):
            pieces, received = [], 0
            async for piece in self.stream():
                received += len(piece)
                if received > _LARGEST:
                    raise HTTPException(
                        413, f"body: more than {_LARGEST} bytes; no more are read here", _CLOSE
                    )
                pieces.append(piece)
            self._body = b"".join(pieces)
        return self._body

    async def json(self) -> Any:
        """The body, strictly: NaN, Infinity, numbers beyond double range, lone surrogates and deep
        nesting are refused.
        """
        body = await self.body()
        # Counted before it is read: a parser's objects take many times the bytes of the brackets.
        if body.count(b"[") + body.count(b"{") > _MOST_NESTED:
            raise HTTPException(
                413, f"body: more than {_MOST_NESTED} lists and objects; no more are read here"
            )
        try:
            # RFC 8259, strictly: Python's own reader takes NaN and Infinity, which are then refused
            # nowhere.
            return orjson.loads(body)
        except orjson.JSONDecodeError as error:
            raise JSONDecodeError(error.msg, body.decode(errors="replace"), error.pos) from None


class BareRoute(APIRoute):
    """A route whose function takes the request alone: the framework then declares and converts
    nothing, and costs less.
    """

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """The function itself."""
        function: Callable[[Request], Coroutine[Any, Any, Response]] = self.endpoint
        return function


class StrictRoute(APIRoute):
    """A route whose JSON bodies are read strictly."""

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """The handler, with the strict request. An old spelling is told in the answer's header
        `Warning` (RFC 7234, 5.5).
        """
        handler = super().get_route_handler()

        async def strict(request: Request) -> Response:
            # A warning of the service's process would reach nobody who could change the request.
            old: list[str] = []
            before = OLD_SPELLINGS.set(old.append)
            try:
                response = await handler(_StrictRequest(request.scope, request.receive))
            finally:
                OLD_SPELLINGS.reset(before)
            for says in old:
                # A header holds ASCII, and a quoted text no quotation marks.
                plain = (
                    says.encode("ascii", "backslashreplace")
                    .decode()
                    .replace("\n", " ")
                    .replace('"', "'")
                )
                response.headers.append("Warning", f'299 - "{plain}"')
            return response

        return strict
