"""`residuum set-aside`: the messages of the broker that were set aside; one of them whole, or all
of them once more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.errors import BadInput
from residuum.service.commands.report import AsJson, report
from residuum.service.settings import Settings, load_settings
from residuum.service.window_queue.set_aside import Poisoned, SetAside, send_again

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def set_aside(
    name: Annotated[
        str | None, typer.Argument(help="Name of one message, as it is listed; default: all.")
    ] = None,
    to: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the message there, byte for byte.")
    ] = None,
    again: Annotated[
        bool, typer.Option("--again", help="Send it, or all, to the scorers once more.")
    ] = False,
    data: Annotated[Path | None, typer.Option(help="Data folder of the scorers.")] = None,
    as_json: AsJson = False,
) -> None:
    """List what scorers could not store and set aside. Once an update has mended the reason,
    --again has it stored.
    """
    settings = load_settings(data=data)
    aside = SetAside(settings.data)
    chosen = aside.newest(limit=None) if name is None else [aside.get(name)]
    if to is not None:
        if name is None:
            raise BadInput(
                "--to: takes one message; give its name, as `residuum set-aside` lists them"
            )
        _write(aside.payload(name), to)
    # After the file was written: a message that is stored leaves the folder.
    outcomes = _sent_again(settings, aside, chosen) if again else {}
    lines = [_line(message, outcomes) for message in chosen]
    answer = {
        "messages": [asdict(message) for message in chosen],
        "stored": [sent_name for sent_name, why_refused in outcomes.items() if why_refused is None],
    }
    report(answer, "\n".join(lines) or "Nothing is set aside.", as_json=as_json)


def _sent_again(
    settings: Settings, aside: SetAside, chosen: Sequence[Poisoned]
) -> dict[str, str | None]:
    """By name, why a message was refused again; None where it is stored now."""
    if not settings.mqtt:
        raise BadInput(
            "setting mqtt: is empty; --again needs the broker that the messages came from"
        )
    if not chosen:
        return {}
    sent = send_again(settings.broker, aside, chosen)
    return {message.name: why_refused for message, why_refused in sent}


def _line(message: Poisoned, outcomes: dict[str, str | None]) -> str:
    """A message as it is listed; with why it was refused again, None where it is stored now."""
    begin = f"{message.name}: {message.size_bytes} bytes from {message.gateway!r}"
    if message.name not in outcomes:
        return f"{begin}: {message.reason}"
    why_refused = outcomes[message.name]
    if why_refused is None:
        return f"{begin}: is stored now"
    return f"{begin}: was refused and set aside anew: {why_refused}"


def _write(content: bytes, to: Path) -> None:
    try:
        to.write_bytes(content)
    except OSError as error:
        raise BadInput(f"--to {to}: cannot be written: {error.strerror}") from None
