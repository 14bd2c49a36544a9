"""`residuum watch`: from a machine to a watched machine, step by step."""

from __future__ import annotations

import inspect
import sys
import threading
import time
import urllib.parse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Annotated, Any

import typer

from residuum.identification.errors import BadInput
from residuum.identification.physics import load_model
from residuum.nearest_names import known_names
from residuum.service.commands.healthy_history import lent_windows
from residuum.service.commands.machine_checks import bus_signals
from residuum.service.commands.options_of import expanded
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.records import Reading, reads
from residuum.service.commands.report import AsJson, progress, report
from residuum.service.commands.running_service import HERE, ServiceUrl, answered, ask
from residuum.service.commands.settings_template import SettingsFile, settings_template
from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.modbus.register_map import read_register_map
from residuum.service.fieldbus.modbus.register_table import register_map_of, register_map_text
from residuum.service.fieldbus.settings import MachineSettings, SourceSettings, WindowSettings
from residuum.service.machines.adding import guessed_channels
from residuum.service.machines.machine_state import LiveValues
from residuum.service.settings import load_settings

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

MachineArgument = Annotated[str, typer.Argument(metavar="MACHINE", help="Name of the machine.")]
# Seconds between two questions for a job's state. A training takes seconds to minutes.
_PAUSE = 0.5


class _Buses(dict[str, str | None]):
    """Kind of a source → where one is; None where none was told."""


def _asks_for_buses(function: Callable[..., Any]) -> Callable[..., Any]:
    """An option for each kind of source, in the place of the parameter `buses`."""
    options = {
        name: inspect.Parameter(
            name,
            inspect.Parameter.KEYWORD_ONLY,
            default=None,
            annotation=Annotated[str | None, typer.Option(help=kind.asked)],
        )
        for name, kind in SOURCES.items()
    }
    return expanded(function, "buses", options, _Buses)


_MAPS = [kind.map_called for kind in SOURCES.values()]


@app.command()
@_asks_for_buses
def init(
    *,
    out: Annotated[Path, typer.Option(help="The settings' file to write.")] = Path("residuum.yaml"),
    asset: Annotated[str, typer.Option(help="Name of the machine.")] = "my-machine",
    buses: _Buses,
    bus_map: Annotated[
        str | None,
        typer.Option("--map", help=f"{', '.join(_MAPS[:-1])} or {_MAPS[-1]}."),
    ] = None,
    model: Annotated[
        str | None, typer.Option(help="Model file of the machine, or a built-in model.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write a commented settings file for one machine. Options that are left out stay in it as
    examples to fill in.
    """
    # Never over a file: it may hold settings that somebody wrote by hand.
    if out.exists():
        raise BadInput(f"--out {out}: is there already; choose another name or remove it")
    check_output_file(out)
    machine = _machine(asset, buses, bus_map)
    signals = {} if machine is None else bus_signals(machine)
    channels = guessed_channels(load_model(model), signals) if model and signals else {}
    out.write_text(settings_template(asset, machine, signals, model, channels), encoding="utf-8")
    says = [f"wrote {out}", f"next: residuum doctor --settings {out}    says what is missing in it"]
    report(
        {"file": str(out), "signals": signals, "channels": channels},
        "\n".join(says),
        as_json=as_json,
    )


@app.command("map")
def make_map(
    table: Annotated[
        Path, typer.Argument(help="Table of names, registers, types, units (CSV, `;` or tab).")
    ],
    out: Annotated[Path, typer.Option(help="The register map to write.")],
    every: Annotated[
        float, typer.Option(min=0.001, max=3600, help="Seconds between two reads.")
    ] = 0.1,
    unit_id: Annotated[int, typer.Option(min=0, max=247, help="Unit of the device.")] = 1,
    as_json: AsJson = False,
) -> None:
    """Make a register map from a table, as a device's manual or a spreadsheet has it."""
    try:
        # Spreadsheets put a byte order mark before the first heading, which would then have another
        # name.
        text = table.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise BadInput(f"{table}: cannot be read: {error}") from None
    check_output_file(out)
    registers = register_map_of(text, every, table.name, unit_id)
    out.write_text(register_map_text(registers), encoding="utf-8")
    stream = read_register_map(out).streams["signals"].format("signals")
    lines = [f"{out}: {len(stream.units)} signals, read every {every:g} s"]
    lines += [f"  {name} [{unit or '1'}]" for name, unit in stream.units.items()]
    report({"file": str(out), "signals": dict(stream.units)}, "\n".join(lines), as_json=as_json)


@app.command()
def signals(
    machine: MachineArgument,
    settings_file: SettingsFile = None,
    seconds: Annotated[float, typer.Option(min=0.1, max=3600, help="How long to listen.")] = 3.0,
    as_json: AsJson = False,
) -> None:
    """Show the present values of a machine's signals. No service needs to run."""
    settings = load_settings(settings_file)
    watched = next((entry for entry in settings.machines if entry.asset == machine), None)
    if watched is None:
        known = known_names(machine, [entry.asset for entry in settings.machines], "there are")
        raise BadInput(f"machine {machine!r}: is not in the settings; {known}")
    live, silent = _listened(watched, seconds)
    units = bus_signals(watched)
    lines = [
        f"  {bus:<20} {value['value']:>12.6g} {units[bus]:<8} {_alias(bus, value['name'])}"
        for bus, value in live.items()
    ]
    lines += [
        f"  nothing came from {name}: {trouble or 'the bus is silent'}"
        for name, trouble in silent.items()
    ]
    present = {
        bus: {"name": value["name"], "value": value["value"], "unit": units[bus]}
        for bus, value in live.items()
    }
    report(
        {"machine": machine, "signals": present, "silent": silent},
        "\n".join([f"{machine} reads", *lines]),
        as_json=as_json,
    )
    if silent:
        raise typer.Exit(1)


@app.command()
def status(machine: MachineArgument, url: ServiceUrl = HERE, as_json: AsJson = False) -> None:
    """Say how a machine is watched and what it needs next."""
    answer = ask(url, f"/assets/{_quoted(machine)}/machine")
    asset = ask(url, f"/assets/{_quoted(machine)}")
    doing = answer["status"]["doing"] if answer["status"] else "not watched"
    lines = [
        f"{machine}: {asset['state']}; {doing}",
        (
            f"  windows kept: {asset['windows']}; recorded without a judge:"
            f" {len(answer['recorded_windows'])}"
        ),
    ]
    report(answer | {"state": asset["state"]}, "\n".join(lines), as_json=as_json)


@app.command()
def windows(
    machine: MachineArgument,
    out: Annotated[Path, typer.Option(help="Folder for the record files.")],
    url: ServiceUrl = HERE,
    as_json: AsJson = False,
) -> None:
    """Write a machine's recorded windows as record files, to compare and improve a model with."""
    numbers = ask(url, f"/assets/{_quoted(machine)}/machine")["recorded_windows"]
    out.mkdir(parents=True, exist_ok=True)
    files = [out / f"{machine}-{number}.npz" for number in numbers]
    for number, file in zip(numbers, files, strict=True):
        file.write_bytes(answered(url, f"/assets/{_quoted(machine)}/windows/{number}/record"))
    report(
        {"files": [str(file) for file in files]},
        f"{machine}: {len(files)} windows → {out}/",
        as_json=as_json,
    )


@app.command()
@reads()
def train(
    machine: MachineArgument,
    reading: Reading,
    url: ServiceUrl = HERE,
    model: Annotated[
        str | None,
        typer.Option(help="model-based: a stored or built-in model; default: the machine's."),
    ] = None,
    second: Annotated[bool, typer.Option("--second", help="Train its second opinion.")] = False,
    leave_out: Annotated[
        list[int] | None,
        typer.Option(help="A recorded window in which the machine was not healthy."),
    ] = None,
    records: Annotated[
        list[str] | None,
        typer.Option(
            "--from",
            metavar="HISTORY|RECORD",
            help=(
                "Healthy windows from elsewhere, in the place of the machine's own: a history"
                " (timescale://…, influx://… or opc.tcp://…), of whose windows some are taken"
                " evenly, or a record file, which is one window; may be repeated."
            ),
        ),
    ] = None,
    healthy: Annotated[
        str | None,
        typer.Option(
            metavar="BEGIN..END",
            help="When the machine of a history was healthy, as 2026-03..2026-05 (UTC).",
        ),
    ] = None,
    fix_undetermined: Annotated[
        bool,
        typer.Option(
            "--fix-undetermined",
            help="Keep the file's value of a parameter that the windows do not determine.",
        ),
    ] = False,
    false_alarms_per_day: Annotated[
        float | None, typer.Option(help="Number of false alarms a day that is accepted.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Train a machine's baseline from its recorded windows, or from its history; the service judges
    by it from now on.
    """
    body: dict[str, Any] = {"leave_out": leave_out or [], "fix_undetermined": fix_undetermined}
    # Left out where it was not said: the service then takes the machine's own.
    said = {"model": model, "second": second, "false_alarms_per_day": false_alarms_per_day}
    body |= {name: value for name, value in said.items() if value}
    with lent_windows(url, _quoted(machine), records or (), healthy, reading) as lent:
        body |= {"records": lent.records} if records else {}
        job = ask(url, f"/assets/{_quoted(machine)}/training", body)
    result = _result_of(url, job) | ({"from": lent.says} if records else {})
    lines = [
        f"{machine}: trained on {result['windows']} windows; {result['alarms']} of them would raise"
        " an alarm",
        *(f"  from {told}" for told in lent.says),
    ]
    if holes := result.get("passed_over"):
        lines.append(f"  passed over, since samples are missing: {holes}")
    report(result, "\n".join([*lines, *result["learned"].get("says", [])]), as_json=as_json)


def _result_of(url: str, job: Mapping[str, Any]) -> dict[str, Any]:
    """The result of a job of the service, waited for; BadInput says why there is none."""
    while job["state"] in ("queued", "running"):
        progress(job["doing"], job["progress"])
        time.sleep(_PAUSE)
        job = ask(url, f"/jobs/{job['id']}")
    if job["state"] != "done":
        raise BadInput(job["error"] or f"the training was {job['state']}")
    return dict(job["result"])


def _machine(
    asset: str, buses: Mapping[str, str | None], bus_map: str | None
) -> MachineSettings | None:
    """The machine with the source that was told (kind → where it is); None when none was."""
    # Of several sources that are named the first is written.
    given = [(kind, where) for kind, where in buses.items() if where is not None]
    if not given:
        return None
    kind, where = given[0]
    if bus_map is None:
        makers = (
            "residuum watch map makes one, residuum opcua browse a node map, residuum sparkplug"
            " browse a metric map"
        )
        raise BadInput(
            "--map: is missing; a source needs the file that says what it carries:"
            f" {', '.join(_MAPS[:-1])} or {_MAPS[-1]} ({makers})"
        )
    try:
        return MachineSettings(
            asset=asset,
            diagnoser="model-based",
            # Stands in the file to be changed: what a window of this machine is, nobody knows yet.
            window=WindowSettings(cut="sliding", length=10, step=10),
            sources=[_source(kind, where, bus_map)],
        )
    except ValueError as error:
        raise BadInput(
            f"--{kind} {where!r}, --asset {asset!r}: {str(error).splitlines()[0]}"
        ) from None


def _source(kind: str, where: str, bus_map: str) -> SourceSettings:
    """The source of a kind at a place; ValueError for a place that is none."""
    return SourceSettings.model_validate(
        {"kind": kind, "map": bus_map, **SOURCES[kind].reached(where)}
    )


def _listened(machine: MachineSettings, seconds: float) -> tuple[dict[str, Any], dict[str, str]]:
    """What came within some seconds, and the sources from which nothing came, with their
    trouble.
    """
    live = LiveValues(machine.channels)
    stopped = threading.Event()

    def take(block: Any) -> bool:
        live.take(block)
        return True

    sources = [SOURCES[source.kind](source, take) for source in machine.sources]
    for source in sources:
        source.start()
    # Nothing sets it: sources run beside, and end by themselves when they are stopped.
    stopped.wait(seconds)
    # Before they are stopped: a source that was stopped has another state.
    states = {source.name: source.health.snapshot() for source in sources}
    for source in sources:
        source.stop()
    for source in sources:
        # All were told to stop before the first is waited for.
        source.join()
    sys.stdout.flush()
    return live.now(), {
        name: str(s["last_trouble"]) for name, s in states.items() if s["quality"] == "never-seen"
    }


def _alias(bus: str, name: str) -> str:
    return "" if bus == name else f"the diagnoser's {name}"


def _quoted(machine: str) -> str:
    # No `/` is left: a name must not become another route.
    return urllib.parse.quote(machine, safe="")
