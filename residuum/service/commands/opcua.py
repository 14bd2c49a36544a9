"""`residuum opcua`: what an OPC UA server has, as a node map; and its certificate, to be
trusted.
"""

from __future__ import annotations

import asyncio
import hashlib
from importlib import import_module
from pathlib import Path
from typing import Annotated, Any

import typer

from residuum.identification.errors import BadInput
from residuum.service.commands.output_file import check_output_file
from residuum.service.commands.report import AsJson, report
from residuum.service.fieldbus.opcua.node_map import ChannelNode, node_map_text, read_node_map

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)

Url = Annotated[str, typer.Argument(metavar="URL", help="For example opc.tcp://192.168.0.10:4840.")]
# Seconds in which a server must answer one request.
_TIMEOUT = 5.0


@app.command()
def browse(
    url: Url,
    out: Annotated[Path, typer.Option(help="The node map to write.")],
    under: Annotated[
        str, typer.Option(help="Only nodes whose id begins so, for example 'ns=2;s=Press1.'.")
    ] = "",
    every: Annotated[
        float, typer.Option(min=0.001, max=3600, help="Sample time of the stream [s].")
    ] = 0.1,
    entered: Annotated[
        Path | None, typer.Option("--map", help="A node map that says how the server is entered.")
    ] = None,
    as_json: AsJson = False,
) -> None:
    """Write a node map of the variables that hold numbers; units are taken where the server says
    them.
    """
    check_output_file(out)
    nodes = None if entered is None else read_node_map(entered)
    variables = asyncio.run(
        _answered(url, _library().numeric_variables(url, nodes, under, _TIMEOUT))
    )
    if not variables:
        raise BadInput(
            f"{url}: no variable with a number{f' whose id begins with {under!r}' if under else ''}"
        )
    # Booleans and enumerations are marked as held: servers report them when they change, and
    # without it nine samples of ten were missing.
    channels = {name: ChannelNode(**_said(node)) for name, node in variables.items()}
    out.write_text(node_map_text({"signals": (every, channels)}), encoding="utf-8")
    lines = [f"{out}: {len(variables)} channels, a sample every {every:g} s"]
    lines += [
        f"  {name} [{node.unit or '1'}]  {node.node}{_what(node)}"
        for name, node in variables.items()
    ]
    plain = {
        name: {**_said(node), "kind": node.kind, "names": list(node.names)}
        for name, node in variables.items()
    }
    report({"file": str(out), "channels": plain}, "\n".join(lines), as_json=as_json)


def _said(node: Any) -> dict[str, Any]:
    """What the map says of a variable: that it holds, too, of one that takes few values."""
    return {"node": node.node, "unit": node.unit} | ({"held": True} if node.held else {})


def _what(node: Any) -> str:
    names = f" ({', '.join(node.names)})" if node.names else ""
    return f"  {node.kind}{names}, held until it changes" if node.held else ""


@app.command()
def trust(
    url: Url,
    out: Annotated[Path, typer.Option(help="File for the server's certificate (DER).")],
    as_json: AsJson = False,
) -> None:
    """Save the certificate that a server shows. Compare its fingerprint with the server's own
    before you trust it.
    """
    check_output_file(out)
    certificate = asyncio.run(_answered(url, _library().server_certificate(url, _TIMEOUT)))
    if not certificate:
        raise BadInput(
            f"{url}: the server shows no certificate; it can only be entered without security"
        )
    out.write_bytes(certificate)
    fingerprint = hashlib.sha256(certificate).hexdigest()
    says = (
        f"{out}: SHA-256 {fingerprint}\ncompare it at the server, then name the file at `security:"
        " trusted` of the node map"
    )
    report({"file": str(out), "sha256": fingerprint}, says, as_json=as_json)


def _library() -> Any:
    try:
        return import_module("residuum.service.fieldbus.opcua.opcua_source")
    except ModuleNotFoundError:
        raise BadInput("OPC UA needs the extra `opcua`: pip install 'residuum[opcua]'") from None


async def _answered(url: str, asked: Any) -> Any:
    try:
        # All requests together: a server that answers each just in time must not take for ever.
        return await asyncio.wait_for(asked, 12 * _TIMEOUT)
    except Exception as error:  # whatever a foreign server answers
        raise BadInput(f"{url}: {_library().what_went_wrong(error)}") from None
