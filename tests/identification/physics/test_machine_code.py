"""Machine code is made once, structures share it, and it lives as long as its functions, whatever is dropped meanwhile."""

import gc
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from residuum.identification.physics import Experiment, Simulator, load_model
from residuum.identification.physics.compile import machine_code
from residuum.identification.physics.compile.code_generation import generate
from residuum.identification.physics.compile.composition import compose
from residuum.identification.physics.compile.kernel import (
    cache_folder,
    kernel_of,
    kernel_of_structure,
)


def test_dropped_code_takes_nothing_along(monkeypatch):
    monkeypatch.setattr(machine_code, "_PLACED", 7)  # so that linkers come and go too
    model = load_model("linear-axis")
    simulator = Simulator(model)
    push = Experiment(
        np.full((50, 1), 95.0), np.full((50, 2), np.nan), np.zeros(1), sample_time=0.1
    )
    before = simulator.run(push).Y
    code = [machine_code.compiled(text) for text in generate(compose(model))]
    for _ in range(60):
        addresses = [
            f.__wrapper_address__() for f in machine_code.loaded(code, machine_code.FUNCTIONS)
        ]
        assert all(addresses)
    kernel_of_structure.cache_clear()
    gc.collect()
    assert np.array_equal(simulator.run(push).Y, before)
    assert np.array_equal(Simulator(model).run(push).Y, before)


@pytest.fixture
def empty_cache(tmp_path, monkeypatch):
    """Nothing compiled on disk, nor kept in memory."""
    monkeypatch.setenv("RESIDUUM_CACHE", str(tmp_path / "cache"))
    kernel_of_structure.cache_clear()
    yield cache_folder()
    kernel_of_structure.cache_clear()


def test_structures_share_what_their_equations_do_not_change(empty_cache):
    model = load_model("linear-axis")
    kernel_of(model)
    alone = set(empty_cache.glob("code_*"))
    kernel_of(model.with_effect("constant-load", "axis"))
    assert len(alone) == 3
    # its own equations; columns and observation are there
    assert len(set(empty_cache.glob("code_*")) - alone) == 1


def test_a_structure_that_many_threads_ask_for_is_compiled_once(empty_cache, monkeypatch):
    compiled, texts = machine_code.compiled, []
    monkeypatch.setattr(machine_code, "compiled", lambda text: texts.append(text) or compiled(text))
    model = load_model("linear-axis")
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(kernel_of, [model] * 4))
    assert len(texts) == len(set(texts)) == 3


def test_code_that_was_removed_from_the_cache_is_made_again(empty_cache):
    model = load_model("linear-axis")
    kernel_of(model)
    for path in empty_cache.glob("code_*"):
        path.unlink()
    kernel_of_structure.cache_clear()
    assert kernel_of(model).states == ("q", "v")
