"""Peers: what our methods are held against.

Other people's live in environments of their own under .peers, made when first needed; methods of our own that no command and no
page uses are the modules of this folder.
"""

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

FOLDER = Path(__file__).parents[1] / ".peers"


def run_peer(name: str, packages: list[str], script: str, timeout: float = 600.0) -> Any:
    """The JSON value that `script` prints last, run in the environment `name`; None when it cannot be installed or fails."""
    python = FOLDER / name / "bin" / "python"
    try:
        if not python.exists():
            subprocess.run(
                [sys.executable, "-m", "venv", FOLDER / name],
                check=True,
                capture_output=True,
                timeout=timeout,
            )
        subprocess.run(
            [python, "-m", "pip", "install", "--quiet", *packages],
            check=True,
            capture_output=True,
            timeout=timeout,
        )
        done = subprocess.run(
            [python, "-c", script], check=True, capture_output=True, text=True, timeout=timeout
        )
    except (subprocess.SubprocessError, OSError):
        return None
    return json.loads(done.stdout.strip().splitlines()[-1])
