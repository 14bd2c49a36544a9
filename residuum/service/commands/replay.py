"""`residuum replay`: send a recording to a CAN bus, or offer it as a Modbus device."""

import asyncio
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import can
import typer

from residuum.identification.errors import BadInput
from residuum.identification.record import Record
from residuum.service.commands.records import Reading, is_can_log, reads
from residuum.service.commands.report import AsJson, progress, report
from residuum.service.fieldbus.can.can_bus import open_bus
from residuum.service.fieldbus.can.can_log import TimedFrame, read_can_log
from residuum.service.fieldbus.can.frame_layout import read_dbc
from residuum.service.fieldbus.modbus.register_map import RegisterMap, read_register_map
from residuum.service.fieldbus.modbus.register_trace import TracedPage, read_trace
from residuum.service.fieldbus.replay import (
    TRACE,
    layout_for,
    record_frames,
    record_pages,
    replay_to_can,
    replay_to_modbus,
    stream_for,
)
from residuum.service.fieldbus.settings import MAPS, map_file

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
@reads(without=("dbc",))
def replay(
    file: Annotated[
        Path,
        typer.Argument(help="BLF, ASC, candump or TRC log, register trace, or any record file."),
    ],
    to: Annotated[
        str, typer.Option(help="can:INTERFACE:CHANNEL, or modbus:HOST:PORT to serve there.")
    ],
    reading: Reading,
    speed: Annotated[
        float,
        typer.Option(min=0.01, max=1000, help="Playing speed; 2 is twice as fast as recorded."),
    ] = 1.0,
    bus_map: Annotated[
        str | None, typer.Option(help="DBC file or register map for a record; default: what fits.")
    ] = None,
    linger: Annotated[
        float, typer.Option(min=0, help="modbus: seconds to keep serving after the last page.")
    ] = 3.0,
    as_json: AsJson = False,
) -> None:
    """Send a recording to a CAN bus, or offer it as a Modbus device. The device starts at its first
    request.
    """
    kind, _, address = to.partition(":")

    # Read only where it is no log and no trace: those are sent as they are.
    def load() -> Record:
        return reading.named([file])[0]

    if kind == "can" and address:
        sent = _send(_frames(file, bus_map, load), address, speed)
    elif kind == "modbus" and address:
        registers, pages = _pages(file, bus_map, load)
        sent = _serve(registers, pages, address, speed, linger)
    else:
        raise BadInput(f"--to {to!r}: must be can:INTERFACE:CHANNEL or modbus:HOST:PORT")
    unit = "frames" if kind == "can" else "pages"
    report(
        {"file": str(file), "to": to, "sent": sent, "kind": unit},
        f"{file.name}: {sent} {unit} replayed to {to}",
        as_json=as_json,
    )


def _frames(file: Path, bus_map: str | None, load: Callable[[], Record]) -> list[TimedFrame]:
    if is_can_log(file):
        log = read_can_log(file)
        for remark in log.remarks:
            progress(remark)
        return list(log.frames)
    if file.suffix.lower() == TRACE:
        raise BadInput(f"{file.name}: a register trace cannot be sent to a CAN bus")
    record = load()
    dbc_files = [map_file(bus_map)] if bus_map else sorted(MAPS.glob("*.dbc"))
    # Each is read before one is chosen: a broken file is told, not passed over.
    for dbc in dbc_files:
        read_dbc(dbc)
    return list(record_frames(record, layout_for(record, dbc_files)))


def _pages(
    file: Path, bus_map: str | None, load: Callable[[], Record]
) -> tuple[RegisterMap, list[TracedPage]]:
    if file.suffix.lower() == TRACE:
        registers, pages = read_trace(file)
        return registers, list(pages)
    if is_can_log(file):
        raise BadInput(f"{file.name}: a CAN log cannot be offered as a Modbus device")
    record = load()
    for map_path in [map_file(bus_map)] if bus_map else sorted(MAPS.glob("*.yaml")):
        registers = read_register_map(map_path)
        try:
            name, stream = stream_for(record, registers)
        # a map of another machine
        except BadInput:
            continue
        return registers, list(record_pages(record, name, stream))
    raise BadInput(
        f"{file.name}: no register map carries {', '.join(record.names)}; name one with --bus-map"
    )


def _send(frames: list[TimedFrame], channel: str, speed: float) -> int:
    try:
        bus = open_bus(channel)
    except (OSError, ValueError, can.CanError) as error:
        raise BadInput(f"--to can:{channel}: cannot open the bus: {error}") from None
    try:
        return replay_to_can(frames, bus, speed)
    except (OSError, can.CanError) as error:
        raise BadInput(f"--to can:{channel}: cannot send: {error}") from None
    finally:
        bus.close()


def _serve(
    registers: RegisterMap, pages: list[TracedPage], address: str, speed: float, linger: float
) -> int:
    host, colon, port = address.rpartition(":")
    if not (host and colon and port.isdecimal() and int(port) <= 65535):
        raise BadInput(f"--to modbus:{address}: must be modbus:HOST:PORT")

    def ready(at: int) -> None:
        progress(f"waiting for a reader on {host}:{at}")
        sys.stderr.flush()

    try:
        return asyncio.run(
            replay_to_modbus(registers, pages, (host, int(port)), speed, linger, ready)
        )
    except OSError as error:
        raise BadInput(f"--to modbus:{address}: {error}") from None
