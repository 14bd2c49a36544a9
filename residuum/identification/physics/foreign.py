"""What computes a part of a model outside of its equations: the least that a simulation asks of it,
so that its parameters are estimated as any others are.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from threading import RLock
from typing import TYPE_CHECKING, Any, Protocol, TypeVar

from residuum.identification.physics.simulate.differences import Step

if TYPE_CHECKING:
    from residuum.identification.physics.fmu.description import Description

E = TypeVar("E")
"""An experiment, which knows of models."""


class Foreign(Protocol[E]):
    """A library with parameters and a state of its own: one simulation uses it at a time, under
    `lock`.
    """

    @property
    def lock(self) -> RLock:
        """Held while it is set and simulated."""

    @property
    def steps(self) -> Mapping[str, Step]:
        """Parameters that no equation names, with the steps of differences of whole simulations;
        any other one is an argument of the model's equations.
        """

    @property
    def description(self) -> Description:
        """What it says of itself."""

    @property
    def file(self) -> Path:
        """Its library, as it was loaded."""

    def choose_steps(self, model: Any, experiments: Sequence[E]) -> None:
        """Try, along experiments, with which steps slopes by the free parameters are differences,
        where they are.
        """

    def settle(self, values: Mapping[str, float]) -> bool:
        """Take these parameter values for what is computed from now on; whether it can."""

    def along(self, experiments: Sequence[E], values: Mapping[str, float]) -> Sequence[E]:
        """The experiments with what it computes along them by these values as inputs."""
