"""Worker processes end with whoever they work for, however that ended."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

PATIENCE = 300.0
SERVICE = """
import os, time
from residuum.service.work.worker_pool import WorkerPool
if __name__ == "__main__":
    pool = WorkerPool(2)
    asked = [pool.submit(os.getppid), pool.submit(os.getpid)]
    print(*(each.result() for each in asked), flush=True)
    time.sleep(3600)
"""


def is_there(process):
    """Whether a process lives (one that has ended and that nobody has asked about does not)."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


def test_workers_and_their_server_end_when_the_service_is_killed(tmp_path):
    program = tmp_path / "service.py"
    program.write_text(SERVICE)
    with subprocess.Popen([sys.executable, program], stdout=subprocess.PIPE, text=True) as service:
        server, worker = map(int, service.stdout.readline().split())
        assert is_there(server) and is_there(worker) and server != service.pid
        os.kill(service.pid, signal.SIGKILL)
    end = time.monotonic() + PATIENCE
    while is_there(server) or is_there(worker):
        assert time.monotonic() < end, "what a killed service leaves behind does not end"
        time.sleep(0.05)


def test_what_workers_are_copies_of_has_loaded_every_diagnoser():
    """Else each worker would load them by itself, for seconds, before its first window."""
    code = (
        "import sys, residuum.service.fleet.worker_preload;"
        "from residuum.diagnosis.diagnosers import DIAGNOSERS;"
        "loaded = {kind.__module__ for kind in DIAGNOSERS.values()};"
        "print(loaded <= set(sys.modules), 'residuum.identification.unseen_blocks.search' in sys.modules,"
        " len(residuum.service.fleet.worker_preload.LOADED) >= 5)"
    )
    printed = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout
    assert printed == "True True True\n"
