"""After `compile_ahead` no loop of the library is left to be compiled in front of a waiting user."""

import os
import subprocess
import sys

EXPLAINING = """
import numba.core.event as event
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.discrepancy.compile_ahead import compile_ahead
from residuum.identification.discrepancy.explain import explain
from residuum.identification.physics import load_model
from residuum.identification.record import Record
from residuum.simulation import MACHINES

class Compiled(event.Listener):
    def on_start(self, e):
        loop = e.data["dispatcher"].py_func
        if loop.__module__.startswith("residuum.identification"):
            print(loop.__module__, loop.__name__, e.data["args"])
    def on_end(self, e):
        pass

compile_ahead()
signals = [
    MACHINES["gate-drive"](seed=2, effects={"coulomb-friction": {"tau_c": 0.03}}, rate=500.0).simulate(10.0),
    MACHINES["oven"](seed=2).simulate(1500.0),
]
event.register("numba:compile", Compiled())
for name, s in zip(("gate-drive", "oven"), signals):
    record = Record(s.channels, s.units, s.sample_time)
    compare(load_model(name), [record])
    explain(load_model(name), [record])
"""


def test_nothing_is_left_to_compile(tmp_path):
    nothing_compiled = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-c", EXPLAINING]
    said = subprocess.run(command, capture_output=True, text=True, check=True, env=nothing_compiled).stdout
    assert said == ""
