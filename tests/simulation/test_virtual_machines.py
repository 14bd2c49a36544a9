"""What every virtual machine promises: seeds, streams, effects, faults, refusals."""

import numpy as np
import pytest

from residuum.simulation import MACHINES, BadSetting

SECONDS = {
    "gate-actuator": 14.0,
    "gripping-pliers": 6.0,
    "process": 60.0,
    "gate-drive": 15.0,
    "oven": 36000.0,
    "linear-axis": 6.0,
    "oscillator": 4.0,
    "two-tanks": 1000.0,
}
NAMES = tuple(SECONDS)
EFFECTS = [(name, id) for name in NAMES for id in MACHINES[name].effects]
FAULTS = [(name, id) for name in NAMES for id in MACHINES[name].faults]


def outputs(signals):
    return np.concatenate(list(signals.channels.values()))


@pytest.mark.parametrize("name", NAMES)
def test_same_seed_same_data_another_seed_other_data(name):
    first, again, other = (MACHINES[name](seed=seed).simulate(SECONDS[name]) for seed in (3, 3, 4))
    assert np.array_equal(outputs(first), outputs(again))
    assert not np.array_equal(outputs(first), outputs(other))
    assert set(first.units) == set(first.channels)
    assert np.isfinite(outputs(first)).all()


@pytest.mark.parametrize("name", NAMES)
def test_a_life_in_pieces_is_the_life_in_one(name):
    whole = MACHINES[name](seed=5).advance(SECONDS[name])
    machine = MACHINES[name](seed=5)
    pieces = [machine.advance(part * SECONDS[name]) for part in (0.0013, 0.2487, 0.05, 0.7)]
    for stream, signals in whole.items():
        assert pieces[0][stream].t0 == signals.t0
        for channel in signals.channels:
            joined = np.concatenate([piece[stream][channel] for piece in pieces])
            np.testing.assert_allclose(joined, signals[channel], atol=1e-12)


@pytest.mark.parametrize(("name", "id"), EFFECTS)
def test_a_larger_effect_changes_the_data_more(name, id):
    settings = {
        "oven": {"configuration": "lumped"},
        "gate-drive": {"noise": 0.0, "quantisation": 0.0, "deviation": 0.0, "initial": "rest"},
    }.get(name, {})
    nominal = MACHINES[name](seed=1, **settings).simulate(SECONDS[name])
    changes = []
    for size in ("small", "medium", "large"):
        machine = MACHINES[name](seed=1, effects={id: size}, **settings)
        changes.append(np.std(outputs(machine.simulate(SECONDS[name])) - outputs(nominal)))
    assert changes[0] > 0
    assert changes[2] >= changes[1] >= changes[0]


# the gripping pliers' shared signals are compared quadrant by quadrant in test_gripping_pliers_physics
@pytest.mark.parametrize(
    ("name", "id"), [(name, id) for name, id in FAULTS if name != "gripping-pliers"]
)
def test_a_fault_acts_at_once_and_ends_when_repaired(name, id):
    healthy, faulty = MACHINES[name](seed=2), MACHINES[name](seed=2)
    before = SECONDS[name]
    assert np.array_equal(outputs(healthy.simulate(before)), outputs(faulty.simulate(before)))
    faulty.set_fault(id)
    assert faulty.active_faults == {id: MACHINES[name].faults[id].default_size}
    assert not np.array_equal(outputs(healthy.simulate(before)), outputs(faulty.simulate(before)))
    faulty.clear_fault(id)
    assert faulty.active_faults == {}
    if name == "process":
        healthy.simulate(before)
        faulty.simulate(before)
        np.testing.assert_allclose(
            outputs(healthy.simulate(before)), outputs(faulty.simulate(before)), atol=1e-12
        )


@pytest.mark.parametrize("name", NAMES)
def test_what_a_machine_does_not_have_is_refused_with_what_it_has(name):
    machine = MACHINES[name]
    with pytest.raises(BadSetting, match=r"effect 'magic' is not known; known are"):
        machine(effects={"magic": {}})
    with pytest.raises(BadSetting, match=r"fault 'magic' is not known; known are"):
        machine(faults={"magic": None})
    with pytest.raises(BadSetting, match="must be a positive number of seconds"):
        machine().simulate(float("nan"))
    with pytest.raises(BadSetting, match="must not be negative"):
        machine(seed=-1)
    for id in machine.faults:
        with pytest.raises(BadSetting, match=f"fault '{id}': size is -1; must be positive"):
            machine(faults={id: -1.0})
    for id in machine.effects:
        with pytest.raises(BadSetting, match=f"effect '{id}' has no parameter 'wrong'; known are"):
            machine(effects={id: {"wrong": 1.0}})


def test_exemplars_differ_in_their_constants_and_number_zero_is_nominal():
    constants = [MACHINES["gate-actuator"](exemplar=k).truth["constants"] for k in range(11)]
    assert constants[0]["R"] == 0.7473
    for name in ("R", "K", "J_M", "motor_friction", "supply", "clearance"):
        assert len({c[name] for c in constants}) >= 9
        assert np.ptp([c[name] for c in constants]) < 2.0 * abs(constants[0][name])
    assert MACHINES["gate-actuator"](seed=9, exemplar=4).truth["constants"] == constants[4]
