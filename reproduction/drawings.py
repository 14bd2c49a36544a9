"""Schemes, photographs and sketches of chapters 2 to 7; of the loop and the motor that are drawn, "
"what the code says of them."""

import numpy as np

from reproduction.check import at_most
from reproduction.item import Item
from residuum.diagnosis.gate.actuator_model import ActuatorConstants
from residuum.identification.linear_models.transfer_function import TransferFunction
from residuum.robust_control.loop import weighted_loop

_SHOWN_IN = {
    "Fig. 38": (
        "Identification for robust control, and the source's way",
        "a flow of steps; each is measured in its own figure",
    ),
    "Fig. 59": (
        "The oven and its air flows",
        "a sketch of the machine; its simulator is residuum/simulation/oven.py",
    ),
    "Table 5": (
        "Boundary conditions of the oven",
        "its entries are lost in the text at hand; what they must have been says OvenMachine",
    ),
    "Fig. 66–67": ("Bottling plant, oven and blow moulding machine", "a sketch"),
    "Fig. 68–69": ("A gripping plier, and how it opens", "photographs and a sketch"),
    "Fig. 70": (
        "The damaged bearing",
        "a photograph; the simulated machine's damage is the fault plier-bearing",
    ),
    "Fig. 71": ("The accelerometer's place", "a photograph"),
    "Fig. 72": (
        "The four quadrants",
        "a scheme; which quadrant shows the damage is measured in Fig. 76 and 77",
    ),
    "Fig. 79–82": (
        "The gate actuator, its gears and their damage",
        "a scheme and photographs; the faults are gear-notch, pinion-tooth, rack-tooth",
    ),
}


def items(short: bool) -> list[Item]:
    """The two schemes that have equations, then the list of what only shows."""
    del short
    drawn = [
        Item(where, title, "no numbers", reason=why) for where, (title, why) in _SHOWN_IN.items()
    ]
    return [_loop(), _motor(), *drawn]


def _loop() -> Item:
    """The block scheme's state-space form against S, T and KS computed from the responses themselves."""
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(20):
        plant = TransferFunction(rng.normal(size=2), np.poly(rng.uniform(-0.7, 0.7, 3)), 1.0)
        controller = TransferFunction(0.1 * rng.normal(size=2), [1.0, -0.9], 1.0)
        weights = [
            TransferFunction(rng.normal(size=2), [1.0, rng.uniform(-0.8, 0.8)], 1.0)
            for _ in range(2)
        ]
        omega = np.linspace(0.01, 3.0, 50)
        G, K, W_S, W_T = (
            system.frequency_response(omega) for system in (plant, controller, *weights)
        )
        expected = np.stack([W_S / (1 + G * K), W_T * G * K / (1 + G * K)], axis=1)
        found = weighted_loop(plant, controller, *weights).response(np.exp(1j * omega))[:, :, 0]
        worst = max(worst, float(np.abs(found - expected).max() / np.abs(expected).max()))
    check = at_most(
        "largest difference of the scheme's state-space form from [W_S S; W_T T]",
        worst,
        1e-9,
        source="Proof 2.1",
    )
    return Item(
        "Fig. 40", "The mixed-sensitivity scheme", "its lower LFT is [W_S S; W_T T]", [check]
    )


def _motor() -> Item:
    """(7.1b) against the motor's own two equations: V = R i + K ω, J dω/dt = K i − τ̄ F."""
    motor = ActuatorConstants()
    s = 1j * np.geomspace(0.1, 1e3, 50)
    voltage_to_speed = np.linalg.solve(
        _equations(motor, s), np.broadcast_to(np.array([[1.0], [0.0]]), (len(s), 2, 1))
    )[:, 1, 0]
    model = motor.gain / (motor.time_constant * s + 1)
    worst = float(np.abs(model / voltage_to_speed - 1).max())
    check = at_most(
        "largest relative difference of (7.2) from the two equations", worst, 1e-9, source="(7.1b)"
    )
    return Item(
        "Fig. 83",
        "The motor's block scheme",
        "first order from voltage to speed, with L = D = 0",
        [check],
    )


def _equations(motor: ActuatorConstants, s: np.ndarray) -> np.ndarray:
    matrix = np.zeros((len(s), 2, 2), dtype=complex)  # rows: voltage, torque; columns: i, ω
    matrix[:, 0, 0], matrix[:, 0, 1] = motor.R, motor.K
    matrix[:, 1, 0], matrix[:, 1, 1] = -motor.K, s * motor.J
    return matrix
