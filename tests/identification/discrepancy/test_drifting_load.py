"""A load that nobody recorded, on a controlled axis that is judged in windows; the machine is integrated here, in fine steps."""

from pathlib import Path

import numpy as np
import pytest

from residuum.identification.discrepancy.explain import explain
from residuum.identification.errors import BadModel
from residuum.identification.physics import read_model
from residuum.identification.record import Record

AXIS = Path(__file__).with_name("axis.yaml").read_text()
SAMPLE_TIME, FINE = 0.004, 20


def axis(load, friction=0.0, seed=3, n=4000):
    """An axis of 40 kg that a controller moves to and fro, pushed by `load` at every sample."""
    rng = np.random.default_rng(seed)
    wanted = np.convolve(
        np.repeat(rng.uniform(-0.2, 0.2, n // 200 + 1), 200)[:n], np.full(100, 1 / 100), mode="same"
    )
    q = v = pull = 0.0
    F, Q = np.empty(n), np.empty(n)
    h = SAMPLE_TIME / FINE
    for i in range(n):
        Q[i] = q + 2e-5 * rng.standard_normal()
        pull += 2.0 * SAMPLE_TIME * 4e3 * (wanted[i] - q)
        F[i] = np.clip(8.0e3 * (wanted[i] - q) - 8e2 * v + pull, -500.0, 500.0)
        for _ in range(FINE):
            before = v
            v += h * (F[i] - 57.0 * v - load[i] - friction * np.sign(v)) / 40.0
            q += h * (before + v) / 2
    return Record({"force": F, "position": Q}, {"force": "N", "position": "m"}, SAMPLE_TIME)


def explained(record, effects):
    return explain(read_model(AXIS, "axis.yaml"), [record], effects=effects)


def test_a_load_that_changes_slowly_is_no_effect():
    """Constant within a window, it passed for whatever has a mean there: a spring, a friction with a long travel, a weight."""
    slow = 8.0 * np.sin(2 * np.pi * np.arange(4000) * SAMPLE_TIME / 11.0)
    found = explained(
        axis(slow), ["constant-load", "linear-spring", "coulomb-friction", "hysteresis"]
    )
    assert found.drifting
    assert found.verdict == "unknown-effect"
    assert all(c.probability < 0.5 for c in found.candidates)


def test_friction_is_found_though_a_load_drifts():
    slow = 8.0 * np.sin(2 * np.pi * np.arange(4000) * SAMPLE_TIME / 11.0)
    found = explained(
        axis(slow, friction=12.0), ["constant-load", "linear-spring", "coulomb-friction"]
    )
    assert found.drifting
    friction = found.candidates[0]
    assert friction.effect == "coulomb-friction"
    # which the load that drifts is taken for, too
    assert friction.parameters["tau_c"].value == pytest.approx(12.0, rel=0.5)


def test_a_weight_needs_no_load_of_every_window():
    found = explained(
        axis(np.full(4000, 15.0)), ["constant-load", "linear-spring", "coulomb-friction"]
    )
    assert not found.drifting
    assert list(found.accepted) == [("constant-load", "slide")]


def test_no_model_file_may_hold_a_load_that_only_judges():
    drifting = "effects:\n  - {id: drifting-load, balance: slide}\n"
    with pytest.raises(BadModel, match="catalogue"):
        read_model(AXIS + drifting, "axis.yaml")
