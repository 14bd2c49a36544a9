"""The method that decides for a machine whose diagnoser has two."""

from __future__ import annotations

from typing import Any, Literal

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, Field

from residuum.service.api.answers import PROBLEMS
from residuum.service.api.parameters import AssetName
from residuum.service.api.responses import Json, StrictRoute
from residuum.service.machines.baselines import choose_method, chosen_method
from residuum.service.machines.scoring import diagnoser_class
from residuum.service.services import Running, Services, caller_of

router = APIRouter(
    prefix="/assets/{asset}/method", tags=["machines"], route_class=StrictRoute, responses=PROBLEMS
)


class Deciding(BaseModel, extra="forbid"):
    """The method that is to decide."""

    method: Literal["source", "default"] | None = Field(
        description="null: as the baseline was trained, or the settings say."
    )


@router.get("")
def get_method(running: Running, asset: AssetName) -> Response:
    """The methods of a machine's diagnoser, and which was chosen to decide; findings hold what both
    say.
    """
    return Json(_described(running, asset))


@router.put("")
def put_method(request: Request, running: Running, asset: AssetName, asked: Deciding) -> Response:
    """Let a method decide from the machine's next window on."""
    choose_method(running.store, asset, asked.method, caller_of(request).name)
    return Json(_described(running, asset))


def _described(running: Services, asset: str) -> dict[str, Any]:
    diagnoser = running.store.asset(asset).diagnoser
    methods = [] if diagnoser is None else list(diagnoser_class(diagnoser).methods)
    return {
        "diagnoser": diagnoser,
        "methods": methods,
        "chosen": chosen_method(running.store, asset),
    }
