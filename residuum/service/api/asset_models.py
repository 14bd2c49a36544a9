"""The model that a machine is held against: proposing one with new thresholds, accepting it, and
who accepted what when.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, Field

from residuum.identification.physics import write_model
from residuum.service.api.analyses import Names
from residuum.service.api.answers import PROBLEMS, JobAnswer, ModelVersionAnswer
from residuum.service.api.parameters import NAME, TEXT, AssetName
from residuum.service.api.responses import Json, StrictRoute, accepted
from residuum.service.machines.adding import ModelText, stored_model
from residuum.service.machines.baselines import (
    baseline_name,
    healthy_windows,
    newest_baseline,
    parted,
    propose,
)
from residuum.service.services import Running, Services, caller_of
from residuum.service.store import Conflict, NotFound
from residuum.service.views.model_view import model_of
from residuum.service.work.worker_pool import parts_of

router = APIRouter(
    prefix="/assets/{asset}", tags=["assets"], route_class=StrictRoute, responses=PROBLEMS
)

_LONGEST = 55  # with an ending, an asset's name must still be a model's


class Candidate(BaseModel, extra="forbid"):
    """A version of a physical model."""

    model: str = Field(pattern=NAME, description="A stored or built-in physical model.")
    version: int | None = Field(
        None, ge=1, le=10**9, description="Version of the model (default: the newest)."
    )


class Proposal(Candidate):
    """A model that may become the machine's."""

    map: Names = {}


class Acceptance(Candidate):
    """A model that becomes the machine's active version."""

    proposal: int | None = Field(
        None,
        ge=1,
        le=10**9,
        description="Number of the proposal whose thresholds are used; null: keep.",
    )
    note: str = Field("", max_length=1000, pattern=TEXT, description="Why.")


class ActiveModel(BaseModel):
    """The machine's active model, a model of its own, and all that were accepted before, newest
    first.
    """

    active: ModelVersionAnswer | None
    history: list[ModelVersionAnswer]


@router.get("/model", response_model=ActiveModel)
def get_model(running: Running, asset: AssetName) -> Response:
    """The active model of a machine, null before one was accepted; its versions say who accepted
    which model when.
    """
    running.store.asset(asset)
    return Json(_accepted(running, asset))


@router.post("/model-proposals", status_code=202, response_model=JobAnswer)
def propose_model(
    request: Request, running: Running, asset: AssetName, asked: Proposal
) -> Response:
    """Learn the thresholds of the machine's diagnoser anew from its healthy windows; nothing is
    active before it is accepted.

    The result holds thresholds and model errors, old against new, the alarms of both on healthy
    windows kept aside, and the number of the `proposal`.
    """
    diagnoser = running.store.asset(asset).diagnoser
    if diagnoser is None:
        raise Conflict(f"asset {asset!r}: has no diagnoser whose thresholds could be derived")
    # Learned from the earlier ones, checked on the later: windows that overlap are joined before,
    # so that none is on both sides.
    to_learn, kept_aside = parted(healthy_windows(running.store, asset))
    learned = [parts_of(record) for record in to_learn]
    checked = [parts_of(record) for record in kept_aside]
    models = (
        _stored(running, _active(asset), None),
        stored_model(running.store, asked.model, asked.version),
    )
    by, name = caller_of(request).name, _named(asset, "proposed")

    def keep(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
        note = f"{diagnoser} relearned for {_said(asked)}"
        # Under a name of its own, which nobody judges by: a proposal changes nothing before it is
        # accepted.
        version = running.store.add_model_version(name, "baseline", outcome["baseline"], note, by)
        return {
            **{key: value for key, value in outcome.items() if key != "baseline"},
            "proposal": version.number,
        }

    arguments = (diagnoser, _baseline(running, asset), learned, checked, models, asked.map)
    return accepted(running.jobs.submit("propose-model", propose, *arguments, then=keep))


@router.post("/model", status_code=201, response_model=ActiveModel)
def accept_model(
    request: Request, running: Running, asset: AssetName, asked: Acceptance
) -> Response:
    """Make a model the machine's active one; with a proposal, its diagnoser judges with the new
    thresholds from now on.
    """
    running.store.asset(asset)
    name, text = stored_model(running.store, asked.model, asked.version)
    # A copy of the text, for built-in models too: what was accepted stays as it was after an
    # update.
    content = write_model(model_of(name, None)).encode() if text is None else text
    by, remark = caller_of(request).name, f"{_said(asked)}{f': {asked.note}' if asked.note else ''}"
    # The thresholds first: the model is the active one only when they are kept.
    if asked.proposal is not None:
        baseline = running.store.model_content(_named(asset, "proposed"), asked.proposal)
        note = f"accepted with {_said(asked)}, proposal {asked.proposal}"
        running.store.add_model_version(
            baseline_name(running.store, asset), "baseline", baseline, note, by
        )
        remark += f" (thresholds of proposal {asked.proposal})"
    running.store.add_model_version(_active(asset), "physical", content, remark, by)
    # Told last: who hears of it judges by it.
    running.events.publish("model-accepted", {"asset": asset, "model": asked.model, "by": by})
    return Json(_accepted(running, asset), 201, {"Location": f"/api/v1/assets/{asset}/model"})


def _accepted(running: Services, asset: str) -> dict[str, Any]:
    try:
        history = [version.to_json() for version in running.store.model_versions(_active(asset))]
    except NotFound:
        return {"active": None, "history": []}
    return {"active": history[0], "history": history}


def _said(asked: Candidate) -> str:
    return asked.model if asked.version is None else f"{asked.model}, version {asked.version}"


def _active(asset: str) -> str:
    return _named(asset, "model")


def _named(asset: str, ending: str) -> str:
    if len(asset) > _LONGEST:
        raise Conflict(
            f"asset {asset!r}: its name is longer than the {_LONGEST} characters that a machine"
            " with a model may have"
        )
    return f"{asset}.{ending}"


def _stored(running: Services, model: str, version: int | None) -> ModelText | None:
    try:
        return model, running.store.model_content(model, version)
    except NotFound:
        return None


def _baseline(running: Services, asset: str) -> bytes | None:
    try:
        return running.store.model_content(newest_baseline(running.store, asset).model)
    except NotFound:
        return None
