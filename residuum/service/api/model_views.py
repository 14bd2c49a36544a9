"""What a page needs to work on a physical model: its description, its signals beside records, and
one more effect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import suppress
from typing import Annotated, Any

from fastapi import APIRouter, Query, Request, Response
from pydantic import BaseModel, Field

from residuum.identification.physics import BUILT_IN, load_model, write_model
from residuum.identification.record import Record
from residuum.library.questions import part_of
from residuum.library.questions.compare import Compare
from residuum.service.api.analyses import Comparison, OnRecords, Text, content_of
from residuum.service.api.answers import PROBLEMS, JobAnswer, ModelVersionAnswer
from residuum.service.api.parameters import ModelName, NewModelName
from residuum.service.api.responses import Json, StrictRoute, accepted
from residuum.service.services import Running, Services, caller_of
from residuum.service.store import NotFound
from residuum.service.views.model_view import (
    EffectUse,
    add_effect,
    describe,
    effect_curves,
    model_of,
    view_model,
    with_parameters,
)
from residuum.service.work.worker_pool import RecordParts, parts_of

router = APIRouter(prefix="/models", tags=["models"], route_class=StrictRoute, responses=PROBLEMS)

Values = Annotated[
    dict[Text, float],
    Field(max_length=50, description="Values by the effect's own parameter names."),
]
Version = Annotated[int | None, Query(description="Version (default: the newest).", ge=1, le=10**9)]
DERIVED = "derived: a comparison's signals"
"""The note of records that a comparison made."""
DERIVED_KEPT = 100
"""Of the records that comparisons made the newest are kept; a comparison makes them again at any
time.
"""
# Newest records among which those of comparisons are looked for. A page of a list.
_LOOKED_AT = 500


class Effect(BaseModel, extra="forbid"):
    """An effect at its place."""

    effect: Text
    balance: Text = Field(description="Balance, input or output.")
    parameters: Values = {}


class Curves(OnRecords):
    """Which effects' curves are wanted."""

    effects: list[Effect] = Field(min_length=1, max_length=20)


class Addition(OnRecords):
    """Which effect a model is to get."""

    add: Effect
    save_as: NewModelName = Field(
        description="The larger model becomes a new version of this model."
    )


class ParameterChange(BaseModel, extra="forbid"):
    """What is new of a parameter; what is left out stays."""

    value: float = Field(0.0, description="In the parameter's unit.")
    lower: float | None = Field(None, description="Lower bound; null: none.")
    upper: float | None = Field(None, description="Upper bound; null: none.")
    fixed: bool = Field(False, description="Whether it is kept out of the estimation.")


class ParameterChanges(BaseModel, extra="forbid"):
    """New values, bounds and fixedness by full name (`R`, `coulomb-friction@shaft.tau_c`)."""

    parameters: Annotated[dict[Text, ParameterChange], Field(min_length=1, max_length=200)]
    version: int | None = Field(
        None, ge=1, le=10**9, description="Version of the model (default: the newest)."
    )
    save_as: NewModelName = Field(
        description="The changed model becomes a new version of this model."
    )


@router.get("/built-in/descriptions")
def list_built_in() -> Response:
    """The models that come with the product, described."""
    items = [{"model": name, **describe(load_model(name))} for name in BUILT_IN]
    return Json({"items": items, "next_cursor": None})


@router.get("/{model}/description")
def get_description(running: Running, model: ModelName, version: Version = None) -> Response:
    """A model's signals, parameters, balances as expression trees, and effects with where they came
    from.
    """
    text = _text(running, model, version)
    # A stored text as it was typed, with its comments.
    file = write_model(model_of(model, None)) if text is None else text.decode()
    return Json(
        {
            "model": model,
            "version": version,
            "built_in": text is None,
            **describe(model_of(model, text)),
            "file": file,
        }
    )


@router.post("/{model}/parameters", status_code=201, response_model=ModelVersionAnswer)
def change_parameters(
    request: Request, running: Running, model: ModelName, asked: ParameterChanges
) -> Response:
    """Store the model with some parameters' values, bounds or fixedness changed, as a new
    version.
    """
    changes = {
        # Unset is not null: a field that is left out stays, null takes a bound away.
        name: change.model_dump(exclude_unset=True)
        for name, change in asked.parameters.items()
    }
    text = with_parameters(model_of(model, _text(running, model, asked.version)), changes)
    by = caller_of(request).name
    # As long as a note may be.
    note = f"changed by hand: {', '.join(changes)}"[:2000]
    version = running.store.add_model_version(asked.save_as, "physical", text.encode(), note, by)
    return Json(
        version.to_json(),
        201,
        {"Location": f"/api/v1/models/{version.model}/versions/{version.number}"},
    )


@router.post("/{model}/views", status_code=202, response_model=JobAnswer)
def view(running: Running, model: ModelName, asked: Comparison) -> Response:
    """The `compare` object with everything that is drawn beside it; `signals` become records of
    their own.
    """
    text = _text(running, model, asked.version)

    def keep(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
        # New ones first: they must not be among those that go.
        signals = [_stored(running, model, parts) for parts in outcome["signals"]]
        _let_go(running, set(signals))
        return {**outcome, "signals": signals}

    records = _records(running, asked.records)
    return accepted(
        running.jobs.submit(
            "view", view_model, model, text, records, asked.map, part_of(asked, Compare), then=keep
        )
    )


@router.post("/{model}/effect-curves", status_code=202, response_model=JobAnswer)
def curves(running: Running, model: ModelName, asked: Curves) -> Response:
    """What each of these effects would add to its balance, along every axis."""
    effects = [EffectUse(use.effect, use.balance, use.parameters) for use in asked.effects]
    text, records = _text(running, model, asked.version), _records(running, asked.records)
    return accepted(
        running.jobs.submit(
            "effect-curves", effect_curves, model, text, records, asked.map, effects
        )
    )


@router.post("/{model}/effects", status_code=202, response_model=JobAnswer)
def add(request: Request, running: Running, model: ModelName, asked: Addition) -> Response:
    """Add one effect, estimate all free parameters, and store the larger model as a new version."""
    by = caller_of(request).name
    added = asked.add

    def keep(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
        note = f"{added.effect} added to {added.balance}"
        stored = running.store.add_model_version(
            asked.save_as, "physical", outcome["file"], note, by
        )
        answer = {key: value for key, value in outcome.items() if key != "file"}
        return {**answer, "stored": {"model": asked.save_as, "version": stored.number}}

    arguments = (_text(running, model, asked.version), _records(running, asked.records), asked.map)
    use = EffectUse(added.effect, added.balance, added.parameters)
    return accepted(
        running.jobs.submit("add-effect", add_effect, model, *arguments, use, then=keep)
    )


def _text(running: Services, model: str, version: int | None) -> bytes | None:
    """The stored model's text; None for a built-in model."""
    if version is None and model in BUILT_IN:
        return None
    return content_of(running, model, "physical", version)


def _records(running: Services, numbers: Sequence[int]) -> list[RecordParts]:
    return [parts_of(running.store.record_samples(number)) for number in numbers]


def _stored(running: Services, model: str, parts: RecordParts) -> int:
    record = Record(*parts)
    # Marked by a note, by which they are known when they are let go; an uploaded record has none,
    # and stays.
    signals = Record(
        record.channels, record.units, record.sample_time, record.t0, (DERIVED,), record.source
    )
    return running.store.add_record(f"{model} beside {record.source or 'a record'}"[:200], signals)


def _let_go(running: Services, needed: set[int]) -> None:
    """Remove the oldest records that comparisons made."""
    derived = [
        record.id
        for record in running.store.records(limit=_LOOKED_AT).items
        if DERIVED in record.notes
    ]
    # Lists begin with the newest.
    for number in derived[DERIVED_KEPT:]:
        if number not in needed:
            with suppress(NotFound):  # another comparison was faster
                running.store.remove_record(number)
