"""After `compile_ahead` no loop of the library is left to be compiled in front of a waiting user."""

import os
import subprocess
import sys

from residuum.identification.discrepancy import compile_ahead

EXPLAINING = """
import gc
from numba.core.dispatcher import Dispatcher
from residuum.identification.residual_analysis.compare import compare
from residuum.identification.discrepancy.compile_ahead import compile_ahead
from residuum.identification.discrepancy.explain import explain
from residuum.identification.physics import load_model
from residuum.identification.record import Record
from residuum.simulation import MACHINES

def ready():
    loops = [each for each in gc.get_objects() if isinstance(each, Dispatcher)]
    ours = [loop for loop in loops if loop.py_func.__module__.startswith("residuum.identification")]
    return {(loop.py_func.__module__, loop.py_func.__name__, types) for loop in ours for types in loop.signatures}

compile_ahead()
ahead = ready()
assert len(ahead) > 10
signals = [
    MACHINES["gate-drive"](seed=2, effects={"coulomb-friction": {"tau_c": 0.03}}, rate=500.0).simulate(10.0),
    MACHINES["oven"](seed=2).simulate(3000.0),
]
for name, s in zip(("gate-drive", "oven"), signals):
    record = Record(s.channels, s.units, s.sample_time)
    compare(load_model(name), [record])
    explain(load_model(name), [record])
for late in ready() - ahead:
    print(late)
"""


def test_nothing_is_left_to_compile():
    """Told by the types that each loop was called with, so that nothing has to be compiled: it may well be on disk already."""
    said = subprocess.run(
        [sys.executable, "-c", EXPLAINING], capture_output=True, text=True, check=True
    ).stdout
    assert said == ""


def test_it_ends_with_the_program_that_started_it(tmp_path):
    """Even where that was ended by force: the system closes its end of the pipe."""
    nothing_kept = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path), "RESIDUUM_CACHE": str(tmp_path)}
    command = [sys.executable, "-m", compile_ahead.__name__, "--with-parent"]
    with subprocess.Popen(command, env=nothing_kept, stdin=subprocess.PIPE) as compiling:
        compiling.stdin.close()
        assert compiling.wait(300) == 1
