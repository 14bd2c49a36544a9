"""Score one window with a diagnoser; nothing is stored."""

from __future__ import annotations

import re
from functools import lru_cache
from typing import get_type_hints

from fastapi import APIRouter, Request, Response
from starlette.concurrency import run_in_threadpool
from starlette.datastructures import QueryParams

from residuum.diagnosis.diagnosers.base import Diagnoser
from residuum.identification.errors import BadInput
from residuum.library.questions import help_of, kinds, written
from residuum.library.questions.score import Score
from residuum.service.api.answers import PROBLEMS, ScoreAnswer
from residuum.service.api.parameters import NAME
from residuum.service.api.reading_options import remedies_in_query, remedies_in_upload
from residuum.service.api.responses import BareRoute, finding_json
from residuum.service.api.signal_body import (
    SIGNAL_BODY,
    SIGNAL_QUERY,
    kind_of,
    query_parameter,
    record_of,
)
from residuum.service.services import Services
from residuum.service.store import NotFound

# Samples up to which a thread costs more than the scoring it would take off the event loop.
_SCORED_AT_ONCE = 8192

# Bytes of a query up to which it is remembered as it was parsed. Long ones are seldom sent twice,
# and would fill the memory.
_LONGEST_KEPT = 1000


_DIAGNOSER = {
    "in": "path",
    "name": "diagnoser",
    "required": True,
    "description": "One of `GET /diagnosers`.",
    "schema": {"type": "string"},
}
_RECORD = {
    "in": "path",
    "name": "record",
    "required": True,
    "description": "Number of the record.",
    "schema": {"type": "integer"},
}
_OF_DIAGNOSERS = [
    query_parameter(
        "baseline", "string", "A stored baseline, or the name of an asset that has one."
    ),
    *(
        query_parameter(
            name,
            "number" if float in kinds(get_type_hints(Score)[name]) else "string",
            f"{help_of(field)} {written(field) or ''}".strip(),
        )
        for name, field in Score.model_fields.items()
    ),
]
_DESCRIBED = SIGNAL_BODY | {"parameters": [_DIAGNOSER, *SIGNAL_QUERY, *_OF_DIAGNOSERS]}

router = APIRouter(tags=["score"], route_class=BareRoute, responses=PROBLEMS)


@router.post("/score/{diagnoser}", response_model=ScoreAnswer, openapi_extra=_DESCRIBED)
async def score(request: Request) -> Response:
    """Score one window. Without a baseline only absolute indicators and fault lines are judged."""
    # The parameters are read by hand: declared ones cost more time than the rest of the answer to a
    # short window.
    services: Services = request.app.state.services
    query_string = request.scope["query_string"]
    if len(query_string) <= _LONGEST_KEPT:
        # a client asks with the same query again and again
        request._query_params = _query(query_string)
    judge = await _judge(services, request.path_params["diagnoser"], request.query_params)
    with remedies_in_query(kind_of(request)):
        record = await record_of(request, judge.channels)
        small = judge.quick and record.n * len(record.names) <= _SCORED_AT_ONCE
        finding = judge.score(record) if small else await run_in_threadpool(judge.score, record)
    return finding_json(finding)


@router.post(
    "/records/{record}/score/{diagnoser}",
    response_model=ScoreAnswer,
    openapi_extra={"parameters": [_RECORD, _DIAGNOSER, *_OF_DIAGNOSERS]},
)
async def score_record(request: Request) -> Response:
    """Score an uploaded record. Without a baseline only absolute indicators and fault lines are
    judged.
    """
    services: Services = request.app.state.services
    number = request.path_params["record"]
    # By hand, as the route declares no parameters; 404 as for any number that no record has.
    if not number.isdecimal() or not 0 < int(number) < 2**53:
        raise NotFound(f"record {number[:40]!r}: there is none of this number")
    judge = await _judge(services, request.path_params["diagnoser"], request.query_params)
    record = await run_in_threadpool(services.store.record_samples, int(number))
    with remedies_in_upload():
        finding = await run_in_threadpool(judge.score, record)
    return finding_json(finding)


# Some hundred clients, each with its own query.
@lru_cache(maxsize=256)
def _query(query_string: bytes) -> QueryParams:
    return QueryParams(query_string)


async def _judge(services: Services, diagnoser: str, query: QueryParams) -> Diagnoser:
    given = {name: query[name] for name in Score.model_fields if name in query}
    settings = Score.of(given).settings if given else {}
    baseline = query.get("baseline")
    if baseline is None:
        return services.judges.untrained(diagnoser, settings)
    if not re.match(NAME, baseline):
        raise BadInput(
            f"query, baseline: {baseline[:60]!r} is not a name of letters, digits, '.', '_' and '-'"
        )
    judge = await run_in_threadpool(services.judges.trained, diagnoser, baseline)
    return judge.with_settings(**settings) if settings else judge
