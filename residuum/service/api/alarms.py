"""Alarms: the list, and what an operator does with one."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from typing import Annotated, Literal

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, Field

from residuum.service.alarms.alarm_states import AlarmEvent, Priority
from residuum.service.api.answers import (
    PROBLEMS,
    AlarmAnswer,
    AlarmOccurrenceAnswer,
    AlarmRatesAnswer,
    PageOf,
)
from residuum.service.api.parameters import NAME, TEXT, AlarmId, Begin, Cursor, End, Limit
from residuum.service.api.responses import Json, StrictRoute, page_answer
from residuum.service.results.parquet_tables import open_span
from residuum.service.results.rationalisation import rationalisation_table
from residuum.service.services import Running, Services, caller_of
from residuum.service.store import Alarm, NotFound

router = APIRouter(prefix="/alarms", tags=["alarms"], route_class=StrictRoute, responses=PROBLEMS)


class Remark(BaseModel, extra="forbid"):
    """What an operator may say with it."""

    comment: str | None = Field(
        None, max_length=2000, pattern=TEXT, description="Kept in the alarm's journal."
    )


class Shelving(Remark):
    """For how long an alarm is put aside."""

    minutes: float = Field(
        # Bounded, for a shelved alarm must come back by itself (ANSI/ISA-18.2, shelving); what
        # should be away for longer is taken out of service, with its own states.
        60.0,
        gt=0,
        le=7 * 24 * 60,
        description="The alarm comes back by itself after this long.",
    )


@router.get("", response_model=PageOf[AlarmAnswer])
async def list_alarms(
    request: Request,
    running: Running,
    asset: Annotated[str | None, Query(description="Only this asset's.", pattern=NAME)] = None,
    active: Annotated[bool, Query(description="Leave out alarms in state normal.")] = True,
    cursor: Cursor = None,
    limit: Limit = 100,
) -> Response:
    """Alarms (of the caller's sites), newest first."""
    return await page_answer(
        running, running.store.alarms, asset, active, cursor, limit, caller_of(request).sites
    )


# Before `/{alarm}`, as all routes with a word of their own: the first that matches answers.
@router.get("/rates", response_model=AlarmRatesAnswer)
def alarm_rates(running: Running) -> Response:
    """How many alarms were raised of late, which ones most often, and whether there is a flood
    (ANSI/ISA-18.2, clause 16).
    """
    return Json(running.store.alarm_rates().to_json())


@router.get("/history", response_model=PageOf[AlarmOccurrenceAnswer])
async def alarm_history(
    request: Request,
    running: Running,
    asset: Annotated[str | None, Query(description="Only this asset's.", pattern=NAME)] = None,
    begin: Begin = None,
    end: End = None,
    kind: Annotated[Literal["machine", "signal"] | None, Query(description="Only these.")] = None,
    priority: Annotated[Priority | None, Query(description="Only of alarms of this one.")] = None,
    cursor: Cursor = None,
    limit: Limit = 100,
) -> Response:
    """Every time that an alarm was raised (of the caller's sites) in a span of time, newest first,
    and what became of it.
    """
    span, sites = open_span(begin, end), caller_of(request).sites
    filters = (sites, kind, None if priority is None else priority.value)
    return await page_answer(
        running, running.store.alarm_history, span, asset, cursor, limit, *filters
    )


@router.get("/rationalisation.csv", response_class=Response)
async def rationalisation(request: Request, running: Running) -> Response:
    """The alarms of every machine (of the caller's sites) with their limits, delays, consequence, time
    to respond, priority and action, as a CSV file (ANSI/ISA-18.2, clause 9).
    """
    sites = caller_of(request).sites

    def table_file() -> Response:
        table = rationalisation_table(running.store, running.pipeline.alarm_rule, sites)
        headers = {"Content-Disposition": 'attachment; filename="alarms.csv"'}
        return Response(table, media_type="text/csv; charset=utf-8", headers=headers)

    return await running.listing(table_file)


@router.get("/{alarm}", response_model=AlarmAnswer)
def get_alarm(request: Request, running: Running, alarm: AlarmId) -> Response:
    """One alarm with its journal."""
    fields = _visible(request, running, alarm).to_json()
    return Json(
        {**fields, "journal": [entry.to_json() for entry in running.store.alarm_journal(alarm)]}
    )


@router.post("/{alarm}/acknowledge", response_model=AlarmAnswer)
def acknowledge(
    request: Request, running: Running, alarm: AlarmId, remark: Remark | None = None
) -> Response:
    """Say that the alarm was seen."""
    return _operate(request, running, alarm, AlarmEvent.ACKNOWLEDGE, remark)


@router.post("/{alarm}/shelve", response_model=AlarmAnswer)
def shelve(
    request: Request, running: Running, alarm: AlarmId, shelving: Shelving | None = None
) -> Response:
    """Put the alarm aside for a while; it comes back by itself. The machine's alarm rule may ask for a
    reason (`comment`), and bound the while.
    """
    shelving = shelving or Shelving(minutes=60.0, comment=None)
    rule = running.pipeline.alarm_rule(_visible(request, running, alarm).asset)
    # Refused by the rule of the alarm's own machine, before anything is written.
    rule.refuse_shelving(shelving.minutes, shelving.comment)
    # A moment and not a length: it is kept, and holds after a restart.
    until = datetime.now(UTC) + timedelta(minutes=shelving.minutes)
    return _operate(request, running, alarm, AlarmEvent.SHELVE, shelving, until)


@router.post("/{alarm}/unshelve", response_model=AlarmAnswer)
def unshelve(request: Request, running: Running, alarm: AlarmId) -> Response:
    """Take a shelved alarm back."""
    return _operate(request, running, alarm, AlarmEvent.UNSHELVE, None)


@router.post("/{alarm}/reset", response_model=AlarmAnswer)
def reset(
    request: Request, running: Running, alarm: AlarmId, remark: Remark | None = None
) -> Response:
    """Let a latched alarm go that was acknowledged and whose condition has gone."""
    return _operate(request, running, alarm, AlarmEvent.RESET, remark)


@router.post("/{alarm}/suppress", response_model=AlarmAnswer)
def suppress(
    request: Request, running: Running, alarm: AlarmId, remark: Remark | None = None
) -> Response:
    """Hide the alarm by design, while the plant is in a state in which it means nothing (until it
    is released).
    """
    return _operate(request, running, alarm, AlarmEvent.SUPPRESS, remark)


@router.post("/{alarm}/release", response_model=AlarmAnswer)
def release(
    request: Request, running: Running, alarm: AlarmId, remark: Remark | None = None
) -> Response:
    """Take a suppressed alarm back."""
    return _operate(request, running, alarm, AlarmEvent.RELEASE, remark)


@router.post("/{alarm}/remove-from-service", response_model=AlarmAnswer)
def remove_from_service(
    request: Request, running: Running, alarm: AlarmId, remark: Remark | None = None
) -> Response:
    """Take the alarm out of service, for maintenance."""
    return _operate(request, running, alarm, AlarmEvent.REMOVE_FROM_SERVICE, remark)


@router.post("/{alarm}/return-to-service", response_model=AlarmAnswer)
def return_to_service(
    request: Request, running: Running, alarm: AlarmId, remark: Remark | None = None
) -> Response:
    """Put the alarm back into service."""
    return _operate(request, running, alarm, AlarmEvent.RETURN_TO_SERVICE, remark)


def _operate(
    request: Request,
    running: Services,
    alarm: int,
    event: AlarmEvent,
    remark: Remark | None,
    until: datetime | None = None,
) -> Response:
    # First: a key of another site must not learn by a 409 that there is such an alarm.
    _visible(request, running, alarm)
    comment = remark.comment if remark else None
    return Json(
        running.store.operate_alarm(alarm, event, caller_of(request).name, comment, until).to_json()
    )


def _visible(request: Request, running: Services, alarm: int) -> Alarm:
    """The alarm; NotFound also when it is of a site that is not the caller's."""
    stored = running.store.alarm(alarm)
    # 404, as for a number that no alarm has: 403 would say that there is one (OWASP API1, broken
    # object level authorization).
    if not caller_of(request).may_see(stored.asset):
        raise NotFound(f"alarm {alarm}: there is none of this number")
    return stored
