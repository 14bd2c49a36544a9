"""Machine code lives as long as its functions, and no longer than that, whatever is loaded and dropped meanwhile."""

import gc

import numpy as np

from residuum.identification.physics import Experiment, Simulator, load_model
from residuum.identification.physics.compile import machine_code
from residuum.identification.physics.compile.code_generation import generate
from residuum.identification.physics.compile.composition import compose
from residuum.identification.physics.compile.kernel import _kernel


def test_dropped_code_takes_nothing_along(monkeypatch):
    monkeypatch.setattr(machine_code, "_PLACED", 7)  # so that linkers come and go too
    model = load_model("linear-axis")
    simulator = Simulator(model)
    push = Experiment(np.full((50, 1), 95.0), np.full((50, 2), np.nan), np.zeros(1), sample_time=0.1)
    before = simulator.run(push).Y
    code = [machine_code.compiled(text) for text in generate(compose(model))]
    for _ in range(60):
        addresses = [f.__wrapper_address__() for f in machine_code.loaded(code, machine_code.FUNCTIONS)]
        assert all(addresses)
    _kernel.cache_clear()
    gc.collect()
    assert np.array_equal(simulator.run(push).Y, before)
    assert np.array_equal(Simulator(model).run(push).Y, before)
