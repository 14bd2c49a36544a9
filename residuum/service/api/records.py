"""Uploaded records: the material for comparing, identifying and training."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.identification.record_formats import CAN_LOGS, LOGGERS, OLDER, READERS
from residuum.identification.record_formats.loggers.logger_time import FORMS
from residuum.nearest_names import known_names
from residuum.service.api.answers import PROBLEMS, PageOf, RecordAnswer, SignalAnswer
from residuum.service.api.parameters import TEXT, ChannelNames, Cursor, Limit, Points, RecordId
from residuum.service.api.reading_options import READING_OPTIONS, reading, remedies_in_query
from residuum.service.api.responses import Json, page_answer
from residuum.service.api.signal_body import body_of
from residuum.service.body_errors import BadBody, UnsupportedBody
from residuum.service.machines.adding import known_dbc
from residuum.service.services import Running, caller_of
from residuum.service.settings import Settings
from residuum.service.views.signal_view import signal_view
from residuum.service.work.upload_reader import read_upload

router = APIRouter(prefix="/records", tags=["records"], responses=PROBLEMS)

_FILE_BODY = {
    "requestBody": {
        "required": True,
        "description": "The file's bytes as they are.",
        "content": {
            kind: {"schema": {"type": "string", "format": "binary"}}
            for kind in ("application/octet-stream", "text/csv", "application/zip")
        },
    }
}


@router.post("", status_code=201, response_model=RecordAnswer, openapi_extra=_FILE_BODY)
async def add_record(
    request: Request,
    running: Running,
    filename: Annotated[
        str,
        Query(
            description="Name with its ending, which says the format.",
            min_length=1,
            max_length=200,
            pattern=TEXT,
        ),
    ],
    resample: Annotated[
        bool,
        Query(
            description=(
                "Accept uneven time stamps: samples are interpolated, longer holes stay missing."
            )
        ),
    ] = False,
    decimal: Annotated[
        Literal[".", ","] | None,
        Query(description="Decimal sign of a logger's file that leaves it open."),
    ] = None,
    time_form: Annotated[
        str | None,
        Query(
            description=f"Form of a logger's times: {', '.join(FORMS)}.",
            max_length=40,
            pattern=TEXT,
        ),
    ] = None,
    time_column: Annotated[
        str | None,
        Query(description="Name of a logger's column of times.", max_length=200, pattern=TEXT),
    ] = None,
    time: Annotated[
        str | None, Query(description="The same as `time_column`.", max_length=200, pattern=TEXT)
    ] = None,
    sample_time: Annotated[
        float | None,
        Query(
            description="Seconds between samples, for files that do not say it.",
            gt=0,
            allow_inf_nan=False,
        ),
    ] = None,
    unit: Annotated[
        list[str] | None, Query(description=READING_OPTIONS["unit"], max_length=256)
    ] = None,
    missing: Annotated[
        list[str] | None, Query(description=READING_OPTIONS["missing"], max_length=64)
    ] = None,
    map: Annotated[
        list[str] | None, Query(description=READING_OPTIONS["map"], max_length=256)
    ] = None,
    names: Annotated[
        str | None, Query(description=READING_OPTIONS["names"], max_length=2000)
    ] = None,
    duplicates: Annotated[
        Literal["first", "mean", "spread"] | None, Query(description=READING_OPTIONS["duplicates"])
    ] = None,
    reordered: Annotated[
        Literal["sort", "bridge"] | None, Query(description=READING_OPTIONS["reordered"])
    ] = None,
    dbc: Annotated[
        str | None,
        Query(
            description=(
                "DBC file of a watched machine, by its name, for a CAN log"
                f" ({', '.join(CAN_LOGS)})."
            ),
            max_length=200,
            pattern=TEXT,
        ),
    ] = None,
) -> Response:
    """Upload a record file. It is read at once, in a process of its own with limits, and stored
    only when it is valid.

    A logger's text file is understood by its own text; what that leaves open is refused, and said
    with these parameters.
    """
    if time is not None and time_column is not None:
        raise BadBody(
            "query: time and time_column are one option, the name of the column of times; give one"
            " of them"
        )
    options: dict[str, object] = {
        "resample": resample,
        "decimal": decimal,
        "time_form": time_form,
        "time_column": time_column or time,
    }
    options |= {
        "names": names.split(",") if names else [],
        "duplicates": duplicates,
        "reordered": reordered,
    }
    # From here on, what is refused names keys of this route's query as the way on.
    with remedies_in_query():
        how = reading(
            options | {"sample_time": sample_time, "missing": missing or []}, map or (), unit or ()
        )
        content = await body_of(request)
        bus = (
            None
            if dbc is None
            else await run_in_threadpool(known_dbc, running.settings, running.store, dbc)
        )
        # A stranger's file: in a process with limits of memory and time, and few side by side.
        record = await running.reading(_read, filename, content, running.settings, how.options, bus)
        record = how.renamed(record)
    number = await run_in_threadpool(running.store.add_record, filename, record)
    stored = await run_in_threadpool(running.store.record, number)
    return Json(stored.to_json(), 201, {"Location": f"/api/v1/records/{number}"})


@router.get("", response_model=PageOf[RecordAnswer])
async def list_records(running: Running, cursor: Cursor = None, limit: Limit = 50) -> Response:
    """Uploaded records, newest first."""
    return await page_answer(running, running.store.records, cursor, limit)


@router.get("/{record}", response_model=RecordAnswer)
def get_record(running: Running, record: RecordId) -> Response:
    """One record."""
    return Json(running.store.record(record).to_json())


@router.delete("/{record}", status_code=204)
def delete_record(request: Request, running: Running, record: RecordId) -> Response:
    """Delete a record for good. What was made of it (models, findings) stays."""
    running.store.remove_record(record, caller_of(request).name)
    return Response(status_code=204)


@router.get("/{record}/signal", response_model=SignalAnswer)
async def get_record_signal(
    running: Running,
    record: RecordId,
    channels: ChannelNames = None,
    points: Points = 2000,
    begin: Annotated[
        float, Query(alias="from", description="Seconds after the record's begin.", ge=0)
    ] = 0.0,
    end: Annotated[
        float | None, Query(alias="to", description="Seconds after the record's begin.", gt=0)
    ] = None,
) -> Response:
    """A stretch of the signals, reduced as a window's are."""
    known = await run_in_threadpool(running.store.record, record)
    for name in channels or ():
        if name not in known.units:
            says = known_names(name, known.units, "there are")
            raise BadInput(f"channel {name[:60]!r}: the record has none of this name; {says}")

    def view() -> Response:
        return Json(
            {
                "window": None,
                **signal_view(running.store.record_in_pieces(record, channels), points, begin, end),
            }
        )

    return await running.listing(view)


def _read(
    filename: str,
    content: bytes,
    settings: Settings,
    options: Mapping[str, object],
    bus: Path | None,
) -> Record:
    """The record of an uploaded file, whose name on disk is ours (its ending one of the known)."""
    # By the name's ending, which picks the reader; the bytes decide whether it reads them.
    endings = [*READERS, *OLDER, *LOGGERS, *CAN_LOGS]
    ending = next((known for known in endings if filename.lower().endswith(known)), None)
    if ending is None:
        raise UnsupportedBody(
            f"filename {filename[:60]!r}: the ending must be one of {', '.join(endings)}"
        )
    if (ending in CAN_LOGS) != (bus is not None):
        raise BadInput(
            f"filename {filename[:60]!r}: CAN logs ({', '.join(CAN_LOGS)}) and the DBC file of"
            " their bus (dbc) go together"
        )
    limits = {"memory": settings.upload_memory, "seconds": settings.upload_seconds}
    return read_upload(content, ending, filename, **limits, options=options, dbc=bus)
