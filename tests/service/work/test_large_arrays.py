"""What large arrays took is given back to the system, whatever was freed before, or kept, where that was asked for."""

import os
import subprocess
import sys

import pytest

_MEASURE = """
import threading, numpy as np
from pathlib import Path
from residuum.service.work.worker_pool import give_back_large_arrays
if {given_back}:
    assert give_back_large_arrays()

def work():
    kept = []
    for _ in range(4):
        np.ones(1_000_000)
        arrays = [np.ones(1_000_000) for _ in range(4)]
        kept.append(np.ones(2000))
        del arrays
    held.append(kept)

held = []
np.ones(1_000_000)
pages = lambda: int(Path("/proc/self/statm").read_text().split()[1])
before = pages()
for _ in range(8):
    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
print(pages() - before)
"""


@pytest.mark.skipif(
    not sys.platform.startswith("linux") or "MALLOC_ARENA_MAX" in os.environ,
    reason="needs glibc's own settings",
)
def test_large_arrays_leave_no_mark():
    run = subprocess.run(
        [sys.executable, "-c", _MEASURE.format(given_back=True)],
        capture_output=True,
        text=True,
        check=True,
    )
    assert int(run.stdout) * os.sysconf("SC_PAGE_SIZE") < 8_000_000


_FAULTS = """
import resource
import numpy as np
from residuum.service.work.worker_pool import keep_large_arrays
if {kept}:
    assert keep_large_arrays()
for _ in range(20):
    a, b = np.ones(400_000), np.ones(400_000)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(50):
    a, b = np.ones(400_000), np.ones(400_000)
    del a, b
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="settings of glibc")
def test_arrays_that_come_and_go_fetch_no_new_pages():
    def faults(kept):
        command = [sys.executable, "-c", _FAULTS.format(kept=kept)]
        return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)

    assert faults(kept=True) < 1000
    assert faults(kept=False) > 5 * faults(kept=True)
