"""Errors on unseen blocks in closed form, against models that were estimated without those blocks."""

from dataclasses import replace

import numpy as np
import pytest

from residuum.identification.physics import estimate, read_model
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.data import matched
from residuum.identification.unseen_blocks.judged import judged
from residuum.identification.unseen_blocks.ladder import climb

CART = """
name: cart
inputs: {force: N}
states: {v: {unit: m/s}}
parameters:
  M: {value: 2.0, unit: kg, lower: 0.1}
  d: {value: 1.0, unit: N*s/m, lower: 0.01}
  k: {value: 0.5, unit: N, lower: -5, upper: 5}
balances: {body: {kind: force, storage: M * der(v), terms: {drive: force, drag: -d * v, load: k}, velocity: v}}
outputs: {speed: {value: v, unit: m/s}}
"""


def cart_record(n=1200, friction=0.0, noise=0.02, seed=1):
    rng, h = np.random.default_rng(seed), 0.02
    force, v, speed = np.repeat(rng.uniform(-6.0, 6.0, n // 40), 40), 0.0, np.empty(n)
    for i in range(n):
        speed[i] = v
        for _ in range(10):
            v += h / 10 * (force[i] - 3.0 * v - friction * np.tanh(v / 1e-3) + 0.7) / 2.5
    return Record({"force": force, "speed": speed + noise * rng.normal(size=n)}, {"force": "N", "speed": "m/s"}, h)


@pytest.mark.parametrize("friction", [0.0, 1.5])
def test_blocks_left_out_are_judged_as_by_a_fit_without_them(friction):
    data = matched(read_model(CART), [cart_record(n=2000, friction=friction)], None)
    climbed = climb(data)
    one = judged(climbed.structure, climbed.found, climbed.last, data, climbed.scale)
    (part,), begins = climbed.last.parts, {"v": climbed.found.initial[0][0]}  # where it began is not what is judged
    left = np.zeros(data.blocks)
    for fold in np.unique(data.fold):
        out = data.fold[climbed.last.block] == fold
        masked = replace(part, Y=np.where(out[:, None], np.nan, part.Y), known=begins)
        rest = estimate(climbed.structure.model, [masked], initial=climbed.found.initial)
        errors = np.where(out, (part.Y - rest.predicted[0])[:, 0], 0.0) / data.spread[0]
        left += np.bincount(climbed.last.block, weights=errors**2, minlength=data.blocks)
    seen = float(np.sum((climbed.found.residuals[0] / data.spread) ** 2))
    assert left.sum() > seen  # what the fit has not seen is more
    assert one.power.sum() == pytest.approx(left.sum(), rel=0.01)
    assert one.power.sum() - seen == pytest.approx(left.sum() - seen, rel=0.1)
    assert np.corrcoef(np.log(one.power[:, 0]), np.log(left))[0, 1] > 0.999
