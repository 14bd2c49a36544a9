"""`residuum sparkplug`: what an edge node's births name, as a metric map."""

from __future__ import annotations

import re
from importlib import import_module
from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.errors import BadInput
from residuum.service.broker import BrokerAddress, broker_address
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.report import AsJson, report
from residuum.service.fieldbus.sparkplug.metric_map import NAME, metric_map_text, read_metric_map

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

# Seconds in which a node's birth must come.
_TIMEOUT = 10.0

Devices = dict[str, dict[str, tuple[str, str]]]
"""Device, empty for the node itself → channel → (metric, unit)."""


@app.callback()
def sparkplug() -> None:
    """Edge nodes that speak Sparkplug B over an MQTT broker."""


@app.command()
def browse(
    broker: Annotated[
        str, typer.Argument(metavar="BROKER", help="For example mqtt://192.168.0.11.")
    ],
    node: Annotated[str, typer.Argument(metavar="GROUP/NODE", help="The edge node.")],
    out: Annotated[Path, typer.Option(help="The metric map to write.")],
    entered: Annotated[
        Path | None, typer.Option("--map", help="A metric map that says how the broker is entered.")
    ] = None,
    every: Annotated[
        float, typer.Option(min=0.001, max=3600, help="Sample time of the streams [s].")
    ] = 0.1,
    as_json: AsJson = False,
) -> None:
    """Ask a node to be born again, and write a map of the metrics that are numbers; a stream a
    device.
    """
    check_output_file(out)
    try:
        address = (
            broker_address(broker) if entered is None else read_metric_map(entered).entered(broker)
        )
    except ValueError as error:
        raise BadInput(f"{broker}: {error}") from None
    # They stand in topics, where `+` and `#` would subscribe to other nodes as well.
    if re.fullmatch(f"{NAME}/{NAME}", node) is None:
        raise BadInput(f"{node}: must be GROUP/NODE, without + and #")
    devices = _numeric_metrics(address, node)
    out.write_text(metric_map_text(node, every, devices), encoding="utf-8")
    count = sum(len(channels) for channels in devices.values())
    head = f"{out}: {count} channels of {node}, a sample every {every:g} s"
    plain = {
        device: {
            name: {"metric": metric, "unit": unit} for name, (metric, unit) in channels.items()
        }
        for device, channels in devices.items()
    }
    report(
        {"file": str(out), "devices": plain}, "\n".join([head, *_lines(devices)]), as_json=as_json
    )


def _lines(devices: Devices) -> list[str]:
    return [
        f"  {device or 'the node'}: {name} [{unit or '1'}]  {metric}"
        for device, channels in devices.items()
        for name, (metric, unit) in channels.items()
    ]


def _numeric_metrics(address: BrokerAddress, node: str) -> Devices:
    """The numbers of what the node's births name; BadInput where none
    comes.
    """
    try:
        # the extra `sparkplug`
        sparkplug_browse = import_module("residuum.service.fieldbus.sparkplug.sparkplug_browse")
    except ModuleNotFoundError:
        raise BadInput(
            "Sparkplug needs the extra `sparkplug`: pip install 'residuum[sparkplug]'"
        ) from None
    devices: Devices
    try:
        devices = sparkplug_browse.numeric_metrics(address, node, _TIMEOUT)
    except OSError as error:
        raise BadInput(f"{address.host}:{address.port}: {error}") from None
    if not devices:
        raise BadInput(
            f"{node}: no birth with a number came within {_TIMEOUT:g} s; is the node connected to"
            " this broker?"
        )
    return devices
