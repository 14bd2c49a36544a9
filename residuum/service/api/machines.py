"""Machines that are watched: adding one while the service runs, what its signals read, and training
its baseline.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, Literal

from fastapi import APIRouter, Path, Query, Request, Response
from pydantic import BaseModel, Field, ValidationError
from starlette.concurrency import run_in_threadpool

from residuum.identification.errors import BadInput, Forbidden
from residuum.identification.physics import write_model
from residuum.identification.physics.fmu.permission import is_packed
from residuum.library.questions import field
from residuum.service.api.answers import PROBLEMS, JobAnswer
from residuum.service.api.parameters import NAME
from residuum.service.api.responses import Json, StrictRoute, accepted
from residuum.service.broker import with_hidden_password
from residuum.service.machines.adding import (
    DESCRIPTIONS,
    OF_SOURCE,
    ModelText,
    WatchedMachine,
    bus_description,
    document_name,
    forget_machine,
    guessed_channels,
    keep_machine,
    kept_maps,
    model_of_settings,
    model_signals,
    named,
    stored_model,
    with_kept_passwords,
    with_server_files,
)
from residuum.service.machines.baselines import (
    MOST,
    has_baseline,
    healthy_windows_of,
    train_baseline,
    what_is_trained,
)
from residuum.service.machines.scoring import diagnoser_class
from residuum.service.machines.windows import complete_windows, used_by
from residuum.service.services import Running, Services, caller_of
from residuum.service.views.model_view import model_of
from residuum.service.work.worker_pool import parts_of

router = APIRouter(tags=["machines"], route_class=StrictRoute, responses=PROBLEMS)

MachineName = Annotated[str, Path(alias="asset", description="Name of the machine.", pattern=NAME)]
# Recorded windows that are listed, the newest. As many as the list of windows to leave out of a
# training may name.
_WINDOWS_SHOWN = 500
_TRAINABLE = ("physical", "fmu")
"""Kinds of models that a baseline is trained with."""
# Windows that become records at once: as many as an analysis takes.
_MOST_RECORDS = 64
_OF_TABLE = ({"kind": ["table"]},)


if TYPE_CHECKING:
    KindOfText = str
else:  # mypy takes no names that are not written here; a new one is of a new kind of source
    KindOfText = Literal[*OF_SOURCE]


class BusText(BaseModel, extra="forbid"):
    """A description of a bus, as text."""

    kind: KindOfText = Field(
        description=DESCRIPTIONS[0].upper() + DESCRIPTIONS[1:],
        json_schema_extra={"x-of-source": dict(OF_SOURCE)},
    )
    # No `/` and no dot at the begin: a map of this name becomes a file for the sources that read
    # it.
    name: str = Field(
        "bus",
        min_length=1,
        max_length=100,
        pattern=r"^[A-Za-z0-9][A-Za-z0-9._-]*$",
        description="Name of the file.",
    )
    text: str = Field(min_length=1, max_length=2**20)
    sample_time: float = field(
        0.1, "table: time between two reads [s].", only_with=_OF_TABLE, ge=0.001, le=3600
    )
    unit_id: int = field(1, "table: unit of the device.", only_with=_OF_TABLE, ge=0, le=247)


class Training(BaseModel, extra="forbid"):
    """What a machine's baseline is trained from."""

    model: str | None = Field(
        None,
        pattern=NAME,
        description="model-based: a stored or a built-in model; default: the machine's.",
    )
    version: int | None = Field(
        None, ge=1, le=10**9, description="Version of the model (default: the newest)."
    )
    second: bool = Field(False, description="Train the machine's second opinion, with its model.")
    leave_out: list[int] = Field(
        [], max_length=500, description="Recorded windows in which the machine was not healthy."
    )
    records: list[Annotated[int, Field(ge=1, le=2**53 - 1)]] | None = Field(
        None,
        min_length=1,
        max_length=MOST,
        description=(
            "Uploaded records, each a healthy window, in the place of the machine's own windows."
        ),
    )
    free: list[str] | None = Field(
        None,
        max_length=100,
        description=(
            "model-based: values that are followed from window to window, all others held; of an"
            " FMU its parameters (default: those that the model does not hold, of an FMU none)."
        ),
    )
    fix_undetermined: bool = Field(
        False, description="model-based: keep values that the windows leave open at the file's."
    )
    false_alarms_per_day: float | None = Field(
        None, gt=0, le=86400, description="model-based: chosen number of false alarms."
    )
    method: Literal["source", "default"] | None = Field(
        None, description="What decides, of a diagnoser with two."
    )


class WindowsAsRecords(BaseModel, extra="forbid"):
    """Windows of a machine that become records."""

    windows: list[Annotated[int, Field(ge=1, le=2**53 - 1)]] = Field(
        min_length=1, max_length=_WINDOWS_SHOWN
    )
    complete: int | None = Field(
        None,
        ge=1,
        le=_MOST_RECORDS,
        description=(
            "Only so many of them: the newest in which no signal of the model lacks a sample."
        ),
    )


@router.post("/bus-descriptions")
async def read_bus_description(running: Running, asked: BusText) -> Response:
    """Understand a DBC file, a map or a table of registers: its streams, and the file to add a
    machine with.
    """
    given = (asked.kind, asked.name, asked.text, asked.sample_time, asked.unit_id)
    # With few others: a register map of megabytes takes seconds.
    return await running.reading(lambda: Json(bus_description(*given).to_json()))


@router.get("/assets/{asset}/machine")
def get_machine(running: Running, machine: MachineName) -> Response:
    """How a machine is watched, what became of its windows, and what it needs next; passwords are
    hidden.
    """
    return Json(_described(running, machine))


@router.put("/assets/{asset}/machine")
async def put_machine(
    request: Request, running: Running, machine: MachineName, asked: WatchedMachine
) -> Response:
    """Watch a machine from now on, or watch it by other settings. It is kept, and watched again
    after a restart.

    A map is the text of a file in `maps`, one that was sent before for this machine, or one that
    comes with Residuum. A hidden password (`user:***@`) stands for the one that was given before
    for the same address.
    """
    # All that can be refused is refused before anything that runs is changed.
    diagnoser_class(asked.diagnoser)
    document_name(machine)
    running.pipeline.refuse_fixed(machine)
    watched = running.pipeline.status()["machines"]
    old_sources = running.pipeline.machine(machine).sources if machine in watched else []
    # The page shows `***` for a password and sends it back so: only for the same address does it
    # stand for the one that was given, or a changed host would be told it.
    asked = asked.model_copy(update={"sources": with_kept_passwords(asked.sources, old_sources)})
    try:
        settings = asked.settings(machine)
    except ValidationError as error:
        raise BadInput(
            f"machine {machine!r}:"
            f" {error.errors(include_url=False)[0]['msg'].removeprefix('Value error, ')}"
        ) from None
    for model in (settings.model, None if settings.second is None else settings.second.model):
        if model is not None:  # a file of this computer is read for its settings' file alone
            await run_in_threadpool(stored_model, running.store, model)
    before = await run_in_threadpool(kept_maps, running.store, machine)
    names = {source.map for source in settings.sources}
    # Maps of an earlier setting that no source names any more are not kept.
    maps = {name: text for name, text in {**before, **asked.maps}.items() if name in names}
    # Sources read maps as files; what is kept are their texts, which a restart writes anew.
    with_files = await run_in_threadpool(with_server_files, settings, maps, running.settings)
    await running.pipeline.put_machine(with_files)
    # Kept when it is watched: what the pipeline refuses is not tried again at the next start.
    await run_in_threadpool(keep_machine, running.store, settings, maps, caller_of(request).name)
    return Json(await run_in_threadpool(_described, running, machine))


@router.delete("/assets/{asset}/machine", status_code=204, response_class=Response)
async def remove_machine(request: Request, running: Running, machine: MachineName) -> Response:
    """Watch a machine no more; its windows and findings stay."""
    await running.pipeline.remove_machine(machine)
    # Ended first, forgotten afterwards: a crash between the two brings the machine back, and loses
    # nothing.
    await run_in_threadpool(forget_machine, running.store, machine, caller_of(request).name)
    return Response(status_code=204)


@router.get("/assets/{asset}/live")
def get_live(running: Running, machine: MachineName) -> Response:
    """What the signals read now and over the last half minute, by their names on the bus."""
    return Json({"machine": machine, "signals": running.pipeline.live(machine)})


@router.get("/assets/{asset}/channel-guess")
def guess_channels(
    running: Running,
    machine: MachineName,
    model: Annotated[str, Query(pattern=NAME, description="A stored or built-in model.")],
    version: Annotated[
        int | None, Query(ge=1, le=10**9, description="Version of the model (default: the newest).")
    ] = None,
) -> Response:
    """The signals of a model, and which of the machine's each may be: the one of its name, or the
    only one of its unit.
    """
    read = model_of(*stored_model(running.store, model, version))
    bus = running.pipeline.units(machine)
    # What the settings say goes over a guess.
    guesses = guessed_channels(read, bus) | running.pipeline.machine(machine).channels
    signals = [
        {"name": name, "unit": unit, "role": role, "required": needed, "channel": guesses.get(name)}
        for name, (unit, role, needed) in model_signals(read).items()
    ]
    return Json({"signals": signals, "bus": bus})


@router.post("/assets/{asset}/records", status_code=201)
def add_records(running: Running, machine: MachineName, asked: WindowsAsRecords) -> Response:
    """Keep windows of a machine as records beside uploaded ones, with the names of signals that the
    machine's model uses.
    """
    settings = running.pipeline.machine(machine)
    channels = settings.channels
    if asked.complete:
        used = used_by(model_of_settings(running.store, settings.model) if settings.model else None)
        # A register that is read late leaves a hole, and one such window among a hundred would end
        # a comparison of all.
        taken = complete_windows(
            running.store, machine, asked.windows, channels, used, asked.complete
        )
    elif len(asked.windows) > _MOST_RECORDS:
        raise BadInput(
            f"{len(asked.windows)} windows; at most {_MOST_RECORDS} become records at once, or say"
            " 'complete'"
        )
    else:
        taken = {
            window: named(running.store.window_record(machine, window), channels)
            for window in asked.windows
        }
    numbers = [
        running.store.add_record(f"{machine} window {window}", record)
        for window, record in taken.items()
    ]
    return Json({"records": numbers, "windows": list(taken)}, 201)


@router.post("/assets/{asset}/training", status_code=202, response_model=JobAnswer)
def train(request: Request, running: Running, machine: MachineName, asked: Training) -> Response:
    """Train the machine's baseline from its own windows, and judge by it from now on.

    Without a baseline the recorded windows are taken; with one, those that it judged healthy; or
    uploaded records, of a time when nobody watched.
    """
    settings = running.pipeline.machine(machine)
    trained = what_is_trained(running.store, settings, second=asked.second)
    baseline = trained.name
    model = _model(running, asked, trained.model) if trained.diagnoser == "model-based" else None
    windows, holes = healthy_windows_of(
        running.store, settings, asked.leave_out, asked.records, used_by(model)
    )
    given = asked.model_dump(
        include={"fix_undetermined", "method", "false_alarms_per_day", "free"}, exclude_none=True
    )
    own = {name: value for name, value in given.items() if value is not False}
    by = caller_of(request).name

    def keep(outcome: Mapping[str, Any]) -> Mapping[str, Any]:
        note = f"trained on {outcome['windows']} windows" + (f" with {model[0]}" if model else "")
        version = running.store.add_model_version(
            baseline, "baseline", outcome["baseline"], note, by
        )
        if model is not None and not is_packed(model[1]):
            text = model[1] if model[1] is not None else write_model(model_of(*model)).encode()
            running.store.add_model_version(
                f"{machine}.model", "physical", text, f"{model[0]}: {note}", by
            )
        # The baseline itself is a file and no JSON.
        summary = {name: value for name, value in outcome.items() if name != "baseline"}
        return {
            **summary,
            "passed_over": holes,
            "stored": {"model": baseline, "version": version.number},
        }

    # The baseline at work is asked first: windows in which a fault is probable must not become the
    # healthy ones.
    present = (
        running.store.model_content(baseline) if has_baseline(running.store, baseline) else None
    )
    arguments = (
        trained.diagnoser,
        [parts_of(w) for w in windows],
        dict(settings.channels),
        model,
        own,
        present,
        running.settings.allow_fmus,
    )
    return accepted(running.jobs.submit("train", train_baseline, *arguments, then=keep))


def _described(running: Services, machine: str) -> dict[str, Any]:
    settings = running.pipeline.machine(machine)
    plain = settings.model_dump(mode="json", exclude={"asset", "alarms"})
    for source in plain["sources"]:
        # The name alone: where it lies on the server is nobody's business.
        source["map"] = source["map"].rsplit("/", 1)[-1]
        source["channel"] = with_hidden_password(source["channel"])
    return {
        "machine": machine,
        "settings": plain,
        "status": running.pipeline.status()["machines"].get(machine),
        "recorded_windows": running.store.recorded_windows(machine, _WINDOWS_SHOWN),
        "learned_from_at_most": MOST,
        "baseline": has_baseline(running.store, machine, settings.baseline),
    }


def _model(running: Services, asked: Training, of_machine: str | None) -> ModelText:
    """The model that is asked for, or the machine's; BadInput when there is none."""
    if asked.model is not None:
        model = stored_model(running.store, asked.model, asked.version, _TRAINABLE)
    elif of_machine is None:
        raise BadInput("body, model: is missing; the diagnoser model-based is trained with a model")
    else:
        model = model_of_settings(running.store, of_machine, _TRAINABLE)
    if is_packed(model[1]) and not running.settings.allow_fmus:
        raise Forbidden(
            f"model {model[0]!r}: is an FMU, which is native code; this service runs none, as its"
            " setting allow_fmus says; train by a model file, or elsewhere by `residuum train`"
        )
    return model
