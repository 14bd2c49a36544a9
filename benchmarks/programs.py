"""Programs of the system that benchmarks start beside the service."""

from __future__ import annotations

import os
import shutil
from pathlib import Path


def find_program(name: str) -> str | None:
    """A program of Debian's packages, wherever they put it; None when it is not installed."""
    folders = [
        *map(str, sorted(Path("/usr/lib/postgresql").glob("*/bin"), reverse=True)),
        os.environ["PATH"],
        "/usr/sbin",
    ]
    return shutil.which(name, path=os.pathsep.join(folders))
