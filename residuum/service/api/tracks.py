"""Parameters of a machine over many windows: control charts, limits, and the picture of what the
model lacks.
"""

from __future__ import annotations

from typing import Annotated, Any

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, Field

from residuum.service.api.answers import PROBLEMS, JobAnswer
from residuum.service.api.parameters import AssetName
from residuum.service.api.responses import Json, StrictRoute, accepted
from residuum.service.machines.adding import model_of_settings, stored_model
from residuum.service.machines.tracks import (
    follow,
    keep_limits,
    limits_of,
    missing_terms,
    told_parameters,
)
from residuum.service.services import Running, Services, caller_of
from residuum.service.store import Conflict, NotFound, SignalLetGo
from residuum.service.work.worker_pool import parts_of

router = APIRouter(
    prefix="/assets/{asset}", tags=["tracks"], route_class=StrictRoute, responses=PROBLEMS
)

Name = Annotated[str, Field(min_length=1, max_length=200)]
# Healthy windows that a picture is held beside. Each is simulated and smoothed on its own.
_HEALTHY = 3


class Limits(BaseModel, extra="forbid"):
    """What must not be passed."""

    limits: dict[Name, Annotated[float, Field(allow_inf_nan=False)]] = Field(
        max_length=200, description="Parameter → limit, in its unit."
    )


class Following(BaseModel, extra="forbid"):
    """What the parameters are corrected for."""

    moves_with: list[Name] | None = Field(
        None, max_length=10, description="Signals; default: every recorded temperature."
    )


class Picture(BaseModel, extra="forbid"):
    """The window that is held beside healthy ones."""

    window: int = Field(ge=1, le=2**53 - 1)


@router.get("/limits")
def get_limits(running: Running, asset: AssetName) -> Response:
    """The limits of a machine's parameters."""
    running.store.asset(asset)
    return Json({"limits": limits_of(running.store, asset)})


@router.put("/limits")
def put_limits(request: Request, running: Running, asset: AssetName, asked: Limits) -> Response:
    """Set the limits of a machine's parameters, in the place of those before."""
    running.store.asset(asset)
    keep_limits(running.store, asset, asked.limits, caller_of(request).name)
    return Json({"limits": limits_of(running.store, asset)})


@router.post("/tracks", status_code=202, response_model=JobAnswer)
def follow_parameters(running: Running, asset: AssetName, asked: Following) -> Response:
    """Follow every parameter and effect over the windows: drift, sudden change, recovery, and the
    time until its limit.

    The result has an item a parameter, with its healthy band, its windows and its track.
    """
    parameters = told_parameters(running.store, asset)
    return accepted(
        running.jobs.submit(
            "tracks", follow, parameters, limits_of(running.store, asset), asked.moves_with
        )
    )


@router.post("/missing-terms", status_code=202, response_model=JobAnswer)
def picture_of_missing_terms(running: Running, asset: AssetName, asked: Picture) -> Response:
    """What the model's balances lack in one window, beside what they lack in the newest healthy
    ones.
    """
    window = parts_of(running.store.window_record(asset, asked.window))
    healthy = _healthy(running, asset, asked.window)
    channels, model = _model(running, asset)
    return accepted(
        running.jobs.submit("missing-terms", missing_terms, model, window, healthy, channels)
    )


def _healthy(running: Services, asset: str, but: int) -> list[Any]:
    """The newest healthy windows, or recorded ones where none has been judged; Conflict when there
    are none.
    """
    # More than are shown: of some the signal was let go.
    judged = [f.window for f in running.store.findings(asset, limit=50, verdict="healthy").items]
    healthy: list[Any] = []
    # The newest first; the window itself is not held beside itself.
    for number in judged or list(running.store.recorded_windows(asset))[::-1]:
        if number != but and len(healthy) < _HEALTHY:
            try:
                healthy.append(parts_of(running.store.window_record(asset, number)))
            except SignalLetGo:
                continue
    if not healthy:
        raise Conflict(f"asset {asset!r}: no healthy window is kept to compare with")
    return healthy


def _model(running: Services, asset: str) -> tuple[dict[str, str], Any]:
    """The machine's channels and its active model, or the one of its settings."""
    try:
        settings = running.pipeline.machine(asset)
    except NotFound:
        settings = None
    channels = {} if settings is None else dict(settings.channels)
    try:
        return channels, stored_model(running.store, f"{asset}.model")
    except NotFound:
        if settings is None or settings.model is None:
            raise Conflict(
                f"asset {asset!r}: has no active model; accept one on the workbench"
            ) from None
        return channels, model_of_settings(running.store, settings.model)
