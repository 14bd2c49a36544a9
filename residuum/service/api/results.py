"""Results as files: a machine's findings and windows as Parquet, its month as a page."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from starlette.background import BackgroundTask
from starlette.responses import FileResponse

from residuum.service.api.answers import PROBLEMS
from residuum.service.api.json_response import StrictRoute
from residuum.service.api.parameters import AssetName
from residuum.service.results.month_report import month_report
from residuum.service.results.parquet_tables import (
    MEDIA_TYPE,
    span_of,
    write_findings,
    write_windows,
)
from residuum.service.results.report_page import POLICY, report_page
from residuum.service.services import Running, Services, caller_of

router = APIRouter(
    prefix="/assets/{asset}", tags=["results"], route_class=StrictRoute, responses=PROBLEMS
)

Begin = Annotated[
    str, Query(alias="from", max_length=40, description="ISO 8601; without a zone: UTC.")
]
End = Annotated[
    str, Query(alias="to", max_length=40, description="ISO 8601; not part of the span.")
]
_MOST_BYTES = 2**30


@router.get("/findings.parquet", response_class=Response)
async def get_findings_file(running: Running, asset: AssetName, begin: Begin, end: End) -> Response:
    """Findings of a span of time as a Parquet file, a row a finding (needs the extra `parquet`)."""
    span = span_of(begin, end)
    return await file_answer(
        running,
        f"{asset}-findings.parquet",
        lambda path: write_findings(running.store, asset, span, path),
    )


@router.get("/windows.parquet", response_class=Response)
async def get_windows_file(running: Running, asset: AssetName, begin: Begin, end: End) -> Response:
    """Windows of a span of time with their signals as a Parquet file, a row a window and channel
    (needs the extra `parquet`).
    """
    span = span_of(begin, end)
    return await file_answer(
        running,
        f"{asset}-windows.parquet",
        lambda path: write_windows(running.store, asset, span, path, _MOST_BYTES),
    )


@router.get("/report", response_class=Response)
async def get_report(
    request: Request,
    running: Running,
    asset: AssetName,
    month: Annotated[str, Query(max_length=20, description="YYYY-MM, in UTC.")],
) -> Response:
    """What happened at a machine in a month, as one HTML page that opens offline."""
    sites = caller_of(request).sites
    page = await running.writing(
        lambda: report_page(month_report(running.store, asset, month, sites))
    )
    headers = {
        "Content-Security-Policy": POLICY,
        "Content-Disposition": f'inline; filename="{asset}-{month}.html"',
    }
    return Response(page, media_type="text/html", headers=headers)


def downloads(data: Path) -> Path:
    """The folder of files that are being written and sent, on the disk that has room for them."""
    return data / "downloads"


async def file_answer(
    running: Services, name: str, write: Callable[[Path], object], media_type: str = MEDIA_TYPE
) -> Response:
    """The answer of a file that `write` makes, one at a time, and that is gone when it was sent."""
    return await running.writing(
        _written, downloads(running.settings.data), name, write, media_type
    )


def _written(place: Path, name: str, write: Callable[[Path], object], media_type: str) -> Response:
    place.mkdir(parents=True, exist_ok=True)
    folder = tempfile.TemporaryDirectory(dir=place)
    path = Path(folder.name) / name
    try:
        write(path)
    except BaseException:
        folder.cleanup()
        raise
    return FileResponse(
        path, media_type=media_type, filename=name, background=BackgroundTask(folder.cleanup)
    )
