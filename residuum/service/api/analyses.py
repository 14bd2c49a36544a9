"""Analyses of stored records: compare, explain and improve a model, identify one, run residuals. Each is a job."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any, Literal

import orjson
from fastapi import APIRouter, Request, Response
from pydantic import BaseModel, Field, model_validator

from residuum.identification.physics import BUILT_IN
from residuum.identification.physics.effects import EFFECTS
from residuum.library.answers.effect import effect_json
from residuum.service.api.answers import PROBLEMS, JobAnswer
from residuum.service.api.jobs import accepted
from residuum.service.api.json_response import Json, StrictRoute
from residuum.service.api.parameters import NAME, ModelName
from residuum.service.security.access import ANYBODY
from residuum.service.services import Running, Services
from residuum.service.store import Conflict, NotFound
from residuum.service.work.command_job import parts_of, run_commands

router = APIRouter(tags=["analyses"], route_class=StrictRoute, responses=PROBLEMS)

RecordNumbers = Annotated[
    list[Annotated[int, Field(ge=1, le=2**53 - 1)]],
    Field(min_length=1, max_length=64, description="Numbers of uploaded records; each is an experiment of its own."),
]
SaveAs = Annotated[str | None, Field(pattern=NAME, description="Store the resulting model under this name, as a new version.")]
Text = Annotated[str, Field(min_length=1, max_length=200)]
PLACED_EFFECT = r"^[a-z][a-z0-9-]{0,63}(@[^,@]{1,200})?$"
Names = Annotated[dict[Text, Text], Field(max_length=100, description="Model's name of a signal → record's channel.")]


class Comparison(BaseModel, extra="forbid"):
    """Which records a model is held against."""

    records: RecordNumbers
    version: int | None = Field(None, ge=1, le=10**9, description="Version of the model (default: the newest).")
    map: Names = {}


class Explanation(Comparison):
    """Which effects may explain a model's error."""

    effects: Annotated[list[Text], Field(max_length=100, description="Only these of the catalogue (default: all that fit).")] = []


class Improvement(Comparison):
    """Which effects a model is to get: those of `add`, or with `auto` whatever `explain` accepts."""

    add: Annotated[
        list[Annotated[str, Field(pattern=PLACED_EFFECT)]],
        Field(max_length=20, description="Effects to add, `id` or `id@balance` (also an input's or output's name)."),
    ] = []
    auto: bool = Field(False, description="Add what explain finds until the model is adequate.")
    effects: Annotated[list[Text], Field(max_length=100, description="With `auto`: consider only these.")] = []
    save_as: SaveAs = None

    @model_validator(mode="after")
    def _one_of_both(self) -> Improvement:
        if self.auto == bool(self.add):
            raise ValueError("give either add or auto")
        return self


class Estimation(Comparison):
    """Which records the parameters are estimated from."""

    method: Literal["simulation", "prediction", "kalman"] = Field("simulation", description="What error is minimised.")
    save_as: SaveAs = None


class Identification(BaseModel, extra="forbid"):
    """What `residuum identify` is asked for."""

    records: RecordNumbers
    input: Text = Field(description="Channel of the input.")
    output: Text = Field(description="Channel of the output.")
    method: Literal["kernel", "arx", "armax", "oe", "bj"] = Field("kernel", description="Method.")
    kernel: Literal["tc", "dc", "ss", "di"] = Field("tc", description="Prior of the impulse response.")
    order: int | None = Field(None, ge=1, le=5000, description="Length of the impulse response, or order of the model.")
    delay: int | None = Field(None, ge=0, le=10_000, description="Samples before the input acts (default: estimated).")
    save_as: SaveAs = None


class Residuals(BaseModel, extra="forbid"):
    """A residual design and the records it runs on."""

    model: str = Field(pattern=NAME, description="A stored identified model.")
    healthy: RecordNumbers
    records: RecordNumbers
    fault: Literal["sensor", "actuator"] = Field("sensor", description="Kind of fault to be most sensitive to.")
    threshold: Literal["posterior", "peak", "source", "calibrated"] = Field("posterior", description="Kind of threshold.")
    false_alarms_per_day: float = Field(1.0, gt=0, le=86400, description="For the posterior and the calibrated threshold.")


class ControlDesign(BaseModel, extra="forbid"):
    """Which models a controller is designed for."""

    models: list[Annotated[str, Field(pattern=NAME)]] = Field(
        min_length=1, max_length=16, description="Stored identified models."
    )
    aim: Literal["nominal", "robust"] = Field("nominal", description="Best behaviour, or every model of the band.")
    joined: str | None = Field(None, pattern=NAME, description="The nominal plant, of all operating points' records.")
    structure: Literal["pidn", "pid", "pi", "lead-lag", "rational"] = Field("pidn", description="Form of the controller.")
    overshoot: float = Field(0.01, gt=0, lt=1, description="nominal: least overshoot worth having (0.01 = 1 %).")
    settling_time: float | None = Field(None, gt=0, le=1e12, description="nominal: longest settling time [s].")
    slack: float = Field(0.1, gt=0, le=100, description="nominal: slack of the mixed-sensitivity bound.")
    in_time: bool = Field(False, description="nominal: hold overshoot and settling time in time.")
    low_gain: float = Field(120.0, gt=0, le=400, description="robust: l_g [dB].")
    high_gain: float = Field(-50.0, lt=-0.5, ge=-400, description="robust: least h_g [dB].")
    critical_frequency: float | None = Field(None, gt=0, le=1e12, description="robust: least ω_c [rad/s].")
    epsilon: float = Field(0.05, ge=0.005, le=0.5, description="ε of the number of plants drawn.")
    zeta: float = Field(0.05, ge=1e-6, le=0.5, description="ζ of the number of plants drawn.")
    rule: Literal["chernoff", "worst-case"] = Field("chernoff", description="What ε and ζ promise.")
    weight_order: int = Field(2, ge=0, le=8, description="Order of W_T.")
    points: int = Field(600, ge=50, le=5000, description="Frequencies of the grid.")
    lowest: float | None = Field(None, gt=0, le=1e12, description="Lowest frequency of the grid [rad/s].")


@router.get("/effects")
def list_effects() -> Response:
    """The catalogue of physical effects: equation, balances it acts on, reference."""
    return Json({"items": [effect_json(effect) for effect in EFFECTS.values()], "next_cursor": None})


@router.post("/models/{model}/compare", status_code=202, response_model=JobAnswer)
def compare(running: Running, model: ModelName, asked: Comparison) -> Response:
    """How large is the model's error on records, is it structured, and where does it lie? The result is the `compare` object."""
    return _submit(running, "compare", model, asked, [])


@router.post("/models/{model}/explain", status_code=202, response_model=JobAnswer)
def explain(running: Running, model: ModelName, asked: Explanation) -> Response:
    """Which physical effect is missing in the model? The result is the `explain` object."""
    return _submit(running, "explain", model, asked, _considered(asked.effects))


@router.post("/models/{model}/improve", status_code=202, response_model=JobAnswer)
def improve(request: Request, running: Running, model: ModelName, asked: Improvement) -> Response:
    """Add effects and estimate again; the result is the `improve` object, its errors of data not used for the estimation.

    `file` is the larger model's text; with `save_as` it becomes a version of that model, and `model_file` is its address.
    """
    _known([effect.split("@")[0] for effect in asked.add])
    wanted = ["--auto", *_considered(asked.effects)] if asked.auto else [f"--add={','.join(asked.add)}"]
    by = getattr(request.state, "caller", ANYBODY).name

    def keep(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
        found = {**_first(outcome), "model_file": None, "file": outcome["file"].decode()}
        if asked.save_as is None:
            return found
        added = [step["added"] for step in found["history"] if step["added"]]
        note = f"improved: {', '.join(added)}" if added else "improved: parameters estimated, no effect added"
        stored = running.store.add_model_version(asked.save_as, "physical", outcome["file"], note, by)
        address = f"/api/v1/models/{stored.model}/versions/{stored.number}"
        return {**found, "model_file": address, "stored": {"model": stored.model, "version": stored.number}}

    return _submit(running, "improve", model, asked, [*wanted, "--out", "@out.yaml"], out="out.yaml", keep=keep)


@router.post("/models/{model}/estimate", status_code=202, response_model=JobAnswer)
def estimate(request: Request, running: Running, model: ModelName, asked: Estimation) -> Response:
    """Estimate the model's parameters, its structure as it is."""
    options = [f"--method={asked.method}", "--out", "@out.yaml"]
    return _submit(
        running, "estimate", model, asked, options, out="out.yaml", keep=_keep(request, running, asked.save_as, "physical")
    )


@router.post("/identify", status_code=202, response_model=JobAnswer)
def identify(request: Request, running: Running, asked: Identification) -> Response:
    """Identify a linear model with its uncertainty."""
    records = _records(running, asked.records)
    delay = "estimate" if asked.delay is None else str(asked.delay)
    options = [f"--input={asked.input}", f"--output={asked.output}", f"--method={asked.method}", f"--kernel={asked.kernel}"]
    options += [f"--delay={delay}", *([] if asked.order is None else [f"--order={asked.order}"]), "--out", "@out.json"]
    step = ["identify", *(f"@{name}" for name in records), *options]
    keep = _keep(request, running, asked.save_as, "identified")
    return accepted(running.jobs.submit("identify", run_commands, [step], {}, records, "out.json", then=keep))


@router.post("/residuals", status_code=202, response_model=JobAnswer)
def residuals(running: Running, asked: Residuals) -> Response:
    """Design a residual generator from an identified model and run it on records: `design`, and a `run` a record."""
    healthy, records = _records(running, asked.healthy), _records(running, asked.records)
    files = {"model.json": _content(running, asked.model, "identified", None)}
    design = ["residual", "design", "@model.json", "--out", "@design.json", f"--fault={asked.fault}"]
    for name in healthy:
        design += ["--healthy", f"@{name}"]
    run = ["residual", "run", "@design.json"]
    options = [f"--threshold={asked.threshold}", f"--false-alarms-per-day={asked.false_alarms_per_day}"]
    steps = [design, *([*run, f"@{name}", *options] for name in records)]

    def named(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
        made, *runs = outcome["results"]
        return {"design": made, "runs": [found | {"record": number} for found, number in zip(runs, asked.records, strict=True)]}

    return accepted(running.jobs.submit("residuals", run_commands, steps, files, healthy | records, then=named))


@router.post("/control-designs", status_code=202, response_model=JobAnswer)
def design_controller(running: Running, asked: ControlDesign) -> Response:
    """Design a controller from identified models, one an operating point; the result holds the controller."""
    files = {f"model-{number}.json": _content(running, name, "identified", None) for number, name in enumerate(asked.models)}
    given = asked.model_dump(exclude={"models", "joined", "in_time"}, exclude_none=True)
    options = [f"--{name.replace('_', '-')}={value}" for name, value in given.items()]
    options += ["--in-time"] if asked.in_time else []
    step = ["control", "design", *(f"@{file}" for file in files), *options, "--out", "@controller.json"]
    if asked.joined is not None:
        files["joined.json"] = _content(running, asked.joined, "identified", None)
        step += ["--joined", "@joined.json"]
    return accepted(running.jobs.submit("control-designs", run_commands, [step], files, {}, "controller.json", then=_with_file))


Keep = Callable[[Mapping[str, Any]], Mapping[str, Any]]


def _with_file(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
    """The one command's object, with the file that it wrote."""
    return {**_first(outcome), "file": orjson.loads(outcome["file"])}


def _first(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
    """The one command's object."""
    result: Mapping[str, Any] = outcome["results"][0]
    return result


def _keep(request: Request, running: Services, name: str | None, kind: str) -> Keep:
    """Store the file that a command wrote as a version of model `name`, and say so in the result."""
    by = getattr(request.state, "caller", ANYBODY).name

    def keep(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
        result = {key: value for key, value in _first(outcome).items() if key not in ("file", "model_file")}
        if name is None:
            return result
        version = running.store.add_model_version(name, kind, outcome["file"], "made by a job", by)
        return {**result, "stored": {"model": name, "version": version.number}}

    return keep


def _considered(effects: Sequence[str]) -> list[str]:
    """The option that leaves the other effects of the catalogue out."""
    _known(effects)
    return [f"--effects={','.join(effects)}"] if effects else []


def _known(effects: Sequence[str]) -> None:
    if unknown := [effect for effect in effects if effect not in EFFECTS]:
        raise NotFound(f"effect {unknown[0][:60]!r}: is not in the catalogue; GET /effects lists it")


def _submit(
    running: Services, command: str, model: str, asked: Comparison, options: Sequence[str], *, out: str = "", keep: Keep = _first
) -> Response:
    """A job that runs one command on a model and records."""
    records = _records(running, asked.records)
    built_in = asked.version is None and model in BUILT_IN
    files = {} if built_in else {"model.yaml": _content(running, model, "physical", asked.version)}
    step = [command, model if built_in else "@model.yaml", *(f"@{name}" for name in records), *options]
    step += [part for name, channel in asked.map.items() for part in ("--map", f"{name}={channel}")]
    return accepted(running.jobs.submit(command, run_commands, [step], files, records, out, then=keep))


def _records(running: Services, numbers: Sequence[int]) -> dict[str, Any]:
    return {f"record-{number}.npz": parts_of(running.store.record_samples(number)) for number in numbers}


def _content(running: Services, model: str, kind: str, version: int | None) -> bytes:
    found = running.store.model_versions(model)[0].kind
    if found != kind:
        raise Conflict(f"model {model!r}: is a {found} model; this needs a {kind} one")
    return running.store.model_content(model, version)
