"""The parts of the reproduction; each is a module with `items(short) -> list[Item]`."""

from collections.abc import Sequence
from importlib import import_module

from reproduction.item import Item

PARTS: dict[str, str] = {
    "drawings": "Fig. 38, 40, 59, 66–72, 79–84, Table 5: schemes and photographs, and the loop that two of them draw",
    "sample_size": "Fig. 39, 41: the two robust-performance tests, and the number of samples",
    "prediction_error": "Examples 1.2–1.4, Fig. 25–32: least squares and its ellipses",
    "uncertainty": "Fig. 43–45, Remark 2.9: identification of (2.38) and its uncertainty weights",
    "nominal_control": "Fig. 42, 46–49: manual and automatic controllers for (2.38), and the true plant",
    "robust_control": "Fig. 50–54: robust performance for (2.38)",
    "robust_residual": "Fig. 56–58: the robust residual of (4.10) and sensor steps of 30 and of 3",
    "oven": "Fig. 55, 60–65: one controller for the best and the worst configuration of the oven",
    "gripping_pliers": "Fig. 73–77, Table 6: the damaged bearing of the gripping pliers",
    "gate_actuator": "Fig. 78, 85–87, Table 7: criticality, residual, features and classifier of the gate actuator",
}
"""Module of this package → what of the source it reproduces."""


def run(name: str, short: bool) -> Sequence[Item]:
    """The items of one part; `short`: with fewer repeats."""
    items: Sequence[Item] = import_module(f"reproduction.{name}").items(short)
    return items
