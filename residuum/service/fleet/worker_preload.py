"""What worker processes have loaded before they are made: the fork server imports this once, each
worker is a copy of it.

One thread a worker, set before NumPy is loaded, because the workers share the cores; a library that
starts threads when it is loaded must not come in here, since they are not copied.
"""

import os

for _name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")

import skops.io  # noqa: E402, F401

import residuum.service.fleet.fleet  # noqa: E402
import residuum.service.machines.scoring  # noqa: E402, F401
from residuum.diagnosis.diagnosers import DIAGNOSERS  # noqa: E402

# A family imports its members when they are asked for; here all are, once for every worker.
LOADED = list(DIAGNOSERS.values())
