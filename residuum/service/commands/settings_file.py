"""Options that say where the service has its settings and its data."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

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
