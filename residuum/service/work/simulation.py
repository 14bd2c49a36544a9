"""Running a virtual machine as the work of a job."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from residuum.library.virtual_machine import simulated
from residuum.service.work.jobs import Progress
from residuum.service.work.record_parts import parts_of


def simulate(
    progress: Progress, machine: str, effects: Mapping[str, Mapping[str, float] | str], duration: float | None, seed: int
) -> Mapping[str, Any]:
    """`record`: the parts of the machine's record, without a word of what is hidden in it."""
    progress(0.0, "running the virtual machine")
    record, _ = simulated(machine, effects, None, None, duration, seed, 0, False, {})
    return {"record": parts_of(record)}
