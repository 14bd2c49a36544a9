"""Assets (machines): their state, findings, indicators over time."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, Field

from residuum.service.api.answers import PROBLEMS, AssetAnswer, FindingAnswer, PageOf
from residuum.service.api.parameters import TEXT, AssetName, Begin, Cursor, End, Limit
from residuum.service.api.responses import Json, StrictRoute, page_answer
from residuum.service.machines.scoring import diagnoser_class
from residuum.service.results.parquet_tables import open_span
from residuum.service.services import Running, caller_of

router = APIRouter(prefix="/assets", tags=["assets"], route_class=StrictRoute, responses=PROBLEMS)


class AssetSettings(BaseModel, extra="forbid"):
    """What can be set of an asset."""

    title: str | None = Field(
        None, min_length=1, max_length=200, pattern=TEXT, description="Name for people."
    )
    diagnoser: str | None = Field(None, max_length=64, description="Diagnoser of its windows.")


@router.get("", response_model=PageOf[AssetAnswer])
async def list_assets(
    request: Request, running: Running, cursor: Cursor = None, limit: Limit = 100
) -> Response:
    """All assets by name (of the caller's sites), each with its latest finding."""
    return await page_answer(running, running.store.assets, cursor, limit, caller_of(request).sites)


@router.get("/{asset}", response_model=AssetAnswer)
def get_asset(running: Running, asset: AssetName) -> Response:
    """One asset with its latest finding."""
    return Json(running.store.asset(asset).to_json())


@router.put("/{asset}", response_model=AssetAnswer)
def put_asset(running: Running, asset: AssetName, settings: AssetSettings) -> Response:
    """Make an asset known, or change its title or diagnoser."""
    # Refused before the asset is made known: its windows could not be judged by a name that is
    # none.
    if settings.diagnoser is not None:
        diagnoser_class(settings.diagnoser)
    running.store.ensure_asset(asset, settings.title, settings.diagnoser)
    return Json(running.store.asset(asset).to_json())


@router.get("/{asset}/findings", response_model=PageOf[FindingAnswer])
async def list_findings(
    running: Running,
    asset: AssetName,
    cursor: Cursor = None,
    limit: Limit = 50,
    verdict: Annotated[
        Literal["healthy", "faulty", "not-assessable"] | None, Query(description="Only these.")
    ] = None,
) -> Response:
    """Findings on an asset's windows, newest first."""
    return await page_answer(running, running.store.findings, asset, cursor, limit, verdict)


@router.get("/{asset}/indicators")
async def get_indicators(
    running: Running,
    asset: AssetName,
    limit: Annotated[int, Query(description="Most findings.", ge=1, le=5000)] = 500,
    begin: Begin = None,
    end: End = None,
) -> Response:
    """Indicators and thresholds of the newest findings as columns, oldest first (null where a
    finding lacks one).

    With `from` or `to`, of findings spread over that time: where there are more than `limit`, the
    worst of every stretch. Of what would take more than 3 MiB the newest are told.
    """
    # Without a span the newest are told, as a page that follows a machine asks for them.
    span = None if begin is None and end is None else open_span(begin, end)
    return await running.listing(lambda: Json(vars(running.store.indicators(asset, limit, span))))


@router.get("/{asset}/history")
async def get_history(
    running: Running,
    asset: AssetName,
    limit: Annotated[int, Query(description="Newest hours.", ge=1, le=24 * 366)] = 24 * 30,
) -> Response:
    """Findings whose rows were let go, an entry an hour, oldest first: verdicts, and each
    indicator's extremes and mean.
    """
    return await running.listing(
        lambda: Json(
            {"hours": [hour.to_json() for hour in running.store.finding_hours(asset, limit)]}
        )
    )
