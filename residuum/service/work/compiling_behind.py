"""Compiles what explanations need behind the running service, in a process of its own that gives way to everything else."""

from __future__ import annotations

import os
import subprocess
import sys
import threading

import structlog

from residuum.identification.discrepancy import compile_ahead

log = structlog.get_logger()

_LOWEST_PRIORITY = 19
_STOP_TIMEOUT = 3.0


class CompilingBehind:
    """The process that compiles; none where everything was compiled before.

    An explanation that is asked for meanwhile waits for it and says so: nothing is compiled twice.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._stopped = False

    def start(self) -> None:
        """Begin, where there is something to compile."""
        if compile_ahead.is_compiled():
            return
        log.info("compiling behind what the first explanation needs")
        command = [sys.executable, "-m", compile_ahead.__name__, "--with-parent"]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)
        os.setpriority(os.PRIO_PROCESS, self._process.pid, _LOWEST_PRIORITY)
        threading.Thread(target=self._wait, args=(self._process,), name="compiling behind", daemon=True).start()

    def stop(self) -> None:
        """End it; what was compiled by then is kept."""
        self._stopped = True
        if self._process is not None:
            self._process.terminate()
            try:
                self._process.wait(_STOP_TIMEOUT)
            except subprocess.TimeoutExpired:
                self._process.kill()

    def _wait(self, process: subprocess.Popen[bytes]) -> None:
        assert process.stderr is not None
        said = process.stderr.read()
        process.wait()
        if process.returncode == 0:
            log.info("compiled what the first explanation needs")
        elif not self._stopped:
            reason = said.decode("utf-8", "replace").strip().rpartition("\n")[-1] or f"exit status {process.returncode}"
            log.error("compiling behind failed; the first explanation compiles", reason=reason)
