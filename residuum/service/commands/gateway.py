"""`residuum gateway`: reads machines and sends their windows over MQTT to the scorers."""

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
from residuum.service.settings import load_settings
from residuum.service.window_queue.gateway import Gateway, Spool

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def gateway(
    name: Annotated[
        str | None,
        typer.Option(
            help="Name of this gateway; each needs its own. Default: this computer's name."
        ),
    ] = None,
    data: Annotated[
        Path | None, typer.Option(help="Folder that keeps windows until a scorer has stored them.")
    ] = None,
) -> None:
    """Read the machines that the settings name, and send their windows. Each window is kept here
    until a scorer has stored it.
    """
    settings = load_settings(data=data)
    if not settings.mqtt or not settings.machines:
        raise BadInput(
            "settings mqtt and machines: a gateway needs a broker to send to and machines to read"
        )
    name = name or socket.gethostname()
    # The name stands in topics, where `/`, `+` and `#` mean something.
    if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]{0,99}", name):
        raise BadInput(f"--name {name!r}: must be letters, digits, '.', '_' and '-'")
    set_up_logs(settings)
    sender = Gateway(name, Spool(settings.data / "spool", settings.keep_bytes), settings.broker)
    lines = [
        MachineLine(machine, partial(partial, sender.handle), lambda _: None)
        for machine in settings.machines
    ]
    # Before the machines, and ended after them: what they cut until the end is kept in its spool.
    sender.start()
    for line in lines:
        line.start()
        line.use_baseline("")  # the scorers know it; a window has to wait for nothing here
    until_interrupted(f"Gateway {name} reads {len(lines)} machines.")
    for line in lines:
        line.stop()
    sender.stop()
