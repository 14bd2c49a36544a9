"""`residuum gateway`: reads machines and sends their windows to a service over HTTP."""

import re
import socket
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.errors import BadInput
from residuum.service.commands.until_interrupted import until_interrupted
from residuum.service.logs import set_up_logs
from residuum.service.machines.machine_line import MachineLine
from residuum.service.settings import Settings, load_settings
from residuum.service.window_queue.gateway import Gateway, Sending
from residuum.service.window_queue.set_aside import SetAside
from residuum.service.window_queue.spool import Spool

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def gateway(
    name: Annotated[
        str | None,
        typer.Option(
            help=(
                "Name of this gateway in the logs of proxies (User-Agent). Default: this computer's"
                " name."
            )
        ),
    ] = None,
    data: Annotated[
        Path | None,
        typer.Option(help="Folder that keeps windows until the service has stored them."),
    ] = None,
) -> None:
    """Read the machines that the settings name, and send their windows to the service at
    `service_url`. Each window is kept here until the service has stored it.
    """
    settings = load_settings(data=data)
    if not settings.machines:
        raise BadInput("setting machines: is empty; a gateway needs machines to read")
    name = name or socket.gethostname()
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", name):
        raise BadInput(f"--name {name!r}: must be letters, digits, '.', '_' and '-'")
    sending = sending_of(settings, name)
    set_up_logs(settings)
    sender = Gateway(
        Spool(settings.data / "spool", settings.keep_bytes), SetAside(settings.data), sending
    )
    lines = [
        MachineLine(machine, partial(partial, sender.handle), lambda _: None)
        for machine in settings.machines
    ]
    # Before the machines, and ended after them: what they cut until the end is kept in its spool.
    sender.start()
    for line in lines:
        line.start()
        line.use_baseline("")  # the service knows it; a window has to wait for nothing here
    until_interrupted(f"Gateway {name} reads {len(lines)} machines.")
    for line in lines:
        line.stop()
    sender.stop()


def sending_of(settings: Settings, name: str = "") -> Sending:
    """How windows are sent to the service that the settings name; BadInput where they name none."""
    if settings.service_url is None:
        former = (
            "; windows go by HTTP now, no more over the broker of mqtt" if settings.mqtt else ""
        )
        raise BadInput(
            "setting service_url: is empty; a gateway needs the service that its windows go to, as"
            f" https://plant.example:8000/{former}"
        )
    key_file, ca = settings.service_key_file, settings.service_ca
    return Sending(str(settings.service_url), key_file, ca, name)
