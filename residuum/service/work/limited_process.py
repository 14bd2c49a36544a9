"""A stranger's bytes are read in a process of its own, with limits on memory, time, files and
output. What is hostile or broken can end that process, and nothing else.

The process is a module run as a program, `python -m MODULE MEMORY SECONDS …`. A refusal is its kind
and its parts, JSON on standard output, and exit status 2.
"""

from __future__ import annotations

import contextlib
import json
import os
import resource
import subprocess
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from residuum.identification.errors import BadInput

# Exit status of a refusal; the interpreter's own for an exception is 1.
_REFUSED = 2
# Files that such a process may have open: libraries and the one it reads.
_FILES = 64
# Waiting time a second of processor time, after which a process that only waits is ended. Long,
# because a busy machine gives a small part of a processor, and whether a file can be read must not
# hang on that.
_PATIENCE = 20


def run_limited(
    module: str, arguments: Sequence[str], folder: Path, *, memory: int, seconds: int
) -> tuple[str, dict[str, Any]] | None:
    """Run a module in `folder` with at most `memory` bytes and `seconds` of processor time. How
    many run at once is the caller's to say (`Services.reading`).

    Gives why it refused, as kind and parts, where the kind is empty when a limit was exceeded or
    the process ended; None when it did what it was asked.
    """
    # a thread's stack counts as memory, and how many there are must not hang on the machine
    threads = dict.fromkeys(("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"), "1")
    names = ("PATH", "PYTHONPATH", "LANG", "HOME", "NUMBA_CACHE_DIR", "RESIDUUM_CACHE")
    inherited = {name: os.environ[name] for name in names if name in os.environ}
    try:
        done = subprocess.run(
            [sys.executable, "-P", "-m", module, str(memory), str(seconds), *arguments],
            env=inherited
            | threads
            | {"TMPDIR": str(folder)},  # libraries leave files there when they fail
            cwd=folder,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            timeout=_PATIENCE * seconds,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return "", {"what": f"reading it takes longer than {_PATIENCE * seconds} s"}
    if done.returncode == 0:
        return None
    if done.returncode == _REFUSED:
        kind, parts = json.loads(done.stdout)
        return kind, parts
    ended = (
        f"reading it ended the process that did ({done.returncode}); at most {memory} bytes and"
        f" {seconds} s are given"
    )
    return "", {"what": ended}


def within_limits(work: Callable[[], None], memory: int, seconds: int) -> int:
    """Do the work of such a process; gives its exit status. The limits stay: this is for a process
    of its own.
    """
    _limit(memory, seconds)
    try:
        with contextlib.redirect_stdout(sys.stderr):  # a library's chatter is no refusal
            work()
    except BadInput as error:
        json.dump([type(error).__name__, error.parts], sys.stdout)
        return _REFUSED
    except MemoryError:
        json.dump(
            ["", {"what": f"reading it takes more than {memory} bytes of memory"}], sys.stdout
        )
        return _REFUSED
    return 0


def _limit(memory: int, seconds: int) -> None:
    limits = {
        # data, not address space: libraries map far more than they touch
        resource.RLIMIT_DATA: memory,
        resource.RLIMIT_CPU: seconds,
        resource.RLIMIT_NOFILE: _FILES,
        resource.RLIMIT_FSIZE: memory,
        resource.RLIMIT_CORE: 0,
    }
    for kind, most in limits.items():
        resource.setrlimit(kind, (most, most))
