"""What the nominal gate drive leaves out: the hidden effects of the drive, each with three sizes.

Sizes are set against the drive itself: its rated voltage of 24 V, its torque constant of 0.0696
N·m/A (1 A of friction is 0.07 N·m), its speed of 345 rad/s and the 1700 rad of a duty cycle's
movement. `small` is near what a careful engineer could just see in 15 s of data, `large` is obvious
to the eye. The end stop's default place is where a duty cycle ends; a rich profile rarely goes
there, so give `theta_e` with it.
"""

from residuum.simulation.machine import Effect

EFFECTS: dict[str, Effect] = {
    "viscous-friction": Effect({"b": 1e-4}, {"b": "N*m*s/rad"}, (2e-5, 1e-4, 4e-4), "torque −b ω"),
    "coulomb-friction": Effect(
        {"tau_c": 0.02}, {"tau_c": "N*m"}, (0.005, 0.02, 0.06), "torque −tau_c sgn ω, with sticking"
    ),
    "stribeck-friction": Effect(
        {"tau_s": 0.03, "tau_c": 0.02, "omega_s": 20.0},
        {"tau_s": "N*m", "tau_c": "N*m", "omega_s": "rad/s"},
        (0.01, 0.03, 0.08),
        "torque −(tau_c + tau_s exp(−(ω/omega_s)²)) sgn ω: tau_s is what breakaway adds",
    ),
    "directional-friction": Effect(
        {"asymmetry": 0.015, "tau_c": 0.02},
        {"asymmetry": "N*m", "tau_c": "N*m"},
        (0.005, 0.015, 0.04),
        "Coulomb friction tau_c + asymmetry/2 forwards, tau_c − asymmetry/2 backwards",
    ),
    "load-friction": Effect(
        {"mu": 0.15}, {"mu": ""}, (0.05, 0.15, 0.4), "torque −mu |K i| sgn ω, with sticking"
    ),
    "quadratic-drag": Effect(
        {"c": 5e-8}, {"c": "N*m*s**2/rad**2"}, (1e-8, 5e-8, 2e-7), "torque −c ω |ω|"
    ),
    "constant-load": Effect(
        {"tau_l": 0.01}, {"tau_l": "N*m"}, (0.003, 0.01, 0.04), "torque −tau_l"
    ),
    "position-load": Effect(
        {"tau_p": 0.02, "period": 1200.0, "phase": 0.7},
        {"tau_p": "N*m", "period": "rad", "phase": "rad"},
        (0.005, 0.02, 0.06),
        "torque −tau_p sin(2π θ/period + phase): a rail that is not level",
    ),
    "tooth-ripple": Effect(
        {"tau_r": 0.02, "order": 14 / 44, "phase": 0.4},
        {"tau_r": "N*m", "order": "", "phase": "rad"},
        (0.005, 0.02, 0.08),
        "torque −tau_r sin(order θ + phase): 14 pinion teeth a shaft revolution",
    ),
    "linear-spring": Effect({"k": 5e-6}, {"k": "N*m/rad"}, (1e-6, 5e-6, 2e-5), "torque −k θ"),
    "cubic-spring": Effect(
        {"k3": 3e-12}, {"k3": "N*m/rad**3"}, (5e-13, 3e-12, 1.2e-11), "torque −k3 θ³"
    ),
    "elastic-transmission": Effect(
        {"compliance": 1.0, "d": 2e-3},
        {"compliance": "rad/(N*m)", "d": "N*m*s/rad"},
        (0.3, 1.0, 3.0),
        "rotor and gate are two bodies on a spring of 1/compliance with damping d",
    ),
    "backlash": Effect(
        {"gap": 1.5, "k": 5.0, "d": 3e-3},
        {"gap": "rad", "k": "N*m/rad", "d": "N*m*s/rad"},
        (0.5, 1.5, 5.0),
        "rotor and gate are two bodies that touch through a gap",
    ),
    "end-stop": Effect(
        {"k": 0.05, "theta_e": 1450.0, "d": 0.02},
        {"k": "N*m/rad", "theta_e": "rad", "d": "N*m*s/rad"},
        (0.01, 0.05, 0.3),
        "torque −max(k (θ − theta_e) + d ω, 0) beyond theta_e",
    ),
    "hysteresis": Effect(
        {"tau_h": 0.02, "theta_h": 8.0},
        {"tau_h": "N*m", "theta_h": "rad"},
        (0.005, 0.02, 0.06),
        "Dahl: torque −tau_h z, dz/dt = (ω − |ω| z)/theta_h",
    ),
    "inductance": Effect({"L": 1e-3}, {"L": "H"}, (3e-4, 1e-3, 4e-3), "voltage L di/dt"),
    "brush-drop": Effect(
        {"v_b": 0.8}, {"v_b": "V"}, (0.3, 0.8, 2.0), "voltage −v_b sgn i; no current below v_b"
    ),
    "supply-sag": Effect(
        {"r_s": 0.1},
        {"r_s": "ohm"},
        (0.03, 0.1, 0.3),
        "voltage −r_s i while the supply feeds the motor, u i > 0",
    ),
    "resistance-heating": Effect(
        {"h": 1.0, "alpha": 0.0039, "T_w": 40.0},
        {"h": "K/J", "alpha": "1/K", "T_w": "s"},
        (0.3, 1.0, 3.0),
        "R (1 + alpha ϑ), dϑ/dt = h R i² − ϑ/T_w",
    ),
    "input-delay": Effect(
        {"delay": 6e-3}, {"delay": "s"}, (2e-3, 6e-3, 2e-2), "the motor sees u(t − delay)"
    ),
    "input-dead-zone": Effect(
        {"width": 0.4}, {"width": "V"}, (0.1, 0.4, 1.2), "the motor sees sgn(u) max(|u| − width, 0)"
    ),
    "input-saturation": Effect(
        {"limit": 20.0}, {"limit": "V"}, (23.0, 20.0, 16.0), "the motor sees u within ± limit"
    ),
    "input-offset": Effect(
        {"offset": 0.2}, {"offset": "V"}, (0.05, 0.2, 0.8), "the motor sees u + offset"
    ),
    "output-lag": Effect(
        {"T": 1e-2}, {"T": "s"}, (3e-3, 1e-2, 4e-2), "the speed sensor is a first-order lag"
    ),
    "output-offset": Effect(
        {"offset": 2.0},
        {"offset": "rad/s"},
        (0.5, 2.0, 8.0),
        "the speed sensor reads offset too much",
    ),
    "output-absolute": Effect(
        {"on": 1.0}, {"on": ""}, (1.0, 1.0, 1.0), "the speed sensor reads |ω|"
    ),
    "output-quantisation": Effect(
        {"step": 4.0}, {"step": "rad/s"}, (1.0, 4.0, 15.0), "the speed sensor has this step"
    ),
    "x-speed-resonance": Effect(
        {"tau_r": 0.03, "omega_r": 210.0, "zeta": 0.06},
        {"tau_r": "N*m", "omega_r": "rad/s", "zeta": ""},
        (0.01, 0.03, 0.1),
        "outside the catalogue: drag −tau_r sgn ω / (1 + ((ω² − omega_r²)/(2 zeta omega_r ω))²) of"
        " a resonating frame",
    ),
    "x-random-position-profile": Effect(
        {"tau_x": 0.03, "length": 60.0},
        {"tau_x": "N*m", "length": "rad"},
        (0.01, 0.03, 0.08),
        "outside the catalogue: a random torque that repeats with position, of this RMS and"
        " correlation length",
    ),
    "x-random-walk-load": Effect(
        {"rate": 0.01},
        {"rate": "N*m/s**0.5"},
        (0.003, 0.01, 0.03),
        "outside the catalogue: a load that wanders as a random walk",
    ),
}
