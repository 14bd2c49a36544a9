"""Freed arrays are used again, not fetched from the system anew."""

import subprocess
import sys

import pytest

FAULTS = """
import resource
import numpy as np
from residuum.identification.freed_memory import keep_freed_memory
if {kept}:
    keep_freed_memory()
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
        command = [sys.executable, "-c", FAULTS.format(kept=kept)]
        return int(subprocess.run(command, capture_output=True, text=True, check=True).stdout)

    assert faults(kept=True) < 1000
    assert faults(kept=False) > 5 * faults(kept=True)
