"""`residuum keys`: the API keys of a first start, made and shown once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from residuum.service.commands.report import AsJson, report
from residuum.service.security.first_keys import API_KEYS, METRICS_KEY, make_first_keys

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def keys(
    folder: Annotated[Path, typer.Argument(help="Folder for `api_keys` and `metrics_key`. Existing files are kept.")],
    as_json: AsJson = False,
) -> None:
    """Make one key for an engineer and one for Prometheus, unless they exist. The engineer's key is shown only now."""
    files = {"api_keys": str(folder / API_KEYS), "metrics_key": str(folder / METRICS_KEY)}

    def show(key: str) -> None:
        said = f"API key of 'engineer', shown this once (the page asks for it):\n\n    {key}\n"
        report({"made": True, "key": key} | files, said, as_json=as_json)

    if not make_first_keys(folder, show):
        report({"made": False, "key": None} | files, f"Keys are in {files['api_keys']}; none was made.", as_json=as_json)
