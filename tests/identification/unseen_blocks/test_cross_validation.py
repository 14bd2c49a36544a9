"""Errors on unseen blocks in closed form, against models that were estimated without those blocks."""

from dataclasses import replace

import numpy as np
import pytest

from residuum.identification.physics import estimate, read_model
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.cross_validation import CrossValidation, validated
from residuum.identification.unseen_blocks.data import matched
from residuum.identification.unseen_blocks.multiple_shooting import first_fit
from residuum.identification.unseen_blocks.scale import plain
from residuum.identification.unseen_blocks.structure import Structure, fitted
from residuum.identification.unseen_blocks.trial_fits import called_back

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
    return Record(
        {"force": force, "speed": speed + noise * rng.normal(size=n)},
        {"force": "N", "speed": "m/s"},
        h,
    )


@pytest.mark.parametrize("friction", [0.0, 1.5])
def test_blocks_left_out_are_judged_as_by_a_fit_without_them(friction):
    data = matched(read_model(CART), [cart_record(n=2000, friction=friction)], None)
    start = first_fit(data)
    one = validated(start.structure, start.found, start.last, data, start.scale)
    # where it began is not what is judged
    (part,), begins = (start.last.parts, {"v": start.found.initial[0][0]})
    left = np.zeros(data.blocks)
    for fold in np.unique(data.fold):
        out = data.fold[start.last.block] == fold
        masked = replace(part, Y=np.where(out[:, None], np.nan, part.Y), known=begins)
        rest = estimate(start.structure.model, [masked], initial=start.found.initial)
        errors = np.where(out, (part.Y - rest.predicted[0])[:, 0], 0.0) / data.spread[0]
        left += np.bincount(start.last.block, weights=errors**2, minlength=data.blocks)
    seen = float(np.sum((start.found.residuals[0] / data.spread) ** 2))
    assert left.sum() > seen  # what the fit has not seen is more
    assert one.power.sum() == pytest.approx(left.sum(), rel=0.01)
    assert one.power.sum() - seen == pytest.approx(left.sum() - seen, rel=0.1)
    assert np.corrcoef(np.log(one.power[:, 0]), np.log(left))[0, 1] > 0.999


RESISTANCE = """
name: room
inputs: {heat: W}
states: {T: {unit: degC}}
parameters: {C: {value: 3.0e6, unit: J/K, lower: 1}, R: {value: 0.006, unit: K/W, lower: 1e-5}}
balances: {air: {kind: heat, storage: C * der(T), terms: {heater: heat, loss: -T / R}}}
outputs: {room: {value: T, unit: degC}}
"""


def test_a_value_that_ran_off_is_put_back_where_it_was_given():
    """From an infinite resistance no slope leads back."""
    rng = np.random.default_rng(2)
    heat, T = np.repeat(rng.choice([0.0, 3000.0], 30), 20), np.zeros(600)
    for k in range(599):
        T[k + 1] = T[k] + 600.0 / 4.0e6 * (heat[k] - T[k] / 0.01)
    record = Record(
        {"heat": heat, "room": T + 0.02 * rng.normal(size=600)},
        {"heat": "W", "room": "degC"},
        600.0,
    )
    data = matched(read_model(RESISTANCE), [record], None)
    horizon, scale = data.horizons[-1], plain(data)
    gone = fitted(
        data.model.with_values({"R": 1e80}), horizon, None, scale, steps=15, tolerance=1e-6
    )
    assert gone.model.parameters["R"].value > 1e70
    validation, near = (
        CrossValidation(data, horizon, horizon, scale),
        Structure((), gone.model, {}, {}),
    )
    back = called_back(gone, near, validation)
    assert (
        back.model.parameters["R"].value == pytest.approx(0.01, rel=0.05)
        and back.cost < 0.1 * gone.cost
    )
    assert called_back(back, near, validation) is None
