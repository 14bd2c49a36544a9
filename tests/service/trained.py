"""The demo's diagnosers, trained once a test run, by the first of its processes that asks."""

import fcntl
import functools
import os
from pathlib import Path

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.service.simulated.demo_training import train

DIAGNOSER_OF = {"gate-actuator": "gate-actuator", "gripping-pliers": "gripping-pliers", "process-plant": "robust-residual"}


def _file(machine):
    """The baseline file of a demo machine, as the demo trains it."""
    folder = Path(os.environ["RESIDUUM_TEST_TRAINED"])
    file, finished = folder / f"{machine}.zip", folder / f"{machine}.finished"
    with (folder / f"{machine}.lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)  # who comes while another trains it, waits for him
        if not finished.exists():
            train(machine, DIAGNOSER_OF[machine], str(folder))
            finished.touch()
    return file


@functools.lru_cache
def baseline(machine):
    """The content of that file."""
    return _file(machine).read_bytes()


@functools.lru_cache
def diagnoser(machine):
    return DIAGNOSERS[DIAGNOSER_OF[machine]].load(_file(machine))
