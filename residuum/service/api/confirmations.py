"""What was found at machines of what findings said: told, listed, counted."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, Field

from residuum.service.api.answers import (
    PROBLEMS,
    ConfirmationAnswer,
    PageOf,
    ReliabilityAnswer,
)
from residuum.service.api.parameters import (
    NAME,
    TEXT,
    AssetName,
    Begin,
    Cursor,
    End,
    FindingId,
    Limit,
)
from residuum.service.api.responses import Json, StrictRoute, page_answer
from residuum.service.results.parquet_tables import open_span
from residuum.service.results.said_and_found import said_and_found
from residuum.service.services import Running, caller_of
from residuum.service.store import FoundAtMachine, Outcome

router = APIRouter(tags=["confirmations"], route_class=StrictRoute, responses=PROBLEMS)

OfAsset = Annotated[str | None, Query(description="Only this asset's.", pattern=NAME)]


class Found(BaseModel, extra="forbid"):
    """What was found at the machine of what a finding said."""

    outcome: Outcome = Field(
        description="`confirmed`: it was so; `refuted`: no such thing; `corrected`: something else."
    )
    cause: str | None = Field(
        None,
        min_length=1,
        max_length=200,
        pattern=TEXT,
        description="corrected: what it was instead.",
    )
    part: str | None = Field(
        None, max_length=200, pattern=TEXT, description="Part that was exchanged or repaired."
    )
    order: str | None = Field(
        None,
        max_length=100,
        pattern=TEXT,
        description=(
            "Number of the work order; left out: that of the order that a receiver made of the alarm."
        ),
    )
    who: str | None = Field(
        None,
        min_length=1,
        max_length=200,
        pattern=TEXT,
        description="Who looked; left out: the caller.",
    )
    found_at: datetime | None = Field(None, description="When; without a zone: UTC; left out: now.")
    note: str | None = Field(None, max_length=2000, pattern=TEXT)
    healthy: bool = Field(
        False,
        description=(
            "refuted: its window may be learned from as a healthy one when the baseline is trained"
            " the next time. Nothing is learned by itself."
        ),
    )


@router.post(
    "/assets/{asset}/findings/{finding}/confirmations",
    status_code=201,
    response_model=ConfirmationAnswer,
)
def confirm(
    request: Request, running: Running, asset: AssetName, finding: FindingId, found: Found
) -> Response:
    """Tell what was found at the machine: it was so, there was no such thing, or it was something
    else. What is told later on the same finding counts instead; both stay.
    """
    fields = found.model_dump()
    # As the spans of time: a moment without a zone is one of UTC.
    if found.found_at is not None and found.found_at.tzinfo is None:
        fields["found_at"] = found.found_at.replace(tzinfo=UTC)
    # Beside `who`: a fitter's finding may be typed in by somebody else, and the trail names both.
    caller = caller_of(request).name
    confirmation = running.store.confirm(asset, finding, FoundAtMachine(**fields), caller)
    return Json(confirmation.to_json(), 201)


@router.get("/confirmations", response_model=PageOf[ConfirmationAnswer])
async def list_confirmations(
    request: Request,
    running: Running,
    asset: OfAsset = None,
    begin: Begin = None,
    end: End = None,
    diagnosis: Annotated[
        str | None,
        Query(
            max_length=200, pattern=TEXT, description="What was said, or what it was corrected to."
        ),
    ] = None,
    cursor: Cursor = None,
    limit: Limit = 100,
) -> Response:
    """What was told (of the caller's sites) of findings of a span of time, newest first."""
    span, sites = open_span(begin, end), caller_of(request).sites
    return await page_answer(
        running, running.store.confirmations, span, asset, diagnosis, cursor, limit, sites
    )


@router.get("/confirmations/reliability", response_model=ReliabilityAnswer)
async def get_reliability(
    request: Request,
    running: Running,
    asset: OfAsset = None,
    begin: Begin = None,
    end: End = None,
) -> Response:
    """Of findings that were said with a probability in each tenth, and answered: how many were
    found so, with 95 % intervals.
    """
    span, sites = open_span(begin, end), caller_of(request).sites

    def counted() -> Response:
        answered = running.store.standing_confirmations(span, asset, sites)
        return Json(said_and_found(answered).to_json())

    return await running.listing(counted)
