"""Server-sent events: what happens, as it happens."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from typing import Annotated

from fastapi import APIRouter, Header, Query, Request, Response
from starlette.responses import StreamingResponse

from residuum.service.alarms.events import Event, Events
from residuum.service.services import Running, caller_of

router = APIRouter(tags=["events"])

LastEventId = Annotated[str | None, Header(description="Resume after this event.", max_length=60)]


@router.get("/events", response_class=StreamingResponse)
async def stream_events(
    running: Running,
    request: Request,
    last_event_id: LastEventId = None,
    kinds: Annotated[
        list[str] | None, Query(alias="kind", description="Only these kinds.", max_length=16)
    ] = None,
) -> Response:
    """Events `finding`, `confirmation`, `alarm`, `pipeline`, `job`, `model`; `reset` when some were
    missed: then read the state anew.

    A key of some sites gets the events of its machines, and none that is of the whole plant (`job`,
    `model`).
    """
    caller = caller_of(request)

    def wanted(event: Event) -> bool:
        # An event without an asset is of the whole plant, and goes to keys of the whole plant
        # alone.
        mine = caller.sites is None or (event.asset is not None and caller.may_see(event.asset))
        return mine and (not kinds or event.kind in kinds)

    return event_stream(running.events, last_event_id, wanted)


def event_stream(
    events: Events,
    last_event_id: str | None,
    wanted: Callable[[Event], bool],
    ends: Callable[[Event], bool] | None = None,
) -> StreamingResponse:
    """A stream of the wanted events, after the one that `ends` it closed; a comment keeps quiet
    connections open.

    It begins now, not when its first line is asked for: whoever sees the connection made misses
    nothing from then on.
    """
    # Taken here, not in the generator, which runs only when the answer is being sent.
    begin = last_event_id or events.now()

    async def lines() -> AsyncIterator[bytes]:
        # At once, so that the client sees the head of the answer before the first event.
        yield b": connected\n\n"
        async for event in events.listen(begin):
            if event is None:
                # A comment (server-sent events): proxies close connections on which nothing comes,
                # and a client that has gone is noticed by a write alone.
                yield b": still here\n\n"
            # A reset goes to everybody: who missed events cannot know whether one of them was
            # wanted.
            elif event.kind == "reset" or wanted(event):
                yield b"id: %s\nevent: %s\ndata: %s\n\n" % (
                    events.token(event).encode(),
                    event.kind.encode(),
                    event.data,
                )
                if ends is not None and ends(event):
                    return

    # nginx would hold events back until its buffer is full.
    headers = {"Cache-Control": "no-store", "X-Accel-Buffering": "no"}
    return StreamingResponse(lines(), media_type="text/event-stream", headers=headers)
