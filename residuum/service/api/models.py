"""Stored models and their versions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from fastapi import APIRouter, Path, Query, Request, Response
from starlette.concurrency import run_in_threadpool

from residuum.service.api.answers import PROBLEMS, ModelVersionAnswer, PageOf
from residuum.service.api.parameters import TEXT, Cursor, Limit, ModelName, NewModelName
from residuum.service.api.responses import Json, in_pieces, page_answer
from residuum.service.api.signal_body import body_of
from residuum.service.model_files import (
    MODEL_KINDS,
    check_long_model_file,
    check_model_file,
    is_read_apart,
)
from residuum.service.services import Running, Services, caller_of
from residuum.service.store import ModelVersion, NotFound

router = APIRouter(prefix="/models", tags=["models"], responses=PROBLEMS)

VersionNumber = Annotated[int, Path(description="Number of the version.", ge=1, le=10**9)]
Kind = Literal["physical", "identified", "baseline", "fmu"]
_MODEL_BODY = {
    "requestBody": {
        "required": True,
        "description": (
            "The model file's bytes: YAML (physical), JSON (identified), a stored diagnoser"
            " (baseline) or an FMU (fmu), which is native code: the setting allow_fmus must be on."
        ),
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}


@router.post("", status_code=201, response_model=ModelVersionAnswer, openapi_extra=_MODEL_BODY)
async def add_model(
    request: Request,
    running: Running,
    name: Annotated[
        NewModelName, Query(description="Name of the model; a known one gets a new version.")
    ],
    kind: Annotated[Kind, Query(description="What the file is.")] = "physical",
    diagnoser: Annotated[
        str | None, Query(description="baseline: of which diagnoser.", max_length=64)
    ] = None,
    note: Annotated[
        str, Query(description="What is new in this version.", max_length=2000, pattern=TEXT)
    ] = "",
) -> Response:
    """Store a model, or a new version of one. The file is read and checked first; nothing else is
    stored.
    """
    content = await body_of(request)
    # A long or packed file is read in a process with limits.
    if is_read_apart(kind, content):
        settings = running.settings
        await running.reading(
            check_long_model_file,
            kind,
            content,
            diagnoser,
            memory=settings.upload_memory,
            seconds=settings.upload_seconds,
            fmus=settings.allow_fmus,
        )
    else:
        await run_in_threadpool(check_model_file, kind, content, diagnoser)
    caller = caller_of(request).name
    version = await run_in_threadpool(
        running.store.add_model_version, name, kind, content, note, caller
    )
    return Json(
        version.to_json(), 201, {"Location": f"/api/v1/models/{name}/versions/{version.number}"}
    )


@router.get("", response_model=PageOf[ModelVersionAnswer])
async def list_models(
    running: Running,
    kind: Annotated[Kind | None, Query(description="Only these.")] = None,
    cursor: Cursor = None,
    limit: Limit = 100,
) -> Response:
    """The newest version of every model, by name."""
    return await page_answer(running, running.store.models, kind, cursor, limit)


@router.get("/{model}/versions", response_model=PageOf[ModelVersionAnswer])
def list_versions(running: Running, model: ModelName) -> Response:
    """All versions of a model, newest first."""
    return Json(
        {"items": [version.to_json() for version in _versions(running, model)], "next_cursor": None}
    )


@router.get("/{model}/versions/{number}", response_class=Response)
def get_version(running: Running, model: ModelName, number: VersionNumber) -> Response:
    """The file of one version, as it was stored."""
    media, ending = MODEL_KINDS[_versions(running, model)[0].kind]
    content = running.store.model_content(model, number)
    # Saved, never shown: a file of a user's must not be a page of this origin.
    headers = {"Content-Disposition": f'attachment; filename="{model}-{number}{ending}"'}
    return in_pieces(content, media, headers)


def _versions(running: Services, model: str) -> Sequence[ModelVersion]:
    """Versions of a model, newest first; NotFound also for a machine's document, which is no
    model.
    """
    versions = running.store.model_versions(model)
    if versions[0].kind not in MODEL_KINDS:
        raise NotFound(f"model {model!r}: there is none of this name; GET /models lists them")
    return versions
