"""Results as files: a machine's findings and windows as Parquet, its month as a page."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query, Request, Response

from residuum.service.api.answers import PROBLEMS
from residuum.service.api.parameters import AssetName, SpanBegin, SpanEnd
from residuum.service.api.responses import StrictRoute, file_answer
from residuum.service.results.month_report import month_report
from residuum.service.results.parquet_tables import (
    MEDIA_TYPE,
    span_of,
    write_findings,
    write_windows,
)
from residuum.service.results.report_page import POLICY, report_page
from residuum.service.services import Running, caller_of

router = APIRouter(
    prefix="/assets/{asset}", tags=["results"], route_class=StrictRoute, responses=PROBLEMS
)

# Of the signals in one file of windows. The file is written to the data's disk before it is sent;
# over the command line there is no such limit.
_MOST_BYTES = 2**30


@router.get("/findings.parquet", response_class=Response)
async def get_findings_file(
    running: Running, asset: AssetName, begin: SpanBegin, end: SpanEnd
) -> Response:
    """Findings of a span of time as a Parquet file, a row a finding (needs the extra `parquet`)."""
    span = span_of(begin, end)
    return await file_answer(
        running,
        f"{asset}-findings.parquet",
        lambda path: write_findings(running.store, asset, span, path),
        MEDIA_TYPE,
    )


@router.get("/windows.parquet", response_class=Response)
async def get_windows_file(
    running: Running, asset: AssetName, begin: SpanBegin, end: SpanEnd
) -> Response:
    """Windows of a span of time with their signals as a Parquet file, a row a window and channel
    (needs the extra `parquet`).
    """
    span = span_of(begin, end)
    return await file_answer(
        running,
        f"{asset}-windows.parquet",
        lambda path: write_windows(running.store, asset, span, path, _MOST_BYTES),
        MEDIA_TYPE,
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
    # One at a time: a month's findings are read for it.
    page = await running.writing(
        lambda: report_page(month_report(running.store, asset, month, sites))
    )
    headers = {
        # The page's own policy, stricter than the service's: it has no scripts.
        "Content-Security-Policy": POLICY,
        "Content-Disposition": f'inline; filename="{asset}-{month}.html"',
    }
    return Response(page, media_type="text/html", headers=headers)
