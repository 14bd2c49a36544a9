"""The gate drive against closed forms, an adaptive integrator, and what friction may and may not do."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from residuum.simulation import MACHINES, BadSetting

K, R, J = 0.0696, 0.7473, 3.5e-5 + 608 * (0.028 / 44) ** 2
QUIET = {"noise": 0.0, "quantisation": 0.0, "deviation": 0.0, "initial": "rest", "rate": 1000.0}


def drive(effects=None, **settings):
    return MACHINES["gate-drive"](seed=2, effects=effects, **{**QUIET, **settings})


def held_response(u, Ts, slope, y0):
    """Adaptive, implicit and far tighter than the machine; u held between samples."""
    states = [np.array(y0)]
    for voltage in u[:-1]:
        step = solve_ivp(
            lambda t, y, v=voltage: slope(y, v),
            (0, Ts),
            states[-1],
            method="LSODA",
            rtol=1e-11,
            atol=1e-12,
        )
        states.append(step.y[:, -1])
    return np.array(states)


def test_nominal_drive_is_the_exact_first_order_lag():
    s = drive(profile="rich").simulate(10.0)
    pole = np.exp(-1e-3 * K * K / (J * R))
    speed = np.zeros(s.n)
    for k in range(s.n - 1):
        speed[k + 1] = pole * speed[k] + (1 - pole) * s["voltage"][k] / K
    np.testing.assert_allclose(s["speed"], speed, atol=1e-7)
    np.testing.assert_allclose(s["current"], (s["voltage"] - K * speed) / R, atol=1e-7)


def test_smooth_effects_together_agree_with_an_adaptive_integrator():
    effects = {
        "viscous-friction": {"b": 2e-4},
        "quadratic-drag": {"c": 1e-7},
        "inductance": {"L": 2e-3},
        "cubic-spring": "large",
    }
    s = drive(effects, profile="rich").simulate(1.5)

    def slope(y, u):
        theta, omega, i = y
        torque = K * i - 2e-4 * omega - 1e-7 * omega * abs(omega) - 1.2e-11 * theta**3
        return [omega, torque / J, (u - K * omega - R * i) / 2e-3]

    reference = held_response(s["voltage"], 1e-3, slope, [0.0, 0.0, 0.0])
    np.testing.assert_allclose(s["speed"], reference[:, 1], atol=1e-4)
    np.testing.assert_allclose(s["current"], reference[:, 2], atol=1e-4)


def test_elastic_transmission_agrees_with_an_adaptive_integrator():
    s = drive({"elastic-transmission": {"compliance": 1.0, "d": 2e-3}}, profile="rich").simulate(
        1.0
    )

    def slope(y, u):
        twist, rotor, gate = y
        torque = twist / 1.0 + 2e-3 * (rotor - gate)
        return [rotor - gate, (K * (u - K * rotor) / R - torque) / 3.5e-5, torque / (J - 3.5e-5)]

    reference = held_response(s["voltage"], 1e-3, slope, [0.0, 0.0, 0.0])
    np.testing.assert_allclose(s["speed"], reference[:, 1], atol=2e-3)


def test_coulomb_friction_sticks_until_breakaway_and_stops_when_the_closed_form_says():
    tau_c = 0.05
    s = drive({"coulomb-friction": {"tau_c": tau_c}}).simulate(15.0)
    ramp_rate = 24.0  # V/s
    breakaway = tau_c * R / K / ramp_rate
    starts = s.time[np.flatnonzero(np.abs(s["speed"]) > 1e-9)[0]]
    assert starts == pytest.approx(breakaway, abs=2e-3)
    # The command ends at 6 s while the lag still turns at slope·T/K above its target; with u = 0 it then decays towards
    # −τR/K², which it would pass through zero for.
    T = J * R / K**2
    stops = s.time[np.flatnonzero((s["speed"] <= 1e-9) & (s.time > 5.5))[0]]
    assert stops == pytest.approx(6.0 + T * np.log(ramp_rate * T * K / (tau_c * R)), abs=1.5e-3)
    resting = (s.time > 6.2) & (s.time < 7.9)
    assert np.all(s["speed"][resting] == 0.0)


@pytest.mark.parametrize(
    "id",
    [
        "coulomb-friction",
        "stribeck-friction",
        "directional-friction",
        "load-friction",
        "quadratic-drag",
    ],
)
def test_friction_never_drives(id):
    s, free = (
        drive({id: "large"}, profile="rich").simulate(10.0),
        drive(profile="rich").simulate(10.0),
    )
    energy_in = np.sum((s["voltage"] - R * s["current"]) * s["current"]) * 1e-3
    stored = 0.5 * J * (s["speed"][-1] ** 2 - s["speed"][0] ** 2)
    assert energy_in > stored
    assert np.max(np.abs(s["speed"])) <= np.max(np.abs(free["speed"])) + 1e-9


def test_the_gap_is_crossed_at_every_reversal():
    effects = {"backlash": {"gap": 5.0}}
    s = drive(effects, profile="rich").simulate(8.0)
    rigid = drive(profile="rich").simulate(8.0)
    # A rotor without its gate has an eighth of the inertia: while it crosses the gap it accelerates far faster.
    assert np.max(np.abs(np.diff(s["speed"]))) > 2.0 * np.max(np.abs(np.diff(rigid["speed"])))
    late = slice(-1000, None)
    assert np.mean(np.abs(s["speed"][late] - rigid["speed"][late])) < 20.0


@pytest.mark.parametrize("delay", [0.002, 0.02])
def test_delay_shifts_the_response_by_itself(delay):
    late, prompt = drive({"input-delay": {"delay": delay}}).simulate(5.0), drive().simulate(5.0)
    shift = round(delay * 1000)
    np.testing.assert_allclose(late["speed"][shift:], prompt["speed"][:-shift], atol=1e-6)


def test_static_paths_of_input_and_output():
    reads_more = (
        drive({"output-offset": {"offset": 3.0}}).simulate(5.0)["speed"]
        - drive().simulate(5.0)["speed"]
    )
    np.testing.assert_allclose(reads_more, 3.0)
    assert drive({"input-saturation": {"limit": 12.0}}).simulate(5.0)[
        "speed"
    ].max() == pytest.approx(12.0 / K, rel=1e-3)
    assert drive({"input-dead-zone": {"width": 1.0}}).simulate(5.0)["speed"][-1] == pytest.approx(
        23.0 / K, rel=1e-3
    )
    assert drive({"output-absolute": {}}).simulate(15.0)["speed"].min() >= 0.0
    steps = drive({"output-quantisation": {"step": 4.0}}).simulate(5.0)["speed"] / 4.0
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-9)


@pytest.mark.parametrize("rho", [0.0, 0.9, 0.99])
def test_noise_has_the_colour_and_size_that_was_asked_for(rho):
    settings = {"quantisation": 0.0, "noise_color": rho}
    noise = (
        drive(**settings, noise=1.0).simulate(60.0)["speed"]
        - drive(**settings, noise=0.0).simulate(60.0)["speed"]
    )
    assert np.corrcoef(noise[:-1], noise[1:])[0, 1] == pytest.approx(rho, abs=0.02)
    assert noise.std() == pytest.approx(0.3, rel=0.15)


def test_parameters_stay_within_the_deviation():
    constants = [MACHINES["gate-drive"](seed=seed).truth["constants"] for seed in range(40)]
    for name, nominal in (("K", K), ("R", R), ("J", J)):
        ratio = np.array([c[name] for c in constants]) / nominal
        assert np.all(np.abs(ratio - 1) <= 0.1)
        assert np.ptp(ratio) > 0.1


def test_settings_out_of_range_are_refused():
    with pytest.raises(BadSetting, match="profile 'sine' is not known; known are duty-cycle, rich"):
        drive(profile="sine")
    with pytest.raises(BadSetting, match=r"noise_color is 1\.0; must be between 0 and 0\.9999"):
        drive(noise_color=1.0)
