"""A settings file with comments, for one machine."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated

import typer

from residuum.service.fieldbus import SOURCES
from residuum.service.fieldbus.settings import MachineSettings, SourceSettings

# Options that say where the service has its settings and its data.

SettingsFile = Annotated[
    Path | None,
    typer.Option(
        "--settings",
        help="Settings file (YAML). Default: the file that the variable RESIDUUM_SETTINGS names.",
    ),
]
DatabaseUrl = Annotated[
    str | None, typer.Option(help="SQLAlchemy URL; default: SQLite in the data folder.")
]
DataFolder = Annotated[
    Path | None, typer.Option(help="Folder of signal blocks, baselines and the default database.")
]


# What most plants set, as comments with their defaults: a reader sees what there is to change, and
# `residuum doctor` says what is missing.
_HEAD = """\
# Settings of Residuum. Start the service with:   residuum serve --settings THIS_FILE
# What is missing in it says:                     residuum doctor --settings THIS_FILE
# Names of files count from the folder in which the command is called.

# data: var                 # folder of windows, baselines and the database
# port: 8000                # the page is at http://127.0.0.1:8000/
# api_keys: keys.txt        # needed before `host: 0.0.0.0` lets other machines in

machines:
"""


def settings_template(
    asset: str,
    machine: MachineSettings | None,
    signals: Mapping[str, str],
    model: str | None,
    channels: Mapping[str, str],
) -> str:
    """The file's text.

    Parameters
    ----------
    machine : MachineSettings or None
        With the source that is known; None writes examples to fill in.
    signals : mapping of name to unit
        What the bus carries.
    model : str or None
    channels : mapping
        Model's name of a signal → the bus's.
    """
    lines = [f"  - asset: {asset}             # its name on the page", *_judge(model), *_windows()]
    lines += ["", "    # Where its signals come from.", "    sources:", *_sources(machine)]
    lines += ["", *_channels(signals, channels), "", *_alarms()]
    return _HEAD + "\n".join(lines) + "\n"


def _judge(model: str | None) -> list[str]:
    named = (
        f"    model: {model}"
        if model
        else "    model: my-machine.yaml     # FILL IN: the file with the machine's balances"
    )
    return [
        "    diagnoser: model-based     # judges any machine that has a model",
        named,
        "",
        (
            "    # Signals are cut into windows: `length` seconds every `step` seconds. A window"
            " must show the machine at work."
        ),
    ]


def _windows() -> list[str]:
    return ["    window: {cut: sliding, length: 10, step: 10}"]


def _sources(machine: MachineSettings | None) -> list[str]:
    if machine is not None:
        return [_source(source) for source in machine.sources]
    first, *others = (kind.template for kind in SOURCES.values())
    return [f"      {first[0]} # {first[1]}"] + [
        f"      # {line} # {says}" for line, says in others
    ]


def _source(source: SourceSettings) -> str:
    if not SOURCES[source.kind].by_host:
        return f'      - {{kind: {source.kind}, channel: "{source.channel}", map: {source.map}}}'
    return f"      - {{kind: {source.kind}, host: {source.host}, port: {source.port}, map: {source.map}}}"


def _channels(signals: Mapping[str, str], channels: Mapping[str, str]) -> list[str]:
    lines = [
        "    # Names of signals: the model's on the left, the bus's on the right. Equal names need"
        " no line."
    ]
    if signals:
        lines.append(
            "    # The bus has"
            f" {', '.join(f'{name} [{unit or 1}]' for name, unit in signals.items())}."
        )
    different = {name: bus for name, bus in channels.items() if name != bus}
    if different:
        return [
            *lines,
            "    channels:",
            *(f"      {name}: {bus}" for name, bus in different.items()),
        ]
    return [*lines, "    # channels:", "    #   speed: n_motor"]


def _alarms() -> list[str]:
    return [
        "    # When a finding becomes an alarm.",
        "    # alarms: {on_delay: 0, off_delay: 0, deadband: 0, latch: false}",
        "    #   # and, where they are known: consequence: major, time_to_respond: 1800, action: …",
    ]
