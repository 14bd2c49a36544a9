"""Jobs: long work, its progress, and ending it."""

from __future__ import annotations

from typing import Annotated

import orjson
from fastapi import APIRouter, Path, Response
from starlette.responses import StreamingResponse

from residuum.service.alarms.events import Event
from residuum.service.api.answers import PROBLEMS, JobAnswer, PageOf
from residuum.service.api.events import LastEventId, event_stream
from residuum.service.api.responses import Json
from residuum.service.services import Running
from residuum.service.work.jobs import OVER

router = APIRouter(prefix="/jobs", tags=["jobs"], responses=PROBLEMS)

JobId = Annotated[str, Path(description="Name of the job.", pattern="^[0-9a-f]{1,40}$")]


@router.get("", response_model=PageOf[JobAnswer])
def list_jobs(running: Running) -> Response:
    """Jobs of this run of the service, newest first, without their results."""
    return Json(
        {
            # Results may be megabytes each.
            "items": [job.to_json(with_result=False) for job in running.jobs.list()],
            "next_cursor": None,
        }
    )


@router.get("/{job}", response_model=JobAnswer)
def get_job(running: Running, job: JobId) -> Response:
    """One job, with its result when it is done."""
    return Json(running.jobs.get(job).to_json())


@router.delete("/{job}", response_model=JobAnswer)
def cancel_job(running: Running, job: JobId) -> Response:
    """End a job now."""
    return Json(running.jobs.cancel(job).to_json())


@router.get("/{job}/events", response_class=StreamingResponse)
async def stream_job(running: Running, job: JobId, last_event_id: LastEventId = None) -> Response:
    """A job's progress as server-sent events; the stream ends with the job."""
    # before the look at the job: its end comes after one or the other
    begin = last_event_id or running.events.now()
    state = running.jobs.get(job)
    # An ended job has no event to come: its stream would never end.
    if state.state in OVER:
        data = orjson.dumps(state.to_json(with_result=False))
        return Response(b"event: job\ndata: " + data + b"\n\n", media_type="text/event-stream")

    def of_this_job(event: Event) -> bool:
        return event.kind == "job" and orjson.loads(event.data)["id"] == job

    return event_stream(
        running.events,
        begin,
        of_this_job,
        lambda event: event.kind == "job" and orjson.loads(event.data)["state"] in OVER,
    )
