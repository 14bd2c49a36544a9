"""The model's own values as the records tell them, beside the model file's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from residuum.identification.discrepancy.policy import OTHER_VALUE
from residuum.identification.physics import PhysicalModel


@dataclass(frozen=True)
class EstimatedValue:
    """A free parameter of the model: its value in the file, and as estimated, with the standard
    deviation.
    """

    name: str
    file: float
    value: float
    std: float
    unit: str

    @property
    def differs(self) -> bool:
        """Whether the records plainly contradict the file's value."""
        return abs(self.value - self.file) > OTHER_VALUE * self.std


def estimated_values(
    model: PhysicalModel, best: PhysicalModel, stds: Mapping[str, float]
) -> tuple[EstimatedValue, ...]:
    """Free parameters of `model` in the structure that was found best.

    Where they explain the error without any effect, the machine or the file has changed, and no
    physics is missing.
    """
    values = best.values
    return tuple(
        EstimatedValue(
            name, model.values[name], values[name], stds[name], model.all_parameters[name].unit
        )
        for name in model.free
        if name in values and name in stds
    )
