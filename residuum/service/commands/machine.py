"""`residuum machine`: one simulated machine on a real bus."""

import asyncio
import signal
import sys
import threading
from typing import Annotated

import orjson
import typer
from can import CanError

from residuum.identification.errors import BadInput
from residuum.service.simulated.device import Device
from residuum.service.simulated.wiring import wiring_of
from residuum.simulation import MACHINES

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def machine(
    name: Annotated[
        str,
        typer.Argument(metavar="MACHINE", help="gate-actuator, gripping-pliers or process-plant."),
    ],
    can: Annotated[
        str | None,
        typer.Option(
            help="CAN bus, for example udp_multicast:239.74.163.2:43113 or socketcan:can0."
        ),
    ] = None,
    modbus: Annotated[
        str | None, typer.Option(help="HOST:PORT to serve Modbus TCP on; port 0 takes a free one.")
    ] = None,
    opcua: Annotated[
        str | None,
        typer.Option(
            help=(
                "Address to offer its slow streams over OPC UA, for example"
                " opc.tcp://127.0.0.1:4840/."
            )
        ),
    ] = None,
    speed: Annotated[
        float,
        typer.Option(min=0.01, max=100, help="Speed of the simulation; 2 is twice real time."),
    ] = 1.0,
    seed: Annotated[int, typer.Option(min=0, help="Seed of noise and start values.")] = 0,
    exemplar: Annotated[
        int,
        typer.Option(min=0, help="Number of the specimen: no two machines of a series are equal."),
    ] = 0,
    with_parent: Annotated[
        bool,
        typer.Option(
            "--with-parent",
            help="End when standard input closes, that is, with the program that started it.",
        ),
    ] = False,
) -> None:
    """Run a simulated machine on a real bus until it is interrupted.

    Prints one JSON line when it is on its buses. Give at least one bus.
    """
    wiring = wiring_of(name)
    buses = (
        ("--can", wiring.dbc, can),
        ("--modbus", wiring.registers, modbus),
        ("--opcua", wiring.registers, opcua),
    )
    if not any(has and given for _, has, given in buses):
        needed = " or ".join(option for option, has, _ in buses if has)
        raise BadInput(f"machine {name!r}: needs a bus; give {needed}")
    device_machine = MACHINES[wiring.machine](seed=seed, exemplar=exemplar)
    try:
        device = Device(
            device_machine,
            wiring,
            can if wiring.dbc else None,
            _address(modbus) if modbus else None,
            speed,
            _say,
            opcua,
        )
    except (OSError, CanError) as error:
        raise BadInput(f"--can {can}: cannot open the bus: {error}") from None
    asyncio.run(_live(device, name, can, with_parent))


async def _live(device: Device, name: str, can: str | None, with_parent: bool) -> None:
    stopped = asyncio.Event()
    loop = asyncio.get_running_loop()
    # A terminal sends the first, Docker the second; buses are closed by either.
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stopped.set)
    # A parent that was killed closes its end of the pipe, whatever else it could not do.
    if with_parent:
        threading.Thread(target=_until_input_closes, args=(loop, stopped), daemon=True).start()

    def ready(port: int | None) -> None:
        sys.stdout.buffer.write(
            orjson.dumps({"machine": name, "can": can, "modbus_port": port}) + b"\n"
        )
        sys.stdout.buffer.flush()

    try:
        await device.run(stopped, ready)
    except OSError as error:
        raise BadInput(f"machine {name!r}: {error}") from None


def _until_input_closes(loop: asyncio.AbstractEventLoop, stopped: asyncio.Event) -> None:
    sys.stdin.buffer.read()
    # An event of asyncio is set on its own loop only.
    loop.call_soon_threadsafe(stopped.set)


def _address(text: str) -> tuple[str, int]:
    host, colon, port = text.rpartition(":")
    if not (host and colon and port.isdecimal() and int(port) <= 65535):
        raise BadInput(f"--modbus {text!r}: must be HOST:PORT")
    return host, int(port)


def _say(message: str) -> None:
    sys.stderr.write(f"residuum machine: {message}\n")
