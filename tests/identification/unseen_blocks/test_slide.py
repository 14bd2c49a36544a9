"""A slide in its position loop, sampled much more finely than it moves: its friction by two effects, at a lower rate."""

import numpy as np
import pytest

from residuum.identification.physics import read_model
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.data import coarser, matched
from residuum.identification.unseen_blocks.record_search import searched
from residuum.identification.unseen_blocks.tried import Wanted

AXIS = """
name: axis
inputs: {force: N}
states: {q: {unit: m, rate: v}, v: {unit: m/s}}
parameters:
  M: {value: 95, unit: kg, lower: 20, upper: 400}
balances:
  axis: {kind: force, storage: M * der(v), terms: {drive: force}, position: q, velocity: v}
outputs: {position: {value: q, unit: m}}
"""
RATE, VISCOUS, DRY = 500, 210.0, 20.0


def _slide(seed, seconds=24, noise=2e-7):
    """Three sines of the reference, force held over a sample, friction that sticks; and 2 N that nothing explains."""
    rng, h, n = np.random.default_rng(seed), 1.0 / RATE / 4, RATE * seconds
    t = np.arange(n) / RATE
    phase = rng.uniform(0.0, 2.0 * np.pi, 3)
    reference = 0.1 * sum(
        np.sin(2.0 * np.pi * f * t + p) for f, p in zip((0.11, 0.31, 0.53), phase, strict=True)
    )
    rate = np.gradient(reference, 1.0 / RATE)
    force, position, q, v = np.zeros(n), np.zeros(n), float(reference[0]), float(rate[0])
    for k in range(n):
        position[k] = q
        force[k] = 3e4 * (reference[k] - q) + 3e3 * (rate[k] - v)
        for _ in range(4):
            pushed = v + h * (force[k] - VISCOUS * v + 2.0) / 100.0
            v = np.sign(pushed) * max(abs(pushed) - h * DRY / 100.0, 0.0)
            q += h * v
    return Record(
        {"force": force, "position": position + noise * rng.standard_normal(n)},
        {"force": "N", "position": "m"},
        1.0 / RATE,
    )


def test_both_frictions_are_named_and_sized_at_a_lower_rate():
    ids = (
        "viscous-friction",
        "coulomb-friction",
        "directional-viscous",
        "quadratic-drag",
        "linear-spring",
        "hysteresis",
    )
    found = searched(read_model(AXIS), [_slide(3)], None, Wanted(ids, held=False))
    values = found.best.model.values
    dry = [values[name] for name in values if name.endswith("tau_c")]
    viscous = [values[name] for name in values if name.endswith((".d", ".d_plus", ".d_minus"))]
    assert dry == pytest.approx([DRY], rel=0.15) and np.mean(viscous) == pytest.approx(
        VISCOUS, rel=0.1
    ), found.best.keys
    assert found.validation.data.finer is not None


def test_a_lower_rate_moves_the_model_s_outputs_by_nothing():
    data = matched(read_model(AXIS), [_slide(4)], None)
    less = coarser(data)
    step = round(less.experiments[0].sample_time / data.experiments[0].sample_time)
    assert step >= 2 and less.experiments[0].n == data.experiments[0].n // step
    np.testing.assert_array_equal(
        less.experiments[0].Y, data.experiments[0].Y[: step * less.experiments[0].n : step]
    )


def test_records_that_would_lose_by_a_lower_rate_keep_theirs():
    rng = np.random.default_rng(5)
    u = rng.choice([-50.0, 50.0], 12000)  # a new force at every sample
    v = np.cumsum(u) / 100.0 / RATE
    q = np.cumsum(v) / RATE
    model = read_model(AXIS)
    record = Record({"force": u, "position": q}, {"force": "N", "position": "m"}, 1.0 / RATE)
    assert coarser(matched(model, [record], None)).finer is None
