"""An answer depends on the data alone: not on what is compiled already, nor on what else the machine does."""

import sys

import pytest

from benchmarks.same_answers import answers
from residuum.identification.record import Record
from residuum.identification.record_formats import write_record
from residuum.simulation import MACHINES

CUT = """
import sys
from residuum.identification.unseen_blocks import record_search
record_search.MOST_EFFORT = 2_000_000
from residuum.service.cli import main
sys.exit(main())
"""
"""The command with so little work that the search is cut."""


@pytest.fixture(scope="module")
def record(tmp_path_factory):
    signals = MACHINES["gate-drive"](
        seed=5, effects={"coulomb-friction": {"tau_c": 0.03}}, rate=200.0
    ).simulate(4.0)
    path = tmp_path_factory.mktemp("record") / "drive.csv"
    write_record(Record(signals.channels, signals.units, signals.sample_time), path)
    return str(path)


@pytest.mark.parametrize("bound", ["to its end", "cut"])
def test_uncompiled_compiled_and_beside_busy_processes(record, bound, tmp_path):
    program = ["-m", "residuum"] if bound == "to its end" else ["-c", CUT]
    effects = "coulomb-friction,viscous-friction"
    found = answers(
        [sys.executable, *program, "explain", "gate-drive", record, "--effects", effects],
        tmp_path / "cache",
    )
    first = found.pop("filled")
    assert all(other == first for other in found.values())
    assert bool(first["work"]["not_tried"]) == (bound == "cut")
    assert not first["work"]["out_of_seconds"]
