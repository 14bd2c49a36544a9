"""Analyses of stored records: compare, explain and improve a model, identify one, run residuals.
Each is a job.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any

from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, BeforeValidator, Field, model_validator

from residuum.identification.errors import BadInput
from residuum.identification.physics import BUILT_IN
from residuum.identification.physics.effects import EFFECTS, STRUCTURAL
from residuum.library.answers.effect import effect_json
from residuum.library.questions import field, part_of
from residuum.library.questions.compare import Compare
from residuum.library.questions.control_design import DesignController
from residuum.library.questions.estimate import Estimate
from residuum.library.questions.identify import Identify
from residuum.library.questions.missing_effect import Explain, Improve
from residuum.library.questions.residual import DesignResidual, RunResidual
from residuum.robust_control.controller_export import LANGUAGES
from residuum.service.api.answers import PROBLEMS, JobAnswer
from residuum.service.api.parameters import NAME, ModelName, NewModelName
from residuum.service.api.responses import Json, StrictRoute, accepted
from residuum.service.services import Running, Services, caller_of
from residuum.service.store import Conflict, NotFound
from residuum.service.views import analyses
from residuum.service.views.analyses import Asked
from residuum.service.views.model_view import model_of
from residuum.service.work.worker_pool import RecordParts, parts_of

router = APIRouter(tags=["analyses"], route_class=StrictRoute, responses=PROBLEMS)

# Up to what JavaScript, and with it the page, tells from its neighbours.
RecordNumbers = Annotated[
    list[Annotated[int, Field(ge=1, le=2**53 - 1)]],
    Field(
        min_length=1,
        max_length=64,
        description="Numbers of uploaded records; each is a separate experiment.",
    ),
]
SaveAs = Annotated[
    NewModelName | None,
    Field(description="Store the resulting model under this name, as a new version."),
]
Text = Annotated[str, Field(min_length=1, max_length=200)]
Names = Annotated[
    dict[Text, Text],
    Field(max_length=100, description="Model's name of a signal → record's channel."),
]


# Unknown fields are refused: passed over, a mistyped one would leave an answer to another question.
class OnRecords(BaseModel, extra="forbid"):
    """Which records a model is held against."""

    records: RecordNumbers
    version: int | None = Field(
        None, ge=1, le=10**9, description="Version of the model (default: the newest)."
    )
    map: Names = {}


class Comparison(Compare, OnRecords):
    """The question `compare` of a stored model and stored records."""


class Explanation(Explain, OnRecords):
    """The question `explain` of a stored model and stored records."""


class Improvement(Improve, OnRecords):
    """The question `improve` of a stored model and stored records."""

    save_as: SaveAs = None


class Estimation(Estimate, OnRecords):
    """The question `estimate` of a stored model and stored records."""

    save_as: SaveAs = None


class Identification(Identify):
    """The question `identify` of stored records."""

    records: RecordNumbers
    save_as: SaveAs = None

    @model_validator(mode="after")
    # Refused before the job: minutes later it would have nothing that could be stored.
    def _one_path_is_kept(self) -> Identification:
        if self.save_as is not None and self.is_multivariable:
            raise BadInput(
                repr(self.save_as),
                "save_as",
                "stored models have one input and one output; leave it out",
            )
        return self


class Residuals(DesignResidual, RunResidual):
    """The questions `residual design` of a stored model and `residual run` of stored records."""

    model: str = Field(pattern=NAME, description="A stored identified model.")
    healthy: RecordNumbers
    records: RecordNumbers


class ModelVersion(BaseModel, extra="forbid"):
    """A stored identified model."""

    model: str = Field(pattern=NAME)
    version: int | None = Field(None, ge=1, le=10**9, description="Null: the newest.")


# A name alone is how bodies named models before versions could be said.
def _as_version(given: object) -> object:
    return {"model": given} if isinstance(given, str) else given


Identified = Annotated[
    ModelVersion, BeforeValidator(_as_version, json_schema_input_type=ModelName | ModelVersion)
]
"""A stored identified model, by its name where the newest version is meant."""


class ControlDesign(DesignController):
    """The question `control design` of stored models."""

    models: list[Identified] = Field(
        min_length=1, max_length=16, description="Stored identified models, one an operating point."
    )
    joined: Identified | None = Field(
        None, description="The nominal plant, of all operating points' records."
    )
    export: str | None = field(
        None, "Language of the controller as source text, in `exported`.", choices=LANGUAGES
    )


@router.get("/effects")
def list_effects() -> Response:
    """The catalogue of physical effects: equation, balances it acts on, reference."""
    return Json(
        {"items": [effect_json(effect) for effect in EFFECTS.values()], "next_cursor": None}
    )


@router.post("/models/{model}/compare", status_code=202, response_model=JobAnswer)
def compare(running: Running, model: ModelName, asked: Comparison) -> Response:
    """How large is the model's error on records, is it structured, and where does it lie? The
    result is the `compare` object.
    """
    work = _asked(running, model, asked)
    return accepted(
        running.jobs.submit(
            "compare", analyses.compare, work, part_of(asked, Compare), then=_result
        )
    )


@router.post("/models/{model}/explain", status_code=202, response_model=JobAnswer)
def explain(running: Running, model: ModelName, asked: Explanation) -> Response:
    """Which physical effect is missing in the model? The result is the `explain` object."""
    work, question = _asked(running, model, asked), part_of(asked, Explain)
    # Here and not in the job: a mistyped effect is refused at once, with 404, and starts no
    # process.
    _check_known(question, question.effects, work)
    return accepted(running.jobs.submit("explain", analyses.explain, work, question, then=_result))


@router.post("/models/{model}/improve", status_code=202, response_model=JobAnswer)
def improve(request: Request, running: Running, model: ModelName, asked: Improvement) -> Response:
    """Add effects and estimate again; the result is the `improve` object, its errors of data not
    used for the estimation.

    `file` is the larger model's text; with `save_as` it becomes a version of that model, and
    `model_file` is its address.
    """
    work, question = _asked(running, model, asked), part_of(asked, Improve)
    _check_known(question, question.add or question.effects, work)
    by = caller_of(request).name

    def keep(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
        answer = {**outcome["result"], "model_file": None, "file": outcome["file"].decode()}
        # nothing that would not make it worse
        if asked.save_as is None or (answer["refused"] and len(answer["history"]) == 1):
            return answer
        added = [step["added"] for step in answer["history"] if step["added"]]
        note = (
            f"improved: {', '.join(added)}"
            if added
            else "improved: parameters estimated, no effect added"
        )
        stored = running.store.add_model_version(
            asked.save_as, "physical", outcome["file"], note, by
        )
        address = f"/api/v1/models/{stored.model}/versions/{stored.number}"
        return {
            **answer,
            "model_file": address,
            "stored": {"model": stored.model, "version": stored.number},
        }

    return accepted(running.jobs.submit("improve", analyses.improve, work, question, then=keep))


@router.post("/models/{model}/estimate", status_code=202, response_model=JobAnswer)
def estimate(request: Request, running: Running, model: ModelName, asked: Estimation) -> Response:
    """Estimate the model's parameters, its structure as it is."""
    keep = _keep(request, running, asked.save_as, "physical")
    work = _asked(running, model, asked)
    return accepted(
        running.jobs.submit(
            "estimate", analyses.estimate, work, part_of(asked, Estimate), then=keep
        )
    )


@router.post("/identify", status_code=202, response_model=JobAnswer)
def identify(request: Request, running: Running, asked: Identification) -> Response:
    """Identify a linear model with its uncertainty."""
    keep = _keep(request, running, asked.save_as, "identified")
    work = (_records(running, asked.records), part_of(asked, Identify))
    return accepted(running.jobs.submit("identify", analyses.identify, *work, then=keep))


@router.post("/residuals", status_code=202, response_model=JobAnswer)
def residuals(running: Running, asked: Residuals) -> Response:
    """Design a residual generator from an identified model and run it on records: `design`, and a
    `run` a record.
    """
    healthy, records = _records(running, asked.healthy), _records(running, asked.records)
    # Read before the job is made: it gets bytes, for its process has no store.
    content = content_of(running, asked.model, "identified", None)
    questions = part_of(asked, DesignResidual), part_of(asked, RunResidual)

    def named(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
        # Results name records by their numbers, which the process does not know.
        runs = zip(outcome["runs"], asked.records, strict=True)
        return {
            "design": outcome["design"],
            "runs": [run | {"record": number} for run, number in runs],
        }

    work = (content, healthy, records, *questions)
    return accepted(running.jobs.submit("residuals", analyses.residuals, *work, then=named))


@router.post("/control-designs", status_code=202, response_model=JobAnswer)
def design_controller(running: Running, asked: ControlDesign) -> Response:
    """Design a controller from identified models, one an operating point; the result holds the
    controller.
    """
    names = [ref.model for ref in asked.models]
    work = (names, *models_of(running, asked), part_of(asked, DesignController), asked.export)
    return accepted(
        running.jobs.submit("control-designs", analyses.design_controller, *work, then=_with_file)
    )


def models_of(running: Services, asked: ControlDesign) -> tuple[list[bytes], bytes | None]:
    """The files of the models that a controller is designed for, and that of the nominal plant."""
    contents = [content_of(running, ref.model, "identified", ref.version) for ref in asked.models]
    joined = asked.joined
    return contents, (
        None if joined is None else content_of(running, joined.model, "identified", joined.version)
    )


Keep = Callable[[Mapping[str, Any]], Mapping[str, Any]]


def _result(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
    """What the work found."""
    result: Mapping[str, Any] = outcome["result"]
    return result


def _with_file(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
    """The design, with itself as the file that holds the controller; an infeasible one has none."""
    design = outcome["result"]
    return {**design, "file": design if design.get("feasible", False) else None}


def _keep(request: Request, running: Services, name: str | None, kind: str) -> Keep:
    """Store the file that the work made as a version of model `name`, and say so in the result."""
    by = caller_of(request).name

    def keep(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
        result = {
            key: value
            for key, value in outcome["result"].items()
            if key not in ("file", "model_file")
        }
        # Some answers have no file to keep, such as that of a search that did not come to rest.
        if name is None or outcome["file"] is None:
            return result
        version = running.store.add_model_version(name, kind, outcome["file"], "made by a job", by)
        return {**result, "stored": {"model": name, "version": version.number}}

    return keep


def _check_known(question: Explain, names: Sequence[str] | None, given: Asked) -> None:
    """Raise NotFound for an effect that neither the catalogue nor the model's file defines."""
    # which effects its text defines is known where it is read: in the job
    if names is None or question.catalogue is not None:
        return
    if given.text is not None:
        # its own effects are in the catalogue of this request from now on
        model_of(given.model, given.text)
    # `ID@BALANCE` and `ID:SIZE` are the written forms of an effect.
    ids = [re.split("[@:]", name)[0] for name in names]
    unknown = [id for id in ids if id not in EFFECTS and id not in STRUCTURAL]
    if unknown:
        raise NotFound(
            f"effect {unknown[0][:60]!r}: neither in the catalogue (GET /effects lists it) nor in"
            " the model file's own_effects"
        )


def _asked(running: Services, model: str, asked: OnRecords) -> Asked:
    """The model, the built-in one where no version is named, and what it is held against."""
    # A version names a stored model, even one of a built-in model's name.
    built_in = asked.version is None and model in BUILT_IN
    text = None if built_in else content_of(running, model, "physical", asked.version)
    return Asked(model, text, _records(running, asked.records), asked.map)


def _records(running: Services, numbers: Sequence[int]) -> list[RecordParts]:
    return [
        parts_of(running.store.record_samples(number), f"record-{number}.npz") for number in numbers
    ]


def content_of(running: Services, model: str, kind: str, version: int | None) -> bytes:
    """The file of a stored model's version (None: the newest); Conflict for one of another kind."""
    # A name has one kind for all its versions, so the newest tells it.
    actual = running.store.model_versions(model)[0].kind
    if actual != kind:
        raise Conflict(
            f"model {model!r}: is a {actual} model; this needs"
            f" {'an' if kind == 'identified' else 'a'} {kind} one"
        )
    return running.store.model_content(model, version)
