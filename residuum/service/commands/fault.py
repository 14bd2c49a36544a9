"""`residuum fault`: switch a fault of a simulated machine in a running demo."""

import urllib.parse
from typing import Annotated, Any

import typer

from residuum.identification.errors import BadInput
from residuum.service.commands.report import AsJson, report
from residuum.service.commands.running_service import HERE, ServiceUrl, ask

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def fault(
    machine: Annotated[
        str, typer.Argument(help="gate-actuator, gripping-pliers or process-plant.")
    ],
    fault: Annotated[
        str | None,
        typer.Argument(
            metavar="FAULT[:size]", help="Fault, or none to clear all; left out: list them."
        ),
    ] = None,
    clear: Annotated[
        bool, typer.Option("--clear", help="Clear the fault (or all, when none is named).")
    ] = False,
    url: ServiceUrl = HERE,
    as_json: AsJson = False,
) -> None:
    """Switch a fault of a simulated machine in a running demo; without a fault, list what it has.

    A key, where the service asks for one, is taken from the environment variable RESIDUUM_API_KEY.
    """
    order = _order(fault, clear)
    answer = ask(url, f"/demo/machines/{urllib.parse.quote(machine, safe='')}/fault", order)
    outcome = (
        f"{machine}: {order['fault']} switched"
        f" {'off' if order.get('size') == 0 or order['fault'] == 'none' else 'on'}"
        if order
        else ""
    )
    lines = [
        f"  {entry['id']:<16} {_size(entry)}  {entry.get('meaning', '')}"
        for entry in answer["faults"]
    ]
    report(answer, outcome or "\n".join([f"{machine} has", *lines]), as_json=as_json)


def _order(fault: str | None, clear: bool) -> dict[str, Any] | None:
    if fault is None:
        return {"fault": "none"} if clear else None
    name, colon, size = fault.partition(":")
    if clear:
        return {"fault": name, "size": 0.0}
    if not colon:
        return {"fault": name}
    try:
        return {"fault": name, "size": float(size)}
    except ValueError:
        raise BadInput(f"fault {fault!r}: the size {size!r} is not a number") from None


def _size(entry: dict[str, Any]) -> str:
    unit = f" {entry.get('unit', '')}".rstrip()
    if entry["on"]:
        return f"ON, {entry['size']:g}{unit}"
    return f"off (default {entry['default_size']:g}{unit})" if "default_size" in entry else "off"
