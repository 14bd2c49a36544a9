"""A stored baseline as a file that worker processes can load."""

from __future__ import annotations

import hashlib
import os
import tempfile
from pathlib import Path


def baseline_file(data: Path, content: bytes) -> str:
    """The name of the file with this content, below the data folder; written once, however many ask for it at once."""
    folder = data / "baselines"
    folder.mkdir(parents=True, exist_ok=True)
    file = folder / f"{hashlib.sha256(content).hexdigest()[:24]}.zip"
    if not file.exists():
        handle, part = tempfile.mkstemp(dir=folder, suffix=".part")
        with os.fdopen(handle, "wb") as opened:
            opened.write(content)
        os.replace(part, file)
    return str(file.resolve())
