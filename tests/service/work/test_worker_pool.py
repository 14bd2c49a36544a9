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
