"""`residuum keys`: the API keys of a first start, made and shown once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from residuum.service.commands.report import AsJson, report
from residuum.service.security.access import (
    API_KEYS,
    BROKER_PASSWORD,
    BROKER_USERS,
    METRICS_KEY,
    make_broker_user,
    make_first_keys,
)

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def keys(
    folder: Annotated[
        Path,
        typer.Argument(
            help=(
                "Folder for `api_keys`, `metrics_key`, `broker_password` and `broker_users`. What"
                " is there is kept."
            )
        ),
    ],
    as_json: AsJson = False,
) -> None:
    """Make keys for an engineer and Prometheus, and a broker's user, unless they exist. The
    engineer's is shown only now.
    """
    files = {"api_keys": str(folder / API_KEYS), "metrics_key": str(folder / METRICS_KEY)}
    files |= {
        "broker_password": str(folder / BROKER_PASSWORD),
        "broker_users": str(folder / BROKER_USERS),
    }

    def show(key: str) -> None:
        message = f"API key of 'engineer', shown this once (the page asks for it):\n\n    {key}\n"
        report({"made": True, "key": key} | files, message, as_json=as_json)

    # Shown once and kept as SHA-256 alone: whoever reads the file later has no key.
    are_new = make_first_keys(folder, show)
    make_broker_user(folder)
    if not are_new:
        report(
            {"made": False, "key": None} | files,
            f"Keys are in {files['api_keys']}; none was made.",
            as_json=as_json,
        )
