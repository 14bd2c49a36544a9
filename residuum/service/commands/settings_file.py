"""The option that names the settings' file."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

SettingsFile = Annotated[
    Path | None, typer.Option("--settings", help="Settings file (YAML). Default: the file that RESIDUUM_SETTINGS names.")
]
