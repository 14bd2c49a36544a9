"""The demo's diagnosers, trained once a test run."""

import functools
import tempfile
from pathlib import Path

from residuum.diagnosis.diagnosers import DIAGNOSERS
from residuum.service.simulated.demo_training import train

DIAGNOSER_OF = {"gate-actuator": "gate-actuator", "gripping-pliers": "gripping-pliers", "process-plant": "robust-residual"}


@functools.lru_cache
def baseline(machine):
    """The baseline file of a demo machine, as the demo trains it."""
    with tempfile.TemporaryDirectory() as folder:
        return train(machine, DIAGNOSER_OF[machine], folder)


@functools.lru_cache
def diagnoser(machine):
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "baseline.zip"
        file.write_bytes(baseline(machine))
        return DIAGNOSERS[DIAGNOSER_OF[machine]].load(file)
