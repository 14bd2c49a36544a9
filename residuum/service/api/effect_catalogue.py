"""The catalogue of physical effects beside its list: what each looks like, and in which models it
is.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from typing import Any

from fastapi import APIRouter, Response
from pydantic import BaseModel, Field

from residuum.identification.physics import BUILT_IN, PhysicalModel, load_model
from residuum.identification.physics.compile.effect_signature import signature
from residuum.identification.physics.effects import EFFECTS
from residuum.service.api.answers import PROBLEMS
from residuum.service.api.responses import Json, StrictRoute
from residuum.service.services import Running
from residuum.service.views.model_view import model_of

router = APIRouter(
    prefix="/effects", tags=["analyses"], route_class=StrictRoute, responses=PROBLEMS
)

# Stored models whose effects are listed. Each is read and parsed for the answer.
_MOST_MODELS = 200
# Of a number of a curve that is drawn. More than a screen resolves; a third of the bytes of a
# float's 17.
_DIGITS = 5


class EffectParameter(BaseModel):
    """A parameter and the value that the signature is drawn with."""

    name: str
    value: float
    unit: str
    meaning: str


class EffectSignature(BaseModel):
    """A curve of the effect's term, or of a path's signal, in a standard movement."""

    effect: str
    kind: str = Field(description="Kind of balance, `input` or `output`, that it is drawn for.")
    axis: str
    axis_unit: str
    unit: str = Field(description="Of `value` and `before`.")
    at: list[float]
    value: list[float]
    before: list[float] | None = Field(
        description="The path's signal without the effect; null for a balance."
    )
    parameters: list[EffectParameter]


class EffectUse(BaseModel):
    """An effect in a model."""

    effect: str
    model: str
    version: int | None = Field(
        description="Newest version; null for a model that comes with the product."
    )
    balance: str


class Signatures(BaseModel):
    """All signatures, in the catalogue's order."""

    items: list[EffectSignature]
    next_cursor: None


class Uses(BaseModel):
    """All uses, of the newest versions of up to 200 models."""

    items: list[EffectUse]
    next_cursor: None


@router.get("/signatures", response_model=Signatures)
def list_signatures() -> Response:
    """What each effect looks like: its own equation along a standard movement, against its natural
    argument.
    """
    return Json({"items": _signatures(), "next_cursor": None})


@router.get("/uses", response_model=Uses)
def list_uses(running: Running) -> Response:
    """In which models each effect is: those that come with the product, and the newest versions of
    the stored ones.
    """
    stored = running.store.models("physical", None, _MOST_MODELS).items
    uses = [use for name in BUILT_IN for use in _uses(name, None, load_model(name))]
    for entry in stored:
        uses += _uses(
            entry.model,
            entry.number,
            model_of(entry.model, running.store.model_content(entry.model, entry.number)),
        )
    return Json({"items": uses, "next_cursor": None})


def _uses(name: str, version: int | None, model: PhysicalModel) -> Iterator[dict[str, Any]]:
    for use in model.effects:
        yield {"effect": use.id, "model": name, "version": version, "balance": use.target}


# Made once: they are the catalogue's own equations, which do not change while the service runs.
@lru_cache(maxsize=1)
def _signatures() -> list[dict[str, Any]]:
    return [_signature(id) for id in EFFECTS]


def _signature(id: str) -> dict[str, Any]:
    drawn = signature(EFFECTS[id])
    parameters = [
        {"name": p.name, "value": p.value, "unit": p.unit, "meaning": p.meaning}
        for p in drawn.parameters
    ]
    curves = {"at": drawn.at, "value": drawn.value, "before": drawn.before}
    short = {
        name: None if y is None else [float(f"{v:.{_DIGITS}g}") for v in y]
        for name, y in curves.items()
    }
    described = {
        "kind": drawn.kind,
        "axis": drawn.axis,
        "axis_unit": drawn.axis_unit,
        "unit": drawn.unit,
    }
    return {"effect": id, **described, **short, "parameters": parameters}
