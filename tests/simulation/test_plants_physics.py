"""Process, oven, axis, oscillator and tanks against closed forms and balances."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from residuum.simulation import MACHINES, BadSetting


def test_process_has_the_benchmarks_gain_poles_and_noise():
    machine = MACHINES["process"](seed=1)
    s = machine.simulate(5000.0)
    lags = np.arange(60)
    centred = s["u"] - s["u"].mean()
    g = np.array([np.mean(s["y"][60:] * centred[60 - k : len(centred) - k]) for k in lags])
    t = 0.1 * np.arange(61)
    step = solve_ivp(
        lambda _, x: [x[1], x[2], 47619 - 234.0136 * x[2] - 6857.1 * x[1] - 5442.2 * x[0]],
        (0, 6.0), [0, 0, 0], t_eval=t, method="LSODA", rtol=1e-9, atol=1e-12,
    ).y[0]  # fmt: skip
    np.testing.assert_allclose(g[1:], np.diff(step)[: len(g) - 1], atol=0.04)
    filtered = np.convolve(s["u"], np.concatenate([[0], np.diff(step)]))[: s.n]
    noise = (s["y"] - filtered)[100:]
    assert np.var(filtered[100:]) / np.var(noise) == pytest.approx(9.0, rel=0.1)


def test_process_faults_do_what_they_say():
    def pair(id, size=None):
        healthy, faulty = MACHINES["process"](seed=3), MACHINES["process"](seed=3)
        healthy.simulate(50.0), faulty.simulate(50.0)
        faulty.set_fault(id, size)
        return faulty.simulate(100.0)["y"], healthy.simulate(100.0)["y"]

    faulty, healthy = pair("sensor-offset", 3.0)
    np.testing.assert_allclose(faulty - healthy, 3.0)
    faulty, healthy = pair("sensor-drift")
    np.testing.assert_allclose(faulty - healthy, 0.02 * np.arange(1, 1001), atol=1e-9)
    assert np.ptp(pair("stuck-sensor")[0]) == 0.0
    faulty, healthy = pair("actuator-gain", 0.5)
    assert 0.2 < np.var(faulty) / np.var(healthy) < 0.5


def test_oven_best_keeps_its_heat_and_worst_loses_it():
    final, rise = {}, {}
    for configuration in ("best", "worst"):
        machine = MACHINES["oven"](configuration=configuration)
        machine.set_input(60.0)
        T = machine.simulate(12 * 3600.0)["temperature"]
        final[configuration] = T[-30:].mean()
        rise[configuration] = np.argmax(0.632 * (final[configuration] - 20) < T - 20)
    assert 180 < final["best"] < 260
    assert 60 < final["worst"] < 110
    assert rise["best"] > 1.5 * rise["worst"]


def test_lumped_oven_is_the_heat_balance_it_claims_and_duty_saturates():
    machine = MACHINES["oven"](configuration="lumped", seed=2)
    machine.set_input(250.0)
    s = machine.simulate(24 * 3600.0)
    assert np.all(s["duty"] == 100.0)
    assert s["temperature"][-60:].mean() - s["ambient"][-60:].mean() == pytest.approx(
        12e3 / 45.0, rel=0.02
    )


def test_joining_two_configurations_leaves_no_jump():
    machine = MACHINES["oven"](configuration="worst", profile="experiment")
    first = machine.simulate(4800 * 60.0)
    machine.configure("best")
    second = machine.simulate(4800 * 60.0)
    assert np.all(first["duty"][:400] == 0.0) and np.all(first["duty"][-400:] == 0.0)
    assert abs(second["temperature"][0] - first["temperature"][-1]) < 1.0
    assert second["temperature"][1000:4000].mean() > 1.8 * first["temperature"][1000:4000].mean()


def test_heater_failure_takes_its_share_of_the_power():
    finals = []
    for size in (None, 3.0):
        machine = MACHINES["oven"](
            configuration="lumped", faults={"heater-failure": size} if size else {}
        )
        machine.set_input(80.0)
        s = machine.simulate(24 * 3600.0)
        finals.append(s["temperature"][-60:].mean() - s["ambient"][-60:].mean())
    assert finals[1] / finals[0] == pytest.approx(0.5, rel=0.02)


def test_axis_obeys_newton_and_its_controller_follows():
    machine = MACHINES["linear-axis"](seed=4, noise=0.0)
    s = machine.simulate(8.0)
    impulse = np.cumsum(s["force"]) * 1e-3
    np.testing.assert_allclose(
        machine.truth["constants"]["M"] * s["velocity"][1:], impulse[:-1], atol=1e-6
    )
    assert np.ptp(s["position"]) > 0.3


def test_dry_friction_holds_the_axis_and_never_drives_it():
    s = MACHINES["linear-axis"](
        seed=4, noise=0.0, loop="open", effects={"coulomb-friction": {"tau_c": 70.0}}
    ).simulate(5.0)
    assert np.ptp(s["velocity"][200:]) == 0.0
    s = MACHINES["linear-axis"](
        seed=4, noise=0.0, loop="open", effects={"coulomb-friction": {"tau_c": 20.0}}
    ).simulate(5.0)
    assert np.sum(s["force"] * s["velocity"]) > 0.0


def test_oscillator_agrees_with_an_adaptive_integrator():
    machine = MACHINES["oscillator"](seed=1, noise=0.0, effects={"cubic-spring": "large"})
    s = machine.simulate(0.5)
    c = machine.truth["constants"]
    y, q = np.zeros(2), []
    for force in s["force"]:
        q.append(y[0])
        slope = lambda _, y, F=force: [  # noqa: E731
            y[1],
            (F - c["d"] * y[1] - c["k"] * y[0] - 8.0 * y[0] ** 3) / c["M"],
        ]
        y = solve_ivp(slope, (0, s.sample_time), y, rtol=1e-10, atol=1e-13).y[:, -1]
    np.testing.assert_allclose(s["position"], q, atol=1e-5)


def test_tanks_settle_where_inflow_is_outflow():
    machine = MACHINES["two-tanks"](seed=1, noise=0.0)
    machine._hold = [np.inf, 5.0]
    s = machine.simulate(6000.0)
    c = machine.truth["constants"]
    for level, outlet in (("level_1", "a_1"), ("level_2", "a_2")):
        assert s[level][-1] == pytest.approx(
            (c["k_p"] * 5.0 / c[outlet]) ** 2 / (2 * 9.81), rel=1e-3
        )


def test_an_overflowing_tank_stays_near_its_rim():
    s = MACHINES["two-tanks"](seed=1, noise=0.0, effects={"overflow": {"rim": 0.2}}).simulate(
        4000.0
    )
    assert s["level_1"][500:].max() < 0.24


@pytest.mark.parametrize(
    ("name", "setting"), [("oven", "profile"), ("linear-axis", "loop"), ("oscillator", "profile")]
)
def test_unknown_choices_are_refused(name, setting):
    with pytest.raises(BadSetting, match=f"{setting} 'odd' is not known; known are"):
        MACHINES[name](**{setting: "odd"})
