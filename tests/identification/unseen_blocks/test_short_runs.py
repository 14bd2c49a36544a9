"""Short records, and many short runs, which are one experiment: whole ones are kept aside."""

from pathlib import Path

import numpy as np
import pytest

from residuum.identification.errors import BadRecord
from residuum.identification.physics import Simulator, match, read_model
from residuum.identification.record import Record
from residuum.identification.unseen_blocks.advice import distinguishing, power_of_test
from residuum.identification.unseen_blocks.data import matched
from residuum.identification.unseen_blocks.policy import POWER_WANTED
from residuum.identification.unseen_blocks.record_search import searched
from residuum.identification.unseen_blocks.tried import Wanted

CART = """name: cart
inputs: {}
states: {q: {unit: m, rate: v}, v: {unit: m/s}}
parameters: {M: {value: 2, unit: kg, fixed: true}, k: {value: 30, unit: N/m, lower: 0}}
balances: {axis: {kind: force, storage: M * der(v), terms: {spring: -k * q}, position: q, velocity: v}}
outputs: {position: {value: q, unit: m}}
"""
FAN = (Path(__file__).parents[1] / "discrepancy" / "fan.yaml").read_text()
LEADS = """name: leads
inputs: {u: V}
parameters: {R: {value: 2, unit: ohm, lower: 0}, S: {value: 5, unit: ohm, lower: 0}}
balances:
  one: {kind: voltage, storage: 0, terms: {supply: u, drop: -R * i}, current: i}
  two: {kind: voltage, storage: 0, terms: {supply: u, drop: -S * j}, current: j}
outputs: {first: {value: i, unit: A}, second: {value: j, unit: A}}
"""


def let_go(runs, samples, seed=0):
    """Runs of a cart that is let go from different places, with dry friction: f = -1.2 N sign(v)."""
    rng, h, records = np.random.default_rng(seed), 0.03, []
    for k in range(runs):
        q, v, place = 0.3 + 0.1 * k, 0.0, []
        for _ in range(samples):
            place.append(q)
            for _ in range(20):
                pushed = v - h / 20 * 30.0 * q / 2.0
                v = np.sign(pushed) * max(abs(pushed) - h / 20 * 1.2 / 2.0, 0.0)
                q += h / 20 * v
        noise = 1e-3 * rng.standard_normal(samples)
        records.append(
            Record({"position": np.array(place) + noise}, {"position": "m"}, h, source=f"run {k}")
        )
    return records


def test_runs_of_sixty_samples_name_the_friction():
    model = read_model(CART)
    found = searched(
        model, let_go(8, 60), None, Wanted(("coulomb-friction", "quadratic-drag"), held=False)
    )
    assert [key.effect for key in found.best.keys] == ["coulomb-friction"]
    assert found.best.model.values["coulomb-friction@axis.tau_c"] == pytest.approx(1.2, rel=0.1)
    assert len(set(found.validation.data.fold)) == 4  # whole runs are kept aside


def test_few_samples_are_refused_with_what_would_do():
    with pytest.raises(BadRecord, match="at least 40 in all and 4 in each record are needed"):
        matched(read_model(CART), let_go(2, 19), None)


def rubbing(torque, samples=60, seed=0):
    """One short record of a fan with dry friction, its torque changed every six samples."""
    rng, h = np.random.default_rng(seed), 0.2
    driven, w, speed = np.repeat(rng.uniform(-1.0, 1.0, samples // 6), 6), 0.0, []
    for t in driven:
        speed.append(w)
        for _ in range(20):
            pushed = w + h / 20 * (t - 0.0265 * w) / 0.057
            w = np.sign(pushed) * max(abs(pushed) - h / 20 * torque / 0.057, 0.0)
    noisy = np.array(speed) + 0.2 * rng.standard_normal(samples)
    return Record({"torque": driven, "speed": noisy}, {"torque": "N*m", "speed": "rad/s"}, h)


@pytest.mark.parametrize("seed", range(5))
def test_one_record_of_sixty_samples_names_the_friction_and_nothing_where_nothing_is_missing(seed):
    found = searched(read_model(FAN), [rubbing(0.15, seed=seed)], None, Wanted())
    assert found.validation.data.blocks == 12
    assert [key.effect for key in found.best.keys] == ["coulomb-friction"]
    assert searched(read_model(FAN), [rubbing(0.0, seed=seed)], None, Wanted()).best.keys == ()


def test_a_model_without_states_and_with_two_outputs():
    rng, u = np.random.default_rng(1), 6.0 * np.sin(0.07 * np.arange(400))
    first, second = np.sign(u) * np.maximum(np.abs(u) - 1.0, 0.0) / 2.2, u / 5.3
    noise = 0.01 * rng.standard_normal((2, 400))
    record = Record(
        {"u": u, "first": first + noise[0], "second": second + noise[1]},
        {"u": "V", "first": "A", "second": "A"},
        0.01,
    )
    found = searched(read_model(LEADS), [record], None, Wanted(("brush-drop",), held=False))
    assert [str(key) for key in found.best.keys] == ["brush-drop@one"]


def test_how_much_more_of_the_same_would_tell_two_structures_apart():
    """Twice the data make the distance √2 times as long."""
    model, experiments = match(read_model(CART), let_go(1, 100))
    assert Simulator(model).states == ("q", "v")
    distance = np.zeros(50)
    distance[0] = 1.5
    none = np.zeros((50, 0))
    more = distinguishing(
        ("a", "b"), model, experiments, lambda _e, _o: power_of_test(distance, none)
    )[-1]
    times = int(more.do.split()[1])
    assert more.power == POWER_WANTED and "times as much of the same" in more.do
    assert (
        power_of_test(distance * np.sqrt(times), none)
        >= POWER_WANTED
        > power_of_test(distance * np.sqrt(times - 1), none) - 0.01
    )
