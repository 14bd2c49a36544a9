"""`residuum set-aside`: the windows that the service refused; one of them as a record, or all of
them sent once more.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer

from residuum.identification.errors import BadInput
from residuum.service.commands.gateway import sending_of
from residuum.service.commands.report import AsJson, report
from residuum.service.receivers.receiver_settings import Refused
from residuum.service.settings import Settings, load_settings
from residuum.service.window_queue.gateway import window_of
from residuum.service.window_queue.set_aside import Refusal, SetAside

app = typer.Typer(add_completion=False, pretty_exceptions_enable=False)


@app.command()
def set_aside(
    name: Annotated[
        str | None, typer.Argument(help="Name of one window, as it is listed; default: all.")
    ] = None,
    to: Annotated[
        Path | None,
        typer.Option(metavar="FILE.npz", help="Write the window there, as a record file."),
    ] = None,
    again: Annotated[
        bool, typer.Option("--again", help="Send it, or all, to the service once more.")
    ] = False,
    data: Annotated[Path | None, typer.Option(help="Data folder of the gateway.")] = None,
    as_json: AsJson = False,
) -> None:
    """List what the service refused and the gateway set aside. Once an update has mended the
    reason, --again has it stored.
    """
    settings = load_settings(data=data)
    aside = SetAside(settings.data)
    chosen = aside.newest(limit=None) if name is None else [aside.get(name)]
    if to is not None:
        if name is None:
            raise BadInput(
                "--to: takes one window; give its name, as `residuum set-aside` lists them"
            )
        _write(window_of(aside.request(name)), to)
    # After the file was written: a window that is stored leaves the folder.
    outcomes = _sent_again(settings, aside, chosen) if again else {}
    lines = [_line(refusal, outcomes) for refusal in chosen]
    answer = {
        "windows": [asdict(refusal) for refusal in chosen],
        "stored": [sent_name for sent_name, why_refused in outcomes.items() if why_refused is None],
    }
    report(answer, "\n".join(lines) or "Nothing is set aside.", as_json=as_json)


def _sent_again(
    settings: Settings, aside: SetAside, chosen: Sequence[Refusal]
) -> dict[str, str | None]:
    """By name, why a window was refused again; None where it is stored now, and has left the
    folder.
    """
    sending, outcomes = sending_of(settings), dict[str, str | None]()
    # the oldest first, under their own keys: what is stored already is stored no second time
    for refusal in sorted(chosen, key=lambda refusal: refusal.name):
        try:
            sending.send(refusal.key, aside.request(refusal.name))
        except Refused as refused:
            outcomes[refusal.name] = str(refused)
        except OSError as error:
            raise BadInput(
                f"{refusal.name}: the service at {sending.url} does not take it now, so it stays:"
                f" {error}"
            ) from None
        else:
            aside.let_go(refusal.name)
            outcomes[refusal.name] = None
    return outcomes


def _line(refusal: Refusal, outcomes: dict[str, str | None]) -> str:
    """A window as it is listed; with why it was refused again, None where it is stored now."""
    begin = f"{refusal.name}: {refusal.size_bytes} bytes of {refusal.machine}"
    if refusal.name not in outcomes:
        return f"{begin}: {refusal.reason}"
    why_refused = outcomes[refusal.name]
    if why_refused is None:
        return f"{begin}: is stored now"
    return f"{begin}: was refused again, and stays: {why_refused}"


def _write(content: bytes, to: Path) -> None:
    try:
        to.write_bytes(content)
    except OSError as error:
        raise BadInput(f"--to {to}: cannot be written: {error.strerror}") from None
